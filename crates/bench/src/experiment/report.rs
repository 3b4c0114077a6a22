//! Results of an experiment: scores of every run, and each arm against the first.

use std::path::PathBuf;

use egotac::dataset::tensors;
use egotac::dataset::zarr;
use egotac::error::Result;
use egotac::machine::Machine;
use egotac::model::checkpoint::parameter_count;
use egotac::score::metrics::Difference;
use egotac::score::metrics::{self, EvalOptions, baseline};
use egotac::tactile::TactileSequence;
use egotac::text::put;
use egotac::train::Config;
use egotac::train::data::Dataset;
use serde::Serialize;

use super::data::{Domain, SIDE, Stores};
use super::{Arm, Experiment, Size, fields_file};

/// Scores in plots: name in a report, name for readers, true if more is better.
pub const SHOWN: [(&str, &str, bool); 6] = [
    ("frame_mean.f1", "contact F1, frame mean", true),
    ("frame_mean.iou", "contact IoU, frame mean", true),
    ("frame_mean.auroc", "AUROC, frame mean", true),
    ("active_mae", "active MAE (N)", false),
    ("temporal_pearson", "temporal Pearson", true),
    ("force_cosine", "force cosine", true),
];

/// Columns of the table of contact and force: name in a report, name for readers.
const COLUMNS: [(&str, &str); 7] = [
    ("frame_mean.f1", "F1, frame mean"),
    ("frame_mean.iou", "IoU, frame mean"),
    ("frame_mean.auroc", "AUROC, frame mean"),
    ("false_positive_rate", "false-positive rate"),
    ("pooled.f1", "F1, pooled"),
    ("active_mae", "active MAE (N)"),
    ("temporal_pearson", "temporal Pearson"),
];

/// Columns of the table of dynamics.
const DYNAMICS: [(&str, &str); 6] = [
    ("force_cosine", "force cosine"),
    ("rise_f1", "rise F1"),
    ("fall_f1", "fall F1"),
    ("dft_pearson", "DFT Pearson"),
    ("spectral_convergence", "spectral convergence"),
    ("dominant_frequency_error_hz", "dominant frequency error (Hz)"),
];

/// Score whose difference from the first arm stands in the table.
const COMPARED: &str = "frame_mean.f1";

/// Results of an experiment.
#[derive(Debug, Clone, Serialize)]
pub struct ExperimentReport {
    /// Name of the experiment.
    pub experiment: &'static str,
    /// Question of the experiment.
    pub question: &'static str,
    /// The command that measures the same again.
    pub command: String,
    /// Version of egotac.
    pub egotac: &'static str,
    /// The machine that it ran on.
    pub machine: Machine,
    /// Size of the experiment.
    pub size: Size,
    /// Side of the input, pixels.
    pub image: u32,
    /// Parameters of the network.
    pub parameters: usize,
    /// Held-out frames in and out of the domain.
    pub held_out_frames: [usize; 2],
    /// Results of the arms; the others are compared with the first.
    pub arms: Vec<ArmReport>,
    /// Scores of predictions that see no image.
    pub baselines: Vec<BaselineReport>,
}

/// Scores of a prediction that sees no image: a constant, or the truth of the frame before.
#[derive(Debug, Clone, Serialize)]
pub struct BaselineReport {
    /// Name of the prediction.
    pub name: &'static str,
    /// Scores in the domain.
    pub in_domain: metrics::Metrics,
    /// Scores out of the domain.
    pub out_of_domain: metrics::Metrics,
}

/// Results of one arm.
#[derive(Debug, Clone, Serialize)]
pub struct ArmReport {
    /// Name of the arm.
    pub name: &'static str,
    /// Difference from the usual run, in words.
    pub about: &'static str,
    /// Training frames.
    pub training_frames: usize,
    /// Minutes of training, by seed.
    pub minutes: Vec<f64>,
    /// Scores in the domain.
    pub in_domain: DomainReport,
    /// Scores out of the domain.
    pub out_of_domain: DomainReport,
}

