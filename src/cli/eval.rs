//! `egotac eval`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, bail};

use crate::dataset::tensors;
use crate::dataset::zarr::{self, ZarrReader};
use crate::hand::{HandModel, Side, Topology};
use crate::model::{Checkpoint, Precision};
use crate::score::metrics::{self, Calibration, Comparison, EvalOptions, Part, Report};
use crate::tactile::TactileSequence;
use crate::train::baseline;
use crate::train::data::{Dataset, read_truth};

use super::hands::Hands;

/// Arguments of `egotac eval`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Undefined scores (no contact in truth, a constant trace, ...) are null in JSON and `undefined` in the table.\n\
    A contact is predicted where its probability is above 0.5 and true where the force is above 0.05 N."
)]
pub struct Args {
    /// Predicted fields: safetensors with `force` and `contact`, (T, 1556) each.
    #[arg(long, value_name = "FILE", requires = "target", required_unless_present = "checkpoint")]
    pred: Option<PathBuf>,
    /// True fields: safetensors as above (also `mask_force`, `mask_contact`, `episode_ends`), or a Zarr store.
    #[arg(long, value_name = "FILE|STORE", requires = "pred")]
    target: Option<PathBuf>,
    /// Checkpoint to run on `--data` in place of `--pred` and `--target`.
    #[arg(long, value_name = "FILE", requires = "data", conflicts_with = "pred")]
    checkpoint: Option<PathBuf>,
    /// Number format that the checkpoint runs in: f32, bf16 or int8.
    #[arg(long, requires = "checkpoint", default_value = "f32")]
    precision: Precision,
    /// Zarr stores with truth, or folders of them.
    #[arg(long, value_name = "STORE", num_args = 1.., requires = "checkpoint")]
    data: Vec<PathBuf>,
    /// Training stores: score beside the checkpoint three constants, namely zero, and the mean and the median of each
    /// vertex over these stores.
    #[arg(long, value_name = "STORE", num_args = 1.., requires = "checkpoint")]
    baselines_from: Vec<PathBuf>,
    /// Frames per second, for the dominant frequency; by default from the target's timestamps.
    #[arg(long, value_name = "F", value_parser = super::positive)]
    fps: Option<f64>,
    /// JSON file with the range of the total force, N: {"min": .., "max": ..}, or one each under "pred" and "target";
    /// by default the range of the data.
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Count the right hand's vertices alone.
    #[arg(long)]
    right_hand_only: bool,
    /// Also score each hand and each region by itself; regions of MANO fields need the hands' files.
    #[arg(long)]
    parts: bool,
    /// Another estimator's fields of the same frames, in a file as for --pred: scored by the same protocol, with the paired
    /// difference and its 95 % interval (bootstrap over episodes).
    #[arg(long, value_name = "FILE")]
    against: Option<PathBuf>,
    /// Seed of the bootstrap's drawings.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Print JSON in place of a table.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    hands: Hands,
}

