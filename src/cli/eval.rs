//! `egotac eval`.

mod calibration;
mod cases;
mod groups;
mod output;
mod truth;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::bail;

use crate::hand::Side;
use crate::model::{Precision, Spread};
use crate::score::metrics::{self, Comparison, Coverage, EvalOptions, Intervals, Metrics, Reliability, VertexGroup};
use crate::tactile::TactileSequence;

use super::doubt::Doubt;
use super::hands::Hands;
use super::options::{Json, Time};
use groups::Grouping;

/// Arguments of `egotac eval`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Undefined scores (no contact in truth, a truth that does not change, ...) are null in JSON and `undefined` in \
    the table.\nA contact is predicted where its probability is above 0.5 and true where the force is above 0.05 N.\nFrame \
    mean: contact scores of each frame with contact, averaged, as the paper does; pooled: over all vertices of all frames.\n\
    Temporal scores are averages over episodes. A constant prediction of a changing truth has correlations of 0; an episode \
    whose truth does not change has no temporal scores; frames that are masked whole are gaps.\nIntervals are 95 % bootstrap \
    intervals over episodes.\nzero and persistence (the truth of a moment ago) stand beside every prediction."
)]
pub struct Args {
    /// Predicted fields: safetensors with `force` and `contact`, (T, 1556) each.
    #[arg(long, value_name = "FILE", requires = "target", required_unless_present = "checkpoint")]
    pred: Option<PathBuf>,
    /// True fields: safetensors as above (also `mask_force`, `mask_contact`, `episode_ends`), or a Zarr store.
    #[arg(long, value_name = "FILE|STORE", requires = "pred")]
    target: Option<PathBuf>,
    /// Checkpoint to run on `--data`, instead of `--pred` and `--target`.
    #[arg(long, value_name = "FILE|shipped", value_parser = super::options::checkpoint(), requires = "data", conflicts_with = "pred")]
    checkpoint: Option<PathBuf>,
    /// Number format that the checkpoint runs in: f32, bf16 or int8.
    #[arg(long, requires = "checkpoint", default_value = "f32")]
    precision: Precision,
    /// Score the force head as it is, also where no force ever trained it; by default such forces are unknown.
    #[arg(long, requires = "checkpoint")]
    untrained_force: bool,
    /// Zarr stores with truth, or folders of them.
    #[arg(long, value_name = "STORE", num_args = 1.., requires = "checkpoint")]
    data: Vec<PathBuf>,
    /// Training stores; also scores two constant predictions from them: the mean and the median of each vertex.
    #[arg(long, value_name = "STORE", num_args = 1..)]
    baselines_from: Vec<PathBuf>,
    /// Age of the truth that `persistence` repeats, such as 120ms; by default one observation step of the checkpoint, one frame for
    /// `--pred`.
    #[arg(long, value_name = "TIME", value_parser = super::options::positive_time)]
    persistence: Option<Time>,
    /// Frames per second, for the dominant frequency; by default from the target's timestamps.
    #[arg(long, value_name = "F", value_parser = super::positive)]
    fps: Option<f64>,
    /// JSON file with the range of the total force, N: {"min": .., "max": ..}, or one range each under "pred" and
    /// "target"; by default the range of the data. With a range, spectra are those of normalised traces too.
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Stores of a calibration split, whose ranges of predicted and true total force are used as `--calibration`.
    #[arg(long, value_name = "STORE", num_args = 1.., conflicts_with = "calibration")]
    calibration_from: Vec<PathBuf>,
    /// Predicted fields of the calibration split, for `--pred`; a checkpoint predicts them itself.
    #[arg(long, value_name = "FILE", requires_all = ["calibration_from", "pred"])]
    calibration_pred: Option<PathBuf>,
    /// JSON file to write the ranges of `--calibration-from` to.
    #[arg(long, value_name = "FILE", requires = "calibration_from")]
    calibration_out: Option<PathBuf>,
    /// Score only the vertices of the right hand.
    #[arg(long)]
    right_hand_only: bool,
    /// Also score groups separately, each with intervals: scene, source (store), side (hand), region; regions of MANO fields
    /// need the MANO files, with which all fields are scored on MANO's vertices.
    #[arg(long, value_name = "GROUP,..", value_delimiter = ',')]
    by: Vec<Grouping>,
    /// Short for `--by scene`.
    #[arg(long)]
    by_scene: bool,
    /// Scores to compute: those of the EgoTac paper, or by EgoPHI's protocol (contact at 0.3, force error on touched vertices,
    /// averaged over the hands that touch).
    #[arg(long, value_enum, default_value_t = Protocol::Paper)]
    protocol: Protocol,
    /// Predicted fields of another estimator for the same frames: also scores these, with the paired difference and its
    /// 95 % interval (bootstrap over episodes).
    #[arg(long, value_name = "FILE")]
    against: Option<PathBuf>,
    /// Seed of the bootstrap.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    json: Json,
    #[command(flatten)]
    hands: Hands,
    #[command(flatten)]
    doubt: Doubt,
}

impl Args {
    /// Returns the age of the truth that `persistence` repeats, s.
    fn lag(&self) -> Option<f64> {
        self.persistence.map(|Time(secs)| secs)
    }
}