/// Scores in one domain.
#[derive(Debug, Clone, Serialize)]
pub struct DomainReport {
    /// Scores of each seed.
    pub seeds: Vec<metrics::Metrics>,
    /// Differences from the first arm over all seeds, with 95 % intervals by resampling the same episodes for both.
    pub against_first: Vec<Difference>,
}

impl ArmReport {
    /// Returns the scores in a domain.
    pub fn domain(&self, domain: Domain) -> &DomainReport {
        match domain {
            Domain::InDomain => &self.in_domain,
            Domain::OutOfDomain => &self.out_of_domain,
        }
    }
}

impl DomainReport {
    /// Returns a score for each seed, by its name in a report.
    pub fn score(&self, name: &str) -> Vec<Option<f64>> {
        self.seeds.iter().map(|report| report.score(name)).collect()
    }
}

impl BaselineReport {
    /// Returns the scores in a domain.
    pub fn domain(&self, domain: Domain) -> &metrics::Metrics {
        match domain {
            Domain::InDomain => &self.in_domain,
            Domain::OutOfDomain => &self.out_of_domain,
        }
    }
}

/// Scores the predictions of all runs.
pub(super) fn make(
    experiment: &Experiment,
    size: &Size,
    stores: &Stores,
    runs: &[(&Arm, u64, &Config)],
    command: String,
) -> Result<ExperimentReport> {
    let mut truths = Vec::new();
    for domain in Domain::ALL {
        truths.push(truth(stores, domain)?);
    }
    let mut arms = Vec::new();
    for arm in &experiment.arms {
        let own = runs_of(runs, arm);
        let first = runs_of(runs, &experiment.arms[0]);
        let mut domains = Vec::new();
        for (domain, truth) in Domain::ALL.into_iter().zip(&truths) {
            domains.push(score(&own, &first, domain, truth)?);
        }
        let minutes = own.iter().map(|config| minutes(config)).collect();
        let training_frames = own.first().map_or(Ok(0), |config| frames(config))?;
        if let (Some(out_of_domain), Some(in_domain)) = (domains.pop(), domains.pop()) {
            let (name, about) = (arm.name, arm.about);
            arms.push(ArmReport { name, about, training_frames, minutes, in_domain, out_of_domain });
        }
    }
    Ok(ExperimentReport {
        experiment: experiment.name,
        question: experiment.question,
        command,
        egotac: egotac::VERSION,
        machine: Machine::this(),
        size: size.clone(),
        image: SIDE,
        parameters: parameter_count(&super::geometry())?,
        held_out_frames: [truths[0].n_frames(), truths[1].n_frames()],
        arms,
        baselines: baselines(stores, [&truths[0], &truths[1]])?,
    })
}

/// Scores zero, mean and median of the training labels, and persistence.
fn baselines(stores: &Stores, truths: [&TactileSequence; 2]) -> Result<Vec<BaselineReport>> {
    let training: Vec<_> = stores.sources().into_iter().flat_map(|source| source.stores).collect();
    let evaluate = |name: &'static str, fields: [TactileSequence; 2]| -> Result<BaselineReport> {
        let [in_domain, out_of_domain] = &fields;
        let of = |fields, truth: &TactileSequence| metrics::evaluate(fields, truth, &EvalOptions::default());
        Ok(BaselineReport { name, in_domain: of(in_domain, truths[0])?, out_of_domain: of(out_of_domain, truths[1])? })
    };
    let mut reports = Vec::new();
    for constant in baseline::constants(&labels(&training)?) {
        reports.push(evaluate(constant.name, truths.map(|truth| constant.sequence(truth.n_frames())))?);
    }
    reports.push(evaluate("persistence", truths.map(|truth| baseline::persistence(truth, None)))?);
    Ok(reports)
}

fn runs_of<'a>(runs: &[(&Arm, u64, &'a Config)], arm: &Arm) -> Vec<&'a Config> {
    runs.iter().filter(|(of, ..)| of.name == arm.name).map(|(_, _, config)| *config).collect()
}

