//! The node `verifier`: compares predictions with the truth of equal stamps.

mod scores;
mod touch_scores;

use std::cell::RefCell;
use std::io::Write as _;
use std::path::Path;
use std::process::ExitCode;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context as _;
use serde_json::{Value, json};

use super::clock::RosClock;
use super::diagnostics::{Level, Rates, Tally, TaskReport};
use super::enabled::serve_set_enabled;
use super::exact_sync::ExactSync;
use super::input_topics::{InputTopic, Need, reliability_parameter};
use super::log::Log;
use super::params::{Allowed, Parameter, Parameters};
use super::publisher::Publisher;
use super::runtime::Runtime;
use super::shutdown::Shutdown;
use super::{diagnostics, program, qos};
use crate::file;
use crate::message::{TactileFrame, TactileMetrics, TactileTruth};
use crate::score::verify::Requirement;
use crate::score::verify::episode_splitter::EpisodeSplitter;
use crate::score::verify::report::scores_of;
use scores::Scores;

/// Most messages per topic that wait for their partner: several seconds of any camera.
const MAX_UNPAIRED: usize = 500;
/// Seconds after which a message that waits for its partner counts as unmatched; longer than a slow predictor takes.
const UNMATCHED_AFTER_SECS: f64 = 2.0;

/// Runs the program `egotac_verifier`.
pub fn main() -> ExitCode {
    program::run("verifier", "Compares predicted touch with the truth while both are published.", parameters(), run)
}

/// Parameters of the node.
fn parameters() -> Vec<Parameter> {
    vec![
        Parameter::new(
            "window_secs",
            5.0,
            Allowed::Doubles(0.1, 600.0),
            "Length of the rolling window that ~/metrics is computed over, seconds.",
        ),
        Parameter::fixed(
            "report",
            "",
            Allowed::Any,
            "JSON file that the totals are written to at shutdown; empty = none.",
        ),
        Parameter::fixed(
            "require",
            "",
            Allowed::Any,
            "Scores required over all pairs, for instance f1=0.7,missed_force=0.2 (names as in egotac verify: f1 is the mean over \
             frames with touch, pooled_f1 that over all vertices). A missed one is logged at shutdown and sets the exit status to 1.",
        ),
        reliability_parameter("match"),
        Parameter::new("enabled", true, Allowed::Any, "Score pairs; ~/set_enabled sets it, too."),
        Parameter::new("print", true, Allowed::Any, "Print one line of scores per second on the terminal."),
    ]
}

/// Runs the node until `shutdown`, then writes the report if the parameter `report` names a file.
///
/// # Errors
/// If ROS refuses a topic, `require` does not parse, the report cannot be written, or a required score was missed.
fn run(mut runtime: Runtime, shutdown: &Shutdown) -> anyhow::Result<()> {
    let required = required_scores(&runtime.parameters().get::<String>("require"))?;
    let verifier = Rc::new(RefCell::new(Verifier {
        sync: ExactSync::new(MAX_UNPAIRED),
        splitter: EpisodeSplitter::default(),
        scores: Scores::default(),
        tally: Tally::default(),
        parameters: Arc::clone(runtime.parameters()),
        clock: runtime.clock().clone(),
        log: runtime.log().clone(),
        started: Instant::now(),
    }));
    serve_set_enabled(&mut runtime)?;
    subscribe(&mut runtime, &verifier)?;
    publish_metrics(&mut runtime, &verifier)?;
    let report = runtime.parameters().get::<String>("report");
    runtime.spin(shutdown);

    let mut verifier = verifier.borrow_mut();
    let missed = verifier.missed(&required);
    // Log before the node is dropped, while /rosout still has subscribers.
    missed.iter().for_each(|missed| runtime.log().error(missed.clone()));
    drop(runtime);
    let summary = verifier.summary()?;
    if !report.is_empty() {
        file::write(Path::new(&report), format!("{summary:#}\n").as_bytes()).context("cannot write the report")?;
    }
    anyhow::ensure!(missed.is_empty(), "{} of {} required scores missed", missed.len(), required.len());
    Ok(())
}

