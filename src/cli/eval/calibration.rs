//! Range of the total force of `egotac eval`: given, or measured on a calibration split.

use anyhow::bail;

use super::Args;
use super::truth;
use crate::file::{self, input, limits};
use crate::score::metrics::{self, Calibration, EvalOptions};
use crate::tactile::TactileSequence;

/// Reads the file of `--calibration`; None if none is given.
pub fn read(args: &Args) -> anyhow::Result<Option<Calibration>> {
    let Some(path) = &args.calibration else { return Ok(None) };
    let text = input::read_text(path, limits::TEXT)?;
    let calibration: Calibration = serde_json::from_str(&text).map_err(|_| {
        let expected = r#"{"min": number, "max": number}, or one each under "pred" and "target""#;
        anyhow::anyhow!("{}: expected {expected}", path.display())
    })?;
    for range in [calibration.pred(), calibration.target()] {
        if !(range.min.is_finite() && range.max.is_finite() && range.min < range.max) {
            bail!("{}: expected min < max, got {} and {}", path.display(), range.min, range.max);
        }
    }
    Ok(Some(calibration))
}

/// Reads the truth of `--calibration-from`; None if no store is given.
pub fn truth(args: &Args) -> anyhow::Result<Option<TactileSequence>> {
    match args.calibration_from.as_slice() {
        [] => Ok(None),
        stores => Ok(Some(truth::truth(args, stores)?.0)),
    }
}

/// Measures the ranges of a calibration split, and writes them to `--calibration-out`.
pub fn measure(args: &Args, pred: &TactileSequence, target: &TactileSequence) -> anyhow::Result<Calibration> {
    let calibration = metrics::calibrate(pred, target)?;
    if let Some(path) = &args.calibration_out {
        file::write(path, format!("{:#}\n", serde_json::to_value(calibration)?).as_bytes())?;
    }
    Ok(calibration)
}

/// Returns the calibration of a baseline: persistence repeats the truth, so that the true range holds for both sides.
pub fn of_baseline(name: &str, options: &EvalOptions) -> Option<Calibration> {
    let calibration = options.calibration?;
    match name {
        "persistence" => Some(Calibration::Both(calibration.target())),
        _ => Some(calibration),
    }
}
