//! `egotac eval`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, bail};

use crate::dataset::EpisodeReader;
use crate::dataset::tensors::FieldFile;
use crate::dataset::zarr::{FRAME_VALIDITY, MANO_CONTACT_VALID, MANO_FORCE, MANO_FORCE_VALID, TIMESTAMPS, ZarrReader};
use crate::metrics::{self, Calibration, Fields, Options, Report};
use crate::tactile::N_FIELD;

/// Arguments of `egotac eval`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Undefined scores (no contact in truth, a constant trace, ...) are null in JSON and `undefined` in the table.\n\
    A contact is predicted where its probability is above 0.5 and true where the force is above 0.05 N."
)]
pub struct Args {
    /// Predicted fields: safetensors with `force` and `contact`, (T, 1556) each.
    #[arg(long, value_name = "FILE")]
    pred: PathBuf,
    /// True fields: safetensors as above (also `mask_force`, `mask_contact`, `episode_ends`), or a Zarr store.
    #[arg(long, value_name = "FILE|STORE")]
    target: PathBuf,
    /// Frames per second, for the dominant frequency; by default from the target's timestamps.
    #[arg(long, value_name = "F", value_parser = positive)]
    fps: Option<f64>,
    /// JSON file with the range of the total force, N: {"min": .., "max": ..}, or one each under "pred" and "target";
    /// by default the range of the data.
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Print JSON in place of a table.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let report = eval_files(&args)?;
    print_reports(&[("prediction", &report)], args.json)?;
    Ok(ExitCode::SUCCESS)
}

fn eval_files(args: &Args) -> anyhow::Result<Report> {
    let pred = FieldFile::read(&args.pred)?;
    let target = read_target(&args.target)?;
    if let (Some(pred), Some(target)) = (pred.topology, target.topology) {
        pred.must_match(target)?;
    }
    if pred.fields.n_frames() != target.fields.n_frames() {
        bail!(
            "{} has {} frames, {} has {}",
            args.pred.display(),
            pred.fields.n_frames(),
            args.target.display(),
            target.fields.n_frames()
        );
    }
    let options = options(&target, args.fps, args.calibration.as_deref())?;
    Ok(metrics::evaluate(&pred.fields, &target.fields, &options)?)
}

fn options(target: &FieldFile, fps: Option<f64>, calibration: Option<&Path>) -> anyhow::Result<Options> {
    let calibration = match calibration {
        Some(path) => Some(read_calibration(path)?),
        None => None,
    };
    Ok(Options {
        mask_force: target.mask_force.clone(),
        mask_contact: target.mask_contact.clone(),
        episode_ends: target.episode_ends.clone(),
        fps: fps.or_else(|| target.fps()),
        calibration,
    })
}

fn read_calibration(path: &Path) -> anyhow::Result<Calibration> {
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let calibration: Calibration = serde_json::from_str(&text).map_err(|_| {
        let expected = r#"{"min": number, "max": number}, or one each under "pred" and "target""#;
        anyhow::anyhow!("{}: expected {expected}", path.display())
    })?;
    for range in [calibration.pred(), calibration.target()] {
        if !(range.min.is_finite() && range.max.is_finite() && range.min < range.max) {
            bail!("{}: expected min < max, got {} and {}", path.display(), range.min, range.max);
        }
    }
    Ok(calibration)
}

/// A field file, or the labels of a store; frames that a guard refused don't count.
fn read_target(path: &Path) -> anyhow::Result<FieldFile> {
    if !path.is_dir() {
        return Ok(FieldFile::read(path)?);
    }
    let store = ZarrReader::open(path)?;
    let frames = 0..store.len();
    let mask = |name: &str| -> anyhow::Result<Vec<u8>> {
        let mut mask = match store.has(name) {
            true => store.read_u8(name, frames.clone())?,
            false => vec![1; store.len() * N_FIELD],
        };
        if store.has(FRAME_VALIDITY) {
            let validity = store.read_u8(FRAME_VALIDITY, frames.clone())?;
            mask.chunks_mut(N_FIELD).zip(validity).filter(|(_, code)| *code != 0).for_each(|(row, _)| row.fill(0));
        }
        Ok(mask)
    };
    Ok(FieldFile {
        topology: Some(store.attributes().topology),
        fields: Fields {
            force: store.read_f32(MANO_FORCE, frames.clone())?,
            contact: store.read_contact(frames.clone())?,
        },
        mask_force: mask(MANO_FORCE_VALID)?,
        mask_contact: mask(MANO_CONTACT_VALID)?,
        timestamps: store.read(TIMESTAMPS, frames.clone())?.into_f64(),
        episode_ends: store.episode_ends().to_vec(),
    })
}

fn print_reports(reports: &[(&str, &Report)], json: bool) -> anyhow::Result<()> {
    if !json {
        println!("{}", metrics::table(reports));
        return Ok(());
    }
    // One report is the document itself; several lie under their names.
    let value = match reports {
        [(_, report)] => serde_json::to_value(report)?,
        _ => serde_json::to_value(reports.iter().copied().collect::<std::collections::BTreeMap<_, _>>())?,
    };
    println!("{value:#}");
    Ok(())
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("expected a number above 0".into()),
    }
}