/// Parses the parameter `require`. The node has one candidate, so a score that names a candidate is an error.
fn required_scores(text: &str) -> anyhow::Result<Vec<Requirement>> {
    let required = Requirement::parse_all(text).context("parameter require")?;
    let named = required.iter().find_map(|requirement| requirement.candidate.as_deref());
    anyhow::ensure!(named.is_none(), "parameter require: expected NAME=NUMBER, got a label {:?}", named.unwrap_or(""));
    Ok(required)
}

fn subscribe(runtime: &mut Runtime, verifier: &Rc<RefCell<Verifier>>) -> anyhow::Result<()> {
    let predictions = Rc::clone(verifier);
    let tactile = InputTopic::new(runtime, "tactile", "predictions", qos::every_input(), Need::Required);
    runtime.input::<TactileFrame>(tactile, move |frame| {
        predictions.borrow_mut().take_prediction(frame);
    })?;
    let truths = Rc::clone(verifier);
    let truth = InputTopic::new(runtime, "truth", "truth", qos::every_input(), Need::Required);
    runtime.input::<TactileTruth>(truth, move |truth| {
        truths.borrow_mut().take_truth(truth);
    })
}

/// Publishes metrics and diagnostics once a second.
fn publish_metrics(runtime: &mut Runtime, verifier: &Rc<RefCell<Verifier>>) -> anyhow::Result<()> {
    let publisher = runtime.publisher("~/metrics", qos::output())?;
    let (verifier, parameters) = (Rc::clone(verifier), runtime.parameters().clone());
    let (tactile, truth) = (runtime.resolve("tactile"), runtime.resolve("truth"));
    diagnostics::publish(runtime, String::new, move |_| {
        let mut verifier = verifier.borrow_mut();
        let rates = verifier.tally.counts().rates();
        verifier.publish_window(rates.processed, &publisher, &parameters);
        vec![verifier.task_report(rates, &tactile, &truth)]
    })
}

struct Verifier {
    sync: ExactSync<TactileFrame, (u64, TactileTruth)>,
    splitter: EpisodeSplitter,
    scores: Scores,
    tally: Tally,
    parameters: Arc<Parameters>,
    clock: RosClock,
    log: Log,
    started: Instant,
}

impl Verifier {
    fn take_prediction(&mut self, frame: crate::Result<TactileFrame>) {
        self.tally.received();
        match frame {
            Ok(_) if self.is_disabled() => self.tally.dropped("disabled"),
            Ok(frame) => {
                self.tally.processed(self.clock.secs_since(frame.header.stamp));
                let pair = self.sync.push_left(frame.header.stamp, frame);
                self.score(pair);
            }
            Err(error) => self.refuse("tactile", &error),
        }
    }

    fn take_truth(&mut self, truth: crate::Result<TactileTruth>) {
        match truth {
            Ok(_) if self.is_disabled() => {}
            Ok(truth) => {
                let episode = self.splitter.episode_number(&truth);
                let pair = self.sync.push_right(truth.frame.header.stamp, (episode, truth));
                self.score(pair);
            }
            Err(error) => self.refuse("truth", &error),
        }
    }

    /// True while pairs are not scored.
    fn is_disabled(&self) -> bool {
        !self.parameters.get::<bool>("enabled")
    }

    fn score(&mut self, pair: Option<(TactileFrame, (u64, TactileTruth))>) {
        let Some((frame, (episode, truth))) = pair else { return };
        if let Err(error) = self.scores.push(frame, &truth, episode) {
            self.refuse("pair", &error);
        }
    }

    fn refuse(&mut self, topic: &'static str, error: &crate::Error) {
        self.tally.dropped("malformed");
        self.log.warn_throttled(topic, format!("{topic}: message dropped: {error}"));
    }

    /// Publishes the metrics of the rolling window and prints them in one line.
    fn publish_window(&mut self, rate: f64, publisher: &Publisher<TactileMetrics>, parameters: &Parameters) {
        self.scores.slide_window(parameters.get("window_secs"));
        let values = self.values(rate);
        if let Err(error) = publisher.publish(&self.message(&values)) {
            self.log.warn_throttled("metrics", format!("~/metrics: {error:#}"));
        }
        if parameters.get("print") && self.scores.pairs > 0 {
            // Ignore the error: a closed standard output must not end the node.
            let _ = writeln!(std::io::stdout(), "{}", self.line(&values));
        }
    }