/// Definition of the scores.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Protocol {
    /// The EgoTac paper's.
    Paper,
    /// EgoPHI's.
    Egophi,
}

/// Sequences to score.
struct Case {
    pred: TactileSequence,
    target: TactileSequence,
    options: EvalOptions,
    /// Predictions that see no image, to score beside `pred`.
    baselines: Vec<(&'static str, TactileSequence)>,
    /// Age of the truth that `persistence` repeats, s; None = one frame.
    lag: Option<f64>,
    /// Share of the hands of all frames that the prediction leaves unknown and scores leave out; None if it says nothing.
    unknown: Option<f64>,
    /// Store and scene of each episode; empty if they are not known.
    origins: Vec<groups::Origin>,
    /// Intervals of the forces, of a checkpoint that has them.
    spread: Option<Spread>,
}

impl Case {
    /// Masks the truth where the prediction's own masks say that it is unknown, and counts these entries.
    fn leave_out_unknown(&mut self) {
        let entries = self.pred.force.len().max(1);
        let pairs = [
            (&self.pred.mask_force, &mut self.target.mask_force),
            (&self.pred.mask_contact, &mut self.target.mask_contact),
        ];
        for (known, mask) in pairs.into_iter().filter(|(known, _)| !known.is_empty()) {
            mask.resize(entries, 1);
            mask.iter_mut().zip(known).for_each(|(mask, known)| *mask &= known);
        }
        let known = &self.pred.mask_contact;
        let unknown = known.iter().filter(|known| **known == 0).count();
        self.unknown = (!known.is_empty()).then_some(unknown as f64 / entries as f64);
    }
}

/// Results of the command.
struct Scored {
    metrics: Metrics,
    intervals: Intervals,
    baselines: Vec<(&'static str, Metrics)>,
    lag: Option<f64>,
    unknown: Option<f64>,
    reliability: Reliability,
    coverage: Option<Coverage>,
    groups: Vec<groups::Scored>,
    against: Option<Comparison>,
    options: EvalOptions,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let groupings = groupings(&args)?;
    let mut case = match (&args.pred, &args.target, &args.checkpoint) {
        (Some(pred), Some(target), None) => cases::of_files(&args, pred, target)?,
        (None, None, Some(checkpoint)) => cases::of_checkpoint(&args, checkpoint)?,
        _ => bail!("give --pred and --target, or --checkpoint and --data"),
    };
    case.leave_out_unknown();
    let TactileSequence { mask_force, mask_contact, .. } = &case.target;
    if [mask_force, mask_contact].iter().all(|mask| !mask.is_empty() && !mask.contains(&1)) {
        bail!("the truth has no supervised force or contact to score; `egotac data info` tells what a store holds");
    }
    if args.right_hand_only {
        VertexGroup::hand(Side::Right).restrict(&mut case.target);
    }
    match args.protocol {
        Protocol::Paper => output::write(&score(&args, &groupings, &mut case)?, &args.json)?,
        Protocol::Egophi => output::write_egophi(&case, args.seed, &args.json)?,
    }
    Ok(ExitCode::SUCCESS)
}

/// Returns the groupings of `--by` and `--by-scene`, each once.
fn groupings(args: &Args) -> anyhow::Result<Vec<Grouping>> {
    let mut all = args.by.clone();
    all.extend(args.by_scene.then_some(Grouping::Scene));
    let mut once: Vec<Grouping> = Vec::new();
    all.into_iter().for_each(|by| once.extend((!once.contains(&by)).then_some(by)));
    let calibrated = args.calibration.is_some() || !args.calibration_from.is_empty();
    if args.protocol == Protocol::Egophi && (!once.is_empty() || args.against.is_some() || calibrated) {
        bail!(
            "--protocol egophi: expected without --by, --by-scene, --against and calibration, which it does not define"
        );
    }
    Ok(once)
}

fn score(args: &Args, groupings: &[Grouping], case: &mut Case) -> anyhow::Result<Scored> {
    let metrics = metrics::evaluate(&case.pred, &case.target, &case.options)?;
    let intervals = metrics::intervals(&case.pred, &case.target, &case.options, args.seed)?;
    let mut baselines = Vec::new();
    for (name, fields) in &case.baselines {
        let options =
            EvalOptions { calibration: calibration::of_baseline(name, &case.options), ..case.options.clone() };
        baselines.push((*name, metrics::evaluate(fields, &case.target, &options)?));
    }
    let mut scored = Vec::new();
    for grouping in groupings {
        scored.push(groups::score(*grouping, args, case)?);
    }
    let against = match &args.against {
        Some(path) => {
            let other = truth::read(args, path)?;
            cases::must_fit(path, &other, case)?;
            Some(metrics::compare(&case.pred, &other, &case.target, &case.options, args.seed)?)
        }
        None => None,
    };
    let reliability = metrics::reliability(&case.pred, &case.target);
    let coverage =
        case.spread.as_ref().map(|spread| metrics::coverage(&case.pred, &case.target, spread)).transpose()?;
    Ok(Scored {
        metrics,
        intervals,
        baselines,
        lag: case.lag,
        unknown: case.unknown,
        reliability,
        coverage,
        groups: scored,
        against,
        options: case.options.clone(),
    })
}
