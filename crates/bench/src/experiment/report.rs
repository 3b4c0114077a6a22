//! Results of an experiment: scores of every run, constants beside them, and each arm against the first.

use std::collections::BTreeMap;

use egotac::dataset::{tensors, zarr};
use egotac::error::Result;
use egotac::hand::Side;
use egotac::machine::Machine;
use egotac::model::{Metadata, checkpoint::parameter_count};
use egotac::score::metrics::baseline;
use egotac::score::metrics::{self, Calibration, EvalOptions, VertexGroup};
use egotac::tactile::TactileSequence;
use egotac::train::data::Dataset;
use egotac::train::source::{Supervision, TrainingSource};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::arm::{Experiment, Test};
use super::data::Stores;
use super::network::Network;
use super::recipe::Recipe;
use super::recording::{Agreement, Recorded};
use super::training::Run;
use super::{Setup, Size};

/// Format of the JSON; a changed meaning of a number gets a higher one, and reports of lower ones are not read.
pub const FORMAT: u32 = 2;

/// Description of a run: the first entries of every report.
#[derive(Debug, Clone, Serialize)]
pub struct Head {
    /// [`FORMAT`].
    pub format: u32,
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
    /// Network that all arms start from, or that was measured.
    pub network: Network,
}

impl Head {
    /// Describes a run of `setup` on this machine.
    pub fn new(experiment: &'static str, question: &'static str, command: String, setup: &Setup) -> Self {
        Self {
            format: FORMAT,
            experiment,
            question,
            command,
            egotac: egotac::VERSION,
            machine: Machine::this(),
            size: setup.size.clone(),
            network: setup.network.clone(),
        }
    }

    /// Returns the first lines of a report's page.
    pub fn markdown(&self) -> String {
        let Self { experiment, question, command, egotac, machine, .. } = self;
        format!(
            "# {experiment}\n\n{question} Written by `{command}`, egotac {egotac}, {machine}. Numbers: `{experiment}.json`.\n"
        )
    }
}

/// Results of an experiment.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// Description of the run.
    #[serde(flatten)]
    pub head: Head,
    /// Parameters of the first arm's network.
    pub parameters: usize,
    /// How the differences are made, in words.
    pub differences: String,
    /// Held-out frames that the arms are scored on.
    pub tests: Vec<TestInfo>,
    /// Agreement of imported labels with the simulator's, by data set.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub imported: Vec<Agreement>,
    /// Results of the arms; the others are compared with the first.
    pub arms: Vec<ArmReport>,
}

/// Held-out frames of a test.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TestInfo {
    /// Name.
    pub name: String,
    /// Title in tables.
    pub title: String,
    /// True if the truth has forces; otherwise it is contact by distance.
    pub force: bool,
    /// Frames.
    pub frames: usize,
    /// Episodes.
    pub episodes: usize,
    /// Names of the scores whose differences tables show.
    pub compared: [&'static str; 2],
}

/// Difference of one score from the reference.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Difference {
    /// Name of the score in the JSON, e.g. `frame_mean.f1`.
    pub name: String,
    /// The arm's score minus the reference's.
    pub difference: Option<f64>,
    /// 95 % interval of the difference over resamples of the episodes, the same ones for both.
    pub interval: Option<[f64; 2]>,
}

/// Results of one arm, of a condition, or of a constant prediction.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ArmReport {
    /// Name.
    pub name: String,
    /// Difference from the usual run, in words.
    pub about: String,
    /// True for a prediction that sees no picture.
    pub constant: bool,
    /// Training frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub training_frames: Option<usize>,
    /// Minutes of training, by seed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub minutes: Vec<f64>,
    /// Scores by test.
    pub tests: BTreeMap<String, Scores>,
}

/// Scores of an arm in one test.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Scores {
    /// Scores of each seed, as `egotac eval --json` names them.
    pub seeds: Vec<Value>,
    /// Differences from the reference by seed, with 95 % intervals by resampling the same episodes for both.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub differences: Vec<Vec<Difference>>,
}

impl Scores {
    /// Scores one prediction; with a reference also the difference from it.
    ///
    /// # Errors
    /// If a prediction does not fit the truth.
    pub fn push(
        &mut self,
        predicted: &TactileSequence,
        reference: Option<&TactileSequence>,
        truth: &TactileSequence,
        options: &EvalOptions,
    ) -> Result<()> {
        self.seeds.push(value(&metrics::evaluate(predicted, truth, options)?));
        if let Some(reference) = reference {
            let compared = metrics::compare(predicted, reference, truth, options, 0)?.differences.into_iter();
            let own = compared.map(|of| Difference {
                name: of.name.to_string(),
                difference: of.difference,
                interval: of.interval,
            });
            self.differences.push(own.collect());
        }
        Ok(())
    }