/// What is scored.
struct Case {
    pred: TactileSequence,
    target: TactileSequence,
    options: EvalOptions,
    /// Constants to score beside the prediction.
    constants: Vec<(&'static str, TactileSequence)>,
}

/// All that was asked for.
struct Scored {
    reports: Vec<(&'static str, Report)>,
    parts: Vec<(String, Report)>,
    against: Option<Comparison>,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let mut case = match (&args.pred, &args.target, &args.checkpoint) {
        (Some(pred), Some(target), None) => of_files(&args, pred, target)?,
        (None, None, Some(checkpoint)) => of_checkpoint(&args, checkpoint)?,
        _ => bail!("give --pred and --target, or --checkpoint and --data"),
    };
    if args.right_hand_only {
        Part::hand(Side::Right).restrict(&mut case.target);
    }
    let scored = score(&args, &mut case)?;
    match args.json {
        true => println!("{:#}", json(&scored)?),
        false => print(&scored),
    }
    Ok(ExitCode::SUCCESS)
}

fn score(args: &Args, case: &mut Case) -> anyhow::Result<Scored> {
    let Case { pred, target, options, constants } = case;
    let name = if constants.is_empty() { "prediction" } else { "model" };
    let mut reports = vec![(name, metrics::evaluate(pred, target, options)?)];
    for (name, fields) in constants {
        reports.push((name, metrics::evaluate(fields, target, options)?));
    }
    let mut scored = Vec::new();
    if args.parts {
        for part in parts(args, target.topology.or(pred.topology).unwrap_or_default())? {
            let masks = [target.mask_force.clone(), target.mask_contact.clone()];
            part.restrict(target);
            scored.push((part.name, metrics::evaluate(pred, target, options)?));
            [target.mask_force, target.mask_contact] = masks;
        }
    }
    let against = match &args.against {
        Some(path) => {
            let other = tensors::read(path)?;
            if let (Some(topology), Some(other)) = (target.topology.or(pred.topology), other.topology) {
                topology.must_match(other).with_context(|| path.display().to_string())?;
            }
            same_length(path, &other, target.n_frames())?;
            Some(metrics::compare(pred, &other, target, options, args.seed)?)
        }
        None => None,
    };
    Ok(Scored { reports, parts: scored, against })
}

/// Both hands, then every region whose vertices are known.
fn parts(args: &Args, topology: Topology) -> anyhow::Result<Vec<Part>> {
    let models = match (args.hands.files()?, topology) {
        (Some(models), _) => models,
        (None, Topology::EgotacHand1) => Side::BOTH.map(HandModel::builtin),
        (None, Topology::Mano) => {
            bail!("--parts: the fields are on MANO's vertices; give --mano-left and --mano-right")
        }
    };
    models.iter().try_for_each(|model| topology.must_match(model.topology))?;
    Ok(Side::BOTH.into_iter().map(Part::hand).chain(Part::regions(&models)).collect())
}

/// A checkpoint's predictions, and the constants beside it.
fn of_checkpoint(args: &Args, checkpoint: &Path) -> anyhow::Result<Case> {
    let device = candle_core::Device::Cpu;
    let checkpoint = Checkpoint::load_as(checkpoint, &device, args.precision)?;
    let preparation = checkpoint.metadata.preparation(checkpoint.model.config());
    let open = |paths: &[PathBuf]| -> anyhow::Result<Dataset> {
        let data = Dataset::new(zarr::open_all(paths)?, preparation.clone(), false)?;
        data.topology().must_match(checkpoint.metadata.topology)?;
        Ok(data)
    };
    let data = open(&args.data)?;
    let target = data.labels()?;
    let options = options(args)?;
    let pred = super::predict::predict_stores(&checkpoint, &data, &device)?;
    let mut constants = Vec::new();
    if !args.baselines_from.is_empty() {
        for constant in baseline::constants(&open(&args.baselines_from)?.labels()?) {
            constants.push((constant.name, constant.sequence(target.n_frames())));
        }
    }
    Ok(Case { pred, target, options, constants })
}

fn of_files(args: &Args, pred_path: &Path, target_path: &Path) -> anyhow::Result<Case> {
    let pred = tensors::read(pred_path)?;
    // Frames of a store that a guard refused are masked out.
    let target = match target_path.is_dir() {
        true => read_truth(&ZarrReader::open(target_path)?)?,
        false => tensors::read(target_path)?,
    };
    if let (Some(pred), Some(target)) = (pred.topology, target.topology) {
        pred.must_match(target)?;
    }
    same_length(pred_path, &pred, target.n_frames()).with_context(|| format!("beside {}", target_path.display()))?;
    Ok(Case { pred, target, options: options(args)?, constants: vec![] })
}

fn same_length(path: &Path, sequence: &TactileSequence, n_frames: usize) -> anyhow::Result<()> {
    if sequence.n_frames() != n_frames {
        bail!("{} has {} frames, expected the truth's {n_frames}", path.display(), sequence.n_frames());
    }
    Ok(())
}

fn options(args: &Args) -> anyhow::Result<EvalOptions> {
    let calibration = args.calibration.as_deref().map(read_calibration).transpose()?;
    Ok(EvalOptions { calibration, fps: args.fps })
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

fn print(scored: &Scored) {
    let reports: Vec<(&str, &Report)> = scored.reports.iter().map(|(name, report)| (*name, report)).collect();
    println!("{}", metrics::table(&reports));
    if !scored.parts.is_empty() {
        println!("\n{}", metrics::parts_table(&scored.parts));
    }
    if let Some(comparison) = &scored.against {
        println!("\n{}", metrics::comparison_table(comparison));
    }
}

/// One report is the document itself; several lie under their names. Parts and the comparison are added.
fn json(scored: &Scored) -> anyhow::Result<serde_json::Value> {
    let mut value = match scored.reports.as_slice() {
        [(_, report)] => serde_json::to_value(report)?,
        reports => serde_json::to_value(reports.iter().cloned().collect::<std::collections::BTreeMap<_, _>>())?,
    };
    if !scored.parts.is_empty() {
        let parts = scored.parts.iter().map(|(name, report)| Ok((name.clone(), serde_json::to_value(report)?)));
        value["parts"] = parts.collect::<serde_json::Result<serde_json::Map<_, _>>>()?.into();
    }
    if let Some(comparison) = &scored.against {
        value["against"] = serde_json::to_value(comparison)?;
    }
    Ok(value)
}
