//! `egotac eval`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, bail};

use crate::dataset::tensors;
use crate::dataset::zarr::{self, ZarrReader, read_truth};
use crate::file::{input, limits};
use crate::hand::{HandModel, Side, Topology};
use crate::model::{Precision, Predictor, predictor};
use crate::score::metrics::{self, Calibration, Comparison, EvalOptions, Metrics, VertexGroup};
use crate::tactile::TactileSequence;
use crate::text::printable;
use crate::train::baseline;
use crate::train::data::Dataset;

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
    /// Checkpoint to run on `--data`, instead of `--pred` and `--target`.
    #[arg(long, value_name = "FILE", requires = "data", conflicts_with = "pred")]
    checkpoint: Option<PathBuf>,
    /// Number format that the checkpoint runs in: f32, bf16 or int8.
    #[arg(long, requires = "checkpoint", default_value = "f32")]
    precision: Precision,
    /// Zarr stores with truth, or folders of them.
    #[arg(long, value_name = "STORE", num_args = 1.., requires = "checkpoint")]
    data: Vec<PathBuf>,
    /// Training stores; also scores three constant predictions: zero, and the mean and the median of each vertex over these
    /// stores.
    #[arg(long, value_name = "STORE", num_args = 1.., requires = "checkpoint")]
    baselines_from: Vec<PathBuf>,
    /// Frames per second, for the dominant frequency; by default from the target's timestamps.
    #[arg(long, value_name = "F", value_parser = super::positive)]
    fps: Option<f64>,
    /// JSON file with the range of the total force, N: {"min": .., "max": ..}, or one range each under "pred" and
    /// "target"; by default the range of the data.
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Score only the vertices of the right hand.
    #[arg(long)]
    right_hand_only: bool,
    /// Also score each hand and each region separately; regions of MANO fields need the MANO files.
    #[arg(long)]
    parts: bool,
    /// Predicted fields of another estimator for the same frames: also scores these, with the paired difference and its
    /// 95 % interval (bootstrap over episodes).
    #[arg(long, value_name = "FILE")]
    against: Option<PathBuf>,
    /// Seed of the bootstrap.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Print JSON instead of a table.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    hands: Hands,
}

/// Sequences to score.
struct Case {
    pred: TactileSequence,
    target: TactileSequence,
    options: EvalOptions,
    /// Constant predictions to score beside `pred`.
    constants: Vec<(&'static str, TactileSequence)>,
}

/// Results of the command.
struct Scored {
    estimators: Vec<(&'static str, Metrics)>,
    groups: Vec<(String, Metrics)>,
    against: Option<Comparison>,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let mut case = match (&args.pred, &args.target, &args.checkpoint) {
        (Some(pred), Some(target), None) => of_files(&args, pred, target)?,
        (None, None, Some(checkpoint)) => of_checkpoint(&args, checkpoint)?,
        _ => bail!("give --pred and --target, or --checkpoint and --data"),
    };
    let TactileSequence { mask_force, mask_contact, .. } = &case.target;
    if [mask_force, mask_contact].iter().all(|mask| !mask.is_empty() && !mask.contains(&1)) {
        bail!("the truth has no supervised force or contact to score; `egotac data info` tells what a store holds");
    }
    if args.right_hand_only {
        VertexGroup::hand(Side::Right).restrict(&mut case.target);
    }
    let scored = score(&args, &mut case)?;
    match args.json {
        true => println!("{}", printable(&format!("{:#}", json(&scored)?))),
        false => print(&scored),
    }
    Ok(ExitCode::SUCCESS)
}

fn score(args: &Args, case: &mut Case) -> anyhow::Result<Scored> {
    let Case { pred, target, options, constants } = case;
    let name = if constants.is_empty() { "prediction" } else { "model" };
    let mut estimators = vec![(name, metrics::evaluate(pred, target, options)?)];
    for (name, constant) in constants {
        estimators.push((name, metrics::evaluate(constant, target, options)?));
    }
    let mut groups = Vec::new();
    if args.parts {
        for group in vertex_groups(args, target.topology.or(pred.topology).unwrap_or_default())? {
            let masks = [target.mask_force.clone(), target.mask_contact.clone()];
            group.restrict(target);
            groups.push((group.name, metrics::evaluate(pred, target, options)?));
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
    Ok(Scored { estimators, groups, against })
}

/// Returns the groups of `--parts`: both hands, then every region.
fn vertex_groups(args: &Args, topology: Topology) -> anyhow::Result<Vec<VertexGroup>> {
    let models = match (args.hands.files()?, topology) {
        (Some(models), _) => models,
        (None, Topology::EgotacHand1) => Side::BOTH.map(HandModel::builtin),
        (None, Topology::Mano) => {
            bail!("--parts: the fields are on MANO's vertices; give --mano-left and --mano-right")
        }
    };
    models.iter().try_for_each(|model| topology.must_match(model.topology))?;
    Ok(Side::BOTH.into_iter().map(VertexGroup::hand).chain(VertexGroup::regions(&models)).collect())
}

/// Runs a checkpoint on stores, and makes the constant predictions.
fn of_checkpoint(args: &Args, checkpoint: &Path) -> anyhow::Result<Case> {
    let stream = predictor::Options { precision: args.precision, ..super::predict::stream() };
    let mut predictor = Predictor::load(checkpoint, stream)?;
    let topology = predictor.metadata().topology;
    let preparation = predictor.metadata().preparation(predictor.config());
    let open = |paths: &[PathBuf]| -> anyhow::Result<Dataset> {
        let data = Dataset::new(zarr::open_all(paths)?, preparation.clone(), false)?;
        data.topology().must_match(topology)?;
        Ok(data)
    };
    let data = open(&args.data)?;
    let target = data.labels()?;
    let options = options(args)?;
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("fields.safetensors");
    super::predict::predict_stores(&args.data, &mut predictor, args.precision, &file)?;
    let pred = tensors::read(&file)?;
    let mut constants = Vec::new();
    if !args.baselines_from.is_empty() {
        for constant in baseline::constants(&open(&args.baselines_from)?.labels()?) {
            constants.push((constant.name, constant.sequence(target.n_frames())));
        }
    }
    Ok(Case { pred, target, options, constants })
}

/// Reads predictions and truth from files.
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
    Ok(calibration)
}

fn print(scored: &Scored) {
    let estimators: Vec<_> = scored.estimators.iter().map(|(name, metrics)| (*name, metrics)).collect();
    println!("{}", printable(&metrics::table(&estimators)));
    if !scored.groups.is_empty() {
        println!("\n{}", printable(&metrics::groups_table(&scored.groups)));
    }
    if let Some(comparison) = &scored.against {
        println!("\n{}", printable(&metrics::comparison_table(comparison)));
    }
}

/// Returns the scores as JSON: those of one estimator at the top level, those of several under their names. Groups and the
/// comparison are added.
fn json(scored: &Scored) -> anyhow::Result<serde_json::Value> {
    let mut value = match scored.estimators.as_slice() {
        [(_, only)] => serde_json::to_value(only)?,
        several => serde_json::to_value(several.iter().cloned().collect::<std::collections::BTreeMap<_, _>>())?,
    };
    if !scored.groups.is_empty() {
        let groups = scored.groups.iter().map(|(name, metrics)| Ok((name.clone(), serde_json::to_value(metrics)?)));
        value["parts"] = groups.collect::<serde_json::Result<serde_json::Map<_, _>>>()?.into();
    }
    if let Some(comparison) = &scored.against {
        value["against"] = serde_json::to_value(comparison)?;
    }
    Ok(value)
}