fn truth(stores: &Stores, domain: Domain) -> Result<TactileSequence> {
    labels(stores.held_out(domain))
}

fn labels(stores: &[PathBuf]) -> Result<TactileSequence> {
    let preparation = egotac::model::Metadata::new("truth", 1.0, 0.1).preparation(&super::geometry());
    Dataset::new(zarr::open_all(stores)?, preparation, false)?.labels()
}

fn score(own: &[&Config], first: &[&Config], domain: Domain, truth: &TactileSequence) -> Result<DomainReport> {
    let read = |runs: &[&Config]| -> Result<Vec<TactileSequence>> {
        runs.iter().map(|config| tensors::read(&fields_file(config, domain))).collect()
    };
    let predicted = read(own)?;
    let options = EvalOptions { fps: truth.fps(), calibration: None };
    let seeds = predicted.iter().map(|sequence| metrics::evaluate(sequence, truth, &options));
    let seeds = seeds.collect::<Result<Vec<_>>>()?;
    // The seeds are concatenated, and the truth is repeated for each.
    let repeated = joined(std::iter::repeat_n(truth, predicted.len()))?;
    let comparison = metrics::compare(&joined(&predicted)?, &joined(&read(first)?)?, &repeated, &options, 0)?;
    Ok(DomainReport { seeds, against_first: comparison.differences })
}

fn joined<'a>(sequences: impl IntoIterator<Item = &'a TactileSequence>) -> Result<TactileSequence> {
    let mut all = TactileSequence::default();
    sequences.into_iter().try_for_each(|sequence| all.append(sequence))?;
    Ok(all)
}

/// Counts the training frames of a run.
fn frames(config: &Config) -> Result<usize> {
    let paths: Vec<_> = config.data.iter().flat_map(|source| source.stores.clone()).collect();
    Ok(zarr::open_all(&paths)?.iter().map(zarr::ZarrReader::len).sum())
}

/// Returns the minutes of all steps in a run's log.
fn minutes(config: &Config) -> f64 {
    let text = std::fs::read_to_string(config.out.join("log.csv")).unwrap_or_default();
    let mut lines = text.lines();
    let column = lines.next().and_then(|line| line.split(',').position(|name| name == "secs"));
    let secs = lines.filter_map(|line| line.split(',').nth(column?)?.parse::<f64>().ok());
    secs.sum::<f64>() / 60.0
}

