//! Predictions and truth that `egotac eval` scores, from files or from a checkpoint.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};

use super::calibration;
use super::truth::{read, truth};
use super::{Args, Case};
use crate::cli::predict;
use crate::dataset::tensors;
use crate::hand::Topology;
use crate::model::{Predictor, predictor};
use crate::score::metrics::{EvalOptions, baseline};
use crate::tactile::TactileSequence;
use crate::text::tell;

/// Runs a checkpoint on stores.
pub fn of_checkpoint(args: &Args, checkpoint: &Path) -> anyhow::Result<Case> {
    let stream = predictor::Options { precision: args.precision, ..predict::stream() };
    let mut predictor = Predictor::load(checkpoint, args.doubt.apply(stream))?;
    crate::cli::progress::tell_network(checkpoint, &predictor);
    if let Some(warning) = predictor.warning() {
        tell(format_args!("warning: {warning}"));
    }
    if args.untrained_force {
        predictor = predictor.with_untrained_force();
    }
    if let Some(mano) = args.hands.map()? {
        predictor = predictor.with_mano(mano);
    }
    let topology = predictor.topology();
    let (target, origins) = truth(args, &args.data)?;
    target.topology.unwrap_or_default().must_match(topology)?;
    // Checks all other inputs first: predicting may take hours.
    let constants = constants(args, topology)?;
    let split = calibration::truth(args)?;
    if let Some(split) = &split {
        split.topology.unwrap_or_default().must_match(topology)?;
    }
    let pred = predicted(args, &args.data, &mut predictor)?;
    let calibration = match split {
        Some(split) => {
            let pred = predicted(args, &args.calibration_from, &mut predictor)?;
            Some(calibration::measure(args, &pred, &split)?)
        }
        None => calibration::read(args)?,
    };
    let lag = args.lag().or(Some(predictor.metadata().frame_dt));
    let options = EvalOptions { calibration, fps: args.fps };
    let baselines = baselines(constants, &target, lag);
    // The intervals are those of vertices of the checkpoint's topology.
    let spread = predictor.spread().filter(|_| predictor.mano().is_none()).cloned();
    Ok(Case { pred, target, options, baselines, lag, unknown: None, origins, spread })
}

/// Reads predictions and truth from files.
pub fn of_files(args: &Args, pred_path: &Path, target_path: &Path) -> anyhow::Result<Case> {
    let pred = read(args, pred_path)?;
    // Frames of a store that a guard refused are masked out.
    let (target, origins) = match target_path.is_dir() {
        true => truth(args, &[target_path.to_path_buf()])?,
        false => (read(args, target_path)?, Vec::new()),
    };
    if let (Some(pred), Some(target)) = (pred.topology, target.topology) {
        pred.must_match(target)?;
    }
    same_length(pred_path, &pred, target.n_frames()).with_context(|| format!("beside {}", target_path.display()))?;
    let calibration = match (calibration::truth(args)?, &args.calibration_pred) {
        (Some(split), Some(path)) => {
            let pred = read(args, path)?;
            same_length(path, &pred, split.n_frames())?;
            Some(calibration::measure(args, &pred, &split)?)
        }
        (Some(_), None) => bail!("--calibration-from: give --calibration-pred, the predicted fields of these stores"),
        (None, _) => calibration::read(args)?,
    };
    let topology = target.topology.or(pred.topology).unwrap_or_default();
    let baselines = baselines(constants(args, topology)?, &target, args.lag());
    let options = EvalOptions { calibration, fps: args.fps };
    let lag = args.lag();
    Ok(Case { pred, target, options, baselines, lag, unknown: None, origins, spread: None })
}

/// Checks that another prediction has the case's frames and topology.
pub fn must_fit(path: &Path, other: &TactileSequence, case: &Case) -> anyhow::Result<()> {
    if let (Some(topology), Some(other)) = (case.target.topology.or(case.pred.topology), other.topology) {
        topology.must_match(other).with_context(|| path.display().to_string())?;
    }
    same_length(path, other, case.target.n_frames())
}

/// Predicts touch on stores.
fn predicted(args: &Args, paths: &[PathBuf], predictor: &mut Predictor) -> anyhow::Result<TactileSequence> {
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("fields.safetensors");
    predict::predict_stores(paths, predictor, args.precision, &file)?;
    Ok(tensors::read(&file)?)
}

/// Returns the constant predictions: zero, and mean and median where training stores are given.
fn constants(args: &Args, topology: Topology) -> anyhow::Result<Vec<baseline::Constant>> {
    let training = &args.baselines_from;
    if training.is_empty() {
        return Ok(vec![baseline::zero()]);
    }
    let truth = truth(args, training)?.0;
    truth.topology.unwrap_or_default().must_match(topology)?;
    Ok(baseline::constants(&truth).into())
}

/// Returns the constants and persistence, as long as the truth.
fn baselines(
    constants: Vec<baseline::Constant>,
    target: &TactileSequence,
    lag: Option<f64>,
) -> Vec<(&'static str, TactileSequence)> {
    let constants = constants.into_iter().map(|constant| (constant.name, constant.sequence(target.n_frames())));
    constants.chain(std::iter::once(("persistence", baseline::persistence(target, lag)))).collect()
}

fn same_length(path: &Path, sequence: &TactileSequence, n_frames: usize) -> anyhow::Result<()> {
    if sequence.n_frames() != n_frames {
        bail!("{} has {} frames, expected the truth's {n_frames}", path.display(), sequence.n_frames());
    }
    Ok(())
}