    fn task_report(&self, rates: Rates, tactile: &str, truth: &str) -> TaskReport {
        let (level, message) = match (rates.processed > 0.0, self.scores.window_len() == 0) {
            _ if self.is_disabled() => (Level::Ok, "disabled".to_owned()),
            (false, _) => (Level::Stale, format!("no predictions on {tactile}")),
            (true, true) if self.scores.invalid > 0 => {
                (Level::Warn, format!("no valid pair; {} frames of {truth} were invalid", self.scores.invalid))
            }
            (true, true) => (Level::Warn, format!("no message on {truth} has the stamp of a prediction")),
            (true, false) => (Level::Ok, format!("{} pairs", self.scores.pairs)),
        };
        TaskReport { task: "pairs".into(), level, message, values: self.tally.counts().values(rates) }
    }

    /// Returns names and values of the rolling metrics; NaN = undefined.
    fn values(&self, rate: f64) -> Vec<(String, f64)> {
        let counts = self.tally.counts();
        let mut values = self.scores.window_scores();
        values.push(("rate_hz".to_owned(), rate));
        values.push(("latency_p50_secs".to_owned(), counts.latency(0.5)));
        values.push(("latency_p95_secs".to_owned(), counts.latency(0.95)));
        values
    }

    fn message(&self, values: &[(String, f64)]) -> TactileMetrics {
        let (unmatched_predictions, unmatched_truths) = self.sync.unmatched(UNMATCHED_AFTER_SECS);
        let (names, values) = values.iter().cloned().unzip();
        TactileMetrics {
            header: self.scores.header.clone(),
            window_pairs: self.scores.window_len() as u32,
            window_secs: self.scores.window_secs(),
            pairs: self.scores.pairs,
            unmatched_predictions,
            unmatched_truths,
            invalid_truths: self.scores.invalid,
            names,
            values,
        }
    }

    fn line(&self, values: &[(String, f64)]) -> String {
        let value = |name: &str| values.iter().find(|(n, _)| n == name).map_or(f64::NAN, |(_, value)| *value);
        format!(
            "{:6} pairs {:5.1} Hz | MAE {:.4} N, active {:.3} N, r {:.2} | F1 {:.2} (pooled {:.2}), IoU {:.2} | \
             latency p50 {:.0} ms, p95 {:.0} ms | without prediction {}",
            self.scores.pairs,
            value("rate_hz"),
            value("mae"),
            value("active_mae"),
            value("temporal_pearson"),
            value("frame_mean.f1"),
            value("pooled.f1"),
            value("frame_mean.iou"),
            value("latency_p50_secs") * 1e3,
            value("latency_p95_secs") * 1e3,
            self.sync.unmatched(UNMATCHED_AFTER_SECS).1,
        )
    }

    /// Returns the totals since the start.
    fn summary(&mut self) -> anyhow::Result<Value> {
        let metrics = self.scores.total()?;
        let baselines = self.scores.baselines()?;
        let counts = self.tally.counts();
        // No further message comes, so every message that waits is unmatched.
        let (unmatched_predictions, unmatched_truths) = self.sync.unmatched(0.0);
        Ok(json!({
            "model_id": self.scores.model_id,
            "topology": self.scores.topology,
            "pairs": self.scores.pairs,
            "unmatched_predictions": unmatched_predictions,
            "unmatched_truths": unmatched_truths,
            "invalid_truths": self.scores.invalid,
            "predictions_with_an_unknown_hand": self.scores.unknown,
            "malformed": counts.drops.get("malformed").copied().unwrap_or(0),
            "duration_secs": self.started.elapsed().as_secs_f64(),
            "rate_hz": self.scores.rate(),
            "latency_secs": {
                "p50": finite(counts.latency(0.5)),
                "p95": finite(counts.latency(0.95)),
                "max": finite(counts.latency(1.0)),
            },
            "metrics": metrics,
            "baselines": baselines,
            "touch": scores_of(&self.scores.touch.total()),
        }))
    }

    /// Describes each required score that was missed.
    fn missed(&self, required: &[Requirement]) -> Vec<String> {
        let total = self.scores.touch.total();
        required.iter().filter_map(|requirement| requirement.missed((requirement.score.value)(&total))).collect()
    }
}

/// Returns None for NaN, which JSON cannot hold.
fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}