    /// Returns a score of each seed by its name in the JSON, such as `frame_mean.f1`.
    pub fn score(&self, name: &str) -> Vec<Option<f64>> {
        self.seeds.iter().map(|seed| score(seed, name)).collect()
    }

    /// Returns the mean difference over seeds, and the hull of the seeds' intervals: a difference beyond it holds in each
    /// seed.
    pub fn difference(&self, name: &str) -> Option<(f64, [f64; 2])> {
        let found = self.differences.iter().map(|seed| {
            let of = seed.iter().find(|difference| difference.name == name)?;
            Some((of.difference?, of.interval?))
        });
        let found = found.collect::<Option<Vec<_>>>().filter(|found| !found.is_empty())?;
        let mean = found.iter().map(|(difference, _)| difference).sum::<f64>() / found.len() as f64;
        let low = found.iter().map(|(_, [low, _])| *low).fold(f64::INFINITY, f64::min);
        let high = found.iter().map(|(_, [_, high])| *high).fold(f64::NEG_INFINITY, f64::max);
        Some((mean, [low, high]))
    }
}

/// Returns a score by its name in the JSON, with dots between levels.
pub fn score(metrics: &Value, name: &str) -> Option<f64> {
    name.split('.').try_fold(metrics, |value, key| value.get(key))?.as_f64()
}

/// Converts to JSON a value that can always be.
fn value<T: Serialize>(of: &T) -> Value {
    serde_json::to_value(of).unwrap_or_default()
}

/// Scores the predictions of all runs.
///
/// # Errors
/// If a store or a prediction can't be read.
pub(super) fn make(
    experiment: &Experiment,
    setup: &Setup,
    stores: &Stores,
    runs: &[Run],
    command: String,
) -> Result<Report> {
    let mut arms = Vec::new();
    for arm in &experiment.arms {
        let own: Vec<&Run> = runs.iter().filter(|run| run.arm.name == arm.name).collect();
        let mut about = arm.about.to_owned();
        if let Some(run) = own.first().filter(|_| experiment.timed) {
            let pictures = stores.held_out(experiment.tests[0].worlds)?;
            about += &format!("; {:.1} ms per picture", run.picture_ms(&pictures)?);
        }
        arms.push(ArmReport {
            name: arm.name.into(),
            about,
            constant: false,
            training_frames: own.first().map(|run| run.frames()).transpose()?,
            minutes: own.iter().map(|run| run.minutes()).collect(),
            tests: BTreeMap::new(),
        });
    }
    let constants = constants(experiment.arms[0].name, runs)?;
    let mut rows = Vec::new();
    let mut tests = Vec::new();
    for test in &experiment.tests {
        let held_out = stores.held_out(test.worlds)?;
        let truth = truth(&held_out, test, setup)?;
        let options = options(&truth, None);
        let force = test.truth == Supervision::Both;
        tests.push(TestInfo {
            name: test.name.into(),
            title: test.title.into(),
            force,
            frames: truth.n_frames(),
            episodes: truth.episodes().len(),
            compared: ["frame_mean.f1", if force { "temporal_pearson" } else { "frame_mean.auroc" }],
        });
        let read = |arm: &str, seed: u64| -> Result<TactileSequence> {
            let run = runs.iter().find(|run| run.arm.name == arm && run.seed == seed);
            let path = run.map(|run| run.predictions(&test.file()));
            tensors::read(&path.unwrap_or_default())
        };
        for seed in 0..setup.size.seeds {
            let reference = read(experiment.arms[0].name, seed)?;
            for (index, arm) in arms.iter_mut().enumerate() {
                let scores = arm.tests.entry(test.name.into()).or_default();
                match index {
                    0 => scores.push(&reference, None, &truth, &options)?,
                    _ => scores.push(&read(&arm.name, seed)?, Some(&reference), &truth, &options)?,
                }
            }
        }
        score_blind(&mut rows, test.name, &constants, &truth, &options)?;
    }
    arms.extend(rows);
    let geometry = runs[0].config.geometry()?;
    Ok(Report {
        head: Head::new(experiment.name, experiment.question, command, setup),
        parameters: parameter_count(&geometry)?,
        differences: format!("from the arm `{}` with the same seed", experiment.arms[0].name),
        tests,
        imported: stores.recordings().iter().map(Recorded::agreement).collect::<Result<_>>()?,
        arms,
    })
}