impl ExperimentReport {
    /// Returns the report as Markdown.
    pub fn markdown(&self) -> String {
        let Size { episodes, held_out, encoder_steps, steps, seeds } = self.size;
        let mut text = format!(
            "# {}\n\n{} Written by `{}`, egotac {}, {}. Numbers: `{}.json`.\n\n\
             {seeds} seeds; {steps} steps of up to 30 windows; {episodes} episodes of each training scene, {held_out} held-out ones \
             of each scene; {} px, {} parameters.\nThe encoder has learned in {encoder_steps} steps to find the hands' keypoints in the \
             training pictures, without a word of touch; all else starts\nat random. A score is the mean over seeds with the least and the most; \
             in the column *against `{}`* the difference of the \
             frame-mean F1\nwith its 95 % interval (episodes of all seeds drawn anew, the same for both arms). *Frame mean*: average \
             over frames with contact, as in the paper;\n*false-positive rate*: share of vertices predicted in contact in the frames \
             without; *pooled*: over all vertices of all frames. `zero`, `mean` and `median`\nof the training labels and \
             `persistence` (the truth of the frame before) see no image. Temporal scores are averages over the episodes whose\n\
             true force changes; a constant has correlations of 0.\n",
            self.experiment,
            self.question,
            self.command,
            self.egotac,
            self.machine,
            self.experiment,
            self.image,
            self.parameters,
            self.arms.first().map_or("", |arm| arm.name),
        );
        for (domain, frames) in Domain::ALL.into_iter().zip(self.held_out_frames) {
            let title = match domain {
                Domain::InDomain => "In the domain: unseen seeds of the training scenes",
                Domain::OutOfDomain => "Out of the domain: unseen scenes, objects and camera",
            };
            let share = self.baselines.first().and_then(|zero| zero.domain(domain).share_without_positives);
            let share =
                share.map_or(String::new(), |share| format!(", {:.0} % of them without contact", 100.0 * share));
            put(&mut text, format_args!("\n## {title} ({frames} frames{share})\n"));
            let first = self.arms.first().map_or("", |arm| arm.name);
            let names: Vec<&str> = COLUMNS.iter().map(|(_, name)| *name).collect();
            let against = format!("F1 against `{first}`");
            put(
                &mut text,
                format_args!("| arm | what is other | training frames | {} | {against} |", names.join(" | ")),
            );
            put(&mut text, format_args!("|---|---|---|{}---|", "---|".repeat(COLUMNS.len())));
            for arm in &self.arms {
                let scores = cells(&COLUMNS, |name| spread(&arm.domain(domain).score(name), digits(name)));
                let difference = arm.domain(domain).against_first.iter().find(|d| d.name == COMPARED);
                let against = match difference.and_then(|d| Some((d.difference?, d.interval?))) {
                    Some((difference, [low, high])) if arm.name != first => {
                        format!("{difference:+.3} ({low:+.3} .. {high:+.3})")
                    }
                    _ => "—".into(),
                };
                let (name, about, frames) = (arm.name, arm.about, arm.training_frames);
                put(&mut text, format_args!("| {name} | {about} | {frames} | {scores} | {against} |"));
            }
            for baseline in &self.baselines {
                let scores = cells(&COLUMNS, |name| one(baseline.domain(domain).score(name), digits(name)));
                put(&mut text, format_args!("| {} | sees no image | — | {scores} | — |", baseline.name));
            }
            let names: Vec<&str> = DYNAMICS.iter().map(|(_, name)| *name).collect();
            put(
                &mut text,
                format_args!("\nDynamics of the total force:\n\n| arm | {} | episodes |", names.join(" | ")),
            );
            put(&mut text, format_args!("|---|{}---|", "---|".repeat(DYNAMICS.len())));
            for arm in &self.arms {
                let scores = cells(&DYNAMICS, |name| spread(&arm.domain(domain).score(name), digits(name)));
                let episodes = arm.domain(domain).seeds.first().map_or_else(|| "—".into(), defined);
                put(&mut text, format_args!("| {} | {scores} | {episodes} |", arm.name));
            }
            for baseline in &self.baselines {
                let of = baseline.domain(domain);
                let scores = cells(&DYNAMICS, |name| one(of.score(name), digits(name)));
                put(&mut text, format_args!("| {} | {scores} | {} |", baseline.name, defined(of)));
            }
        }
        text
    }
}

/// Returns the cells of a row.
fn cells(columns: &[(&str, &str)], cell: impl Fn(&str) -> String) -> String {
    columns.iter().map(|(name, _)| cell(name)).collect::<Vec<_>>().join(" | ")
}

/// Returns the decimals of a score; the false-positive rate is small.
fn digits(name: &str) -> usize {
    if name == "false_positive_rate" { 5 } else { 3 }
}

/// Formats a single score; a dash if it is undefined.
fn one(value: Option<f64>, digits: usize) -> String {
    value.map_or("—".into(), |value| format!("{value:.digits$}"))
}

/// Formats the number of episodes on which temporal scores are defined.
fn defined(report: &metrics::Metrics) -> String {
    format!("{} of {}", report.episodes_defined.temporal_pearson, report.counts.episodes)
}

/// Formats mean (least..most); a dash if a seed leaves the score undefined.
fn spread(values: &[Option<f64>], digits: usize) -> String {
    let Some(values) = values.iter().copied().collect::<Option<Vec<f64>>>().filter(|values| !values.is_empty()) else {
        return "—".into();
    };
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let (low, high) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(*x), h.max(*x)));
    format!("{mean:.digits$} ({low:.digits$}..{high:.digits$})")
}