/// Returns the constant predictions of the first arm's training data.
fn constants(arm: &str, runs: &[Run]) -> Result<Vec<baseline::Constant>> {
    let Some(run) = runs.iter().find(|run| run.arm.name == arm) else { return Ok(Vec::new()) };
    let preparation = Metadata::new("labels", 1.0, 0.1).preparation(&run.config.geometry()?);
    let labels = Dataset::open(&run.config.data, preparation, false)?.labels()?;
    Ok(baseline::constants(&labels).into_iter().collect())
}

/// Scores the predictions that see no picture in one test: constants, and the truth of the frame before; adds them to `rows`.
///
/// # Errors
/// If a constant does not fit the truth.
pub(super) fn score_blind(
    rows: &mut Vec<ArmReport>,
    test: &str,
    constants: &[baseline::Constant],
    truth: &TactileSequence,
    options: &EvalOptions,
) -> Result<()> {
    let constants = constants
        .iter()
        .map(|constant| (constant.name, "the same in every frame, from labels", constant.sequence(truth.n_frames())));
    let persistence = ("persistence", "the truth of the frame before", baseline::persistence(truth, None));
    for (name, about, predicted) in constants.chain([persistence]) {
        let at = rows.iter().position(|row| row.name == name).unwrap_or_else(|| {
            rows.push(ArmReport {
                name: name.into(),
                about: about.into(),
                constant: true,
                training_frames: None,
                minutes: Vec::new(),
                tests: BTreeMap::new(),
            });
            rows.len() - 1
        });
        rows[at].tests.entry(test.into()).or_default().push(&predicted, None, truth, options)?;
    }
    Ok(())
}

/// Reads the truth of a test.
fn truth(held_out: &[Recipe], test: &Test, setup: &Setup) -> Result<TactileSequence> {
    let source = TrainingSource { labels: test.truth, ..TrainingSource::of(held_out.iter().map(|r| r.path.clone())) };
    let preparation = Metadata::new("truth", 1.0, 0.1).preparation(&setup.network.geometry);
    let mut truth = Dataset::open(&[source], preparation, false)?.labels()?;
    if test.right_hand {
        VertexGroup::hand(Side::Right).restrict(&mut truth);
    }
    Ok(truth)
}

/// Returns the settings of an evaluation against `truth`; without a calibration each side has its own range.
pub(super) fn options(truth: &TactileSequence, calibration: Option<Calibration>) -> EvalOptions {
    EvalOptions { fps: truth.fps(), calibration }
}

/// Reads the truth, force and contact, of stores, one behind the other.
///
/// # Errors
/// If a store can't be read.
pub(super) fn force_truth(recipes: &[Recipe]) -> Result<TactileSequence> {
    let mut all = TactileSequence::default();
    for recipe in recipes {
        all.append(&zarr::read_truth(&zarr::ZarrReader::open(&recipe.path)?)?)?;
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn difference(difference: f64, interval: [f64; 2]) -> Vec<Difference> {
        vec![Difference { name: "mae".into(), difference: Some(difference), interval: Some(interval) }]
    }

    #[test]
    fn a_difference_is_the_seeds_mean_within_the_hull_of_their_intervals() {
        let differences = vec![difference(0.1, [0.02, 0.2]), difference(0.3, [-0.1, 0.6])];
        let scores = Scores { seeds: vec![], differences };
        let (mean, [low, high]) = scores.difference("mae").unwrap();
        assert!((mean - 0.2).abs() < 1e-12 && low == -0.1 && high == 0.6);
        assert_eq!(scores.difference("active_mae"), None);
        assert_eq!(Scores::default().difference("mae"), None);
    }

    #[test]
    fn scores_are_found_by_their_names() {
        let scores = Scores {
            seeds: vec![serde_json::json!({"mae": 0.5, "frame_mean": {"f1": 0.25, "iou": null}})],
            differences: vec![],
        };
        assert_eq!(scores.score("mae"), [Some(0.5)]);
        assert_eq!(scores.score("frame_mean.f1"), [Some(0.25)]);
        assert_eq!((scores.score("frame_mean.iou"), scores.score("pooled.f1")), (vec![None], vec![None]));
    }
}
