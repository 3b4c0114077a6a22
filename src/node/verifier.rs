//! The node `verifier`: predictions against truth, by equal stamps.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::io::Write as _;
use std::path::Path;
use std::rc::Rc;
use std::time::Instant;

use anyhow::Context as _;
use serde_json::{Value, json};

use super::diagnostics::{Level, Report, Tally};
use super::exact_sync::Pairing;
use super::log::Log;
use super::params::{Allowed, Parameter, Parameters};
use super::runtime::{Publisher, RosClock, Runtime};
use super::{Shutdown, diagnostics, qos};
use crate::file;
use crate::message::{Header, TactileFrame, TactileMetrics, TactileTruth};
use crate::score::agreement::{Scorer, Sums, TruthFrame};
use crate::score::metrics::{self, EvalOptions, FrameScore};
use crate::score::verify::Requirement;
use crate::score::verify::episode_splitter::EpisodeSplitter;
use crate::score::verify::recording::RestHands;
use crate::score::verify::report::scores_of;
use crate::tactile::{TactileField, TactileSequence, Validity};

/// Messages that may wait for their partner: seconds of any camera.
const WAITING: usize = 500;
/// Seconds after which a message that waits for its partner counts as alone.
const PATIENCE: f64 = 2.0;
/// Parts of the names of scores that need whole touches.
const ROLLING_UNKNOWN: [&str; 2] = ["_secs", "_touches"];
/// Pairs kept whole for the scores that need all vertices of all frames (100 MB at most).
const KEPT: usize = 2000;

/// The node's parameters.
pub fn parameters() -> Vec<Parameter> {
    vec![
        Parameter::new(
            "window_secs",
            5.0,
            Allowed::Doubles(0.1, 600.0),
            "Length of the rolling window that ~/metrics is computed over, seconds.",
        ),
        Parameter::fixed("report", "", Allowed::Any, "JSON file to write the totals to at shutdown; empty = none."),
        Parameter::fixed(
            "require",
            "",
            Allowed::Any,
            "Scores to reach over all pairs, such as f1=0.7,missed_force=0.2 (see egotac verify); one that is missed is \
             logged at shutdown and makes the exit status 1.",
        ),
        Parameter::new("print", true, Allowed::Any, "Print a line per second."),
        Parameter::use_sim_time(),
    ]
}

/// Creates the node and runs until `shutdown`.
///
/// # Errors
/// As [`run`].
pub fn start(shutdown: &Shutdown) -> anyhow::Result<()> {
    run(Runtime::create("verifier", &parameters())?, shutdown)
}

/// Runs the node until `shutdown`, then writes the report if one is wanted.
///
/// # Errors
/// If ROS refuses something, `require` names no scores, the report can't be written, or a required score was not reached.
pub fn run(mut runtime: Runtime, shutdown: &Shutdown) -> anyhow::Result<()> {
    let bars = bars(&runtime.parameters().get::<String>("require"))?;
    let verifier = Rc::new(RefCell::new(Verifier {
        pairing: Pairing::new(WAITING),
        stretches: EpisodeSplitter::default(),
        scored: Scored::default(),
        tally: Tally::default(),
        clock: runtime.clock().clone(),
        log: runtime.log().clone(),
        started: Instant::now(),
    }));
    let predictions = Rc::clone(&verifier);
    runtime.subscribe::<TactileFrame>("tactile", qos::every_input(), move |frame| {
        predictions.borrow_mut().take_prediction(frame);
    })?;
    let truths = Rc::clone(&verifier);
    runtime.subscribe::<TactileTruth>("truth", qos::every_input(), move |truth| {
        truths.borrow_mut().take_truth(truth);
    })?;

    let publisher = runtime.publisher("~/metrics", qos::output())?;
    let (topics, parameters) = (Rc::clone(&verifier), runtime.parameters().clone());
    let names = (runtime.resolve("tactile"), runtime.resolve("truth"));
    diagnostics::publish(&mut runtime, String::new, move |_| {
        topics.borrow_mut().tick(&publisher, &parameters, &names)
    })?;

    let report = runtime.parameters().get::<String>("report");
    runtime.spin(shutdown);
    let missed = verifier.borrow().missed(&bars);
    // While the log still reaches others.
    missed.iter().for_each(|missed| runtime.log().error(missed.clone()));
    drop(runtime);
    let mut verifier = verifier.borrow_mut();
    let summary = verifier.summary()?;
    if !report.is_empty() {
        write_report(Path::new(&report), &summary)?;
    }
    anyhow::ensure!(missed.is_empty(), "{} of {} required scores not reached", missed.len(), bars.len());
    Ok(())
}

/// The bars of the parameter `require`: there is one candidate, so none is named.
fn bars(text: &str) -> anyhow::Result<Vec<Requirement>> {
    let bars = Requirement::parse_all(text).context("parameter require")?;
    let named = bars.iter().find_map(|bar| bar.candidate.as_deref());
    anyhow::ensure!(named.is_none(), "parameter require: expected NAME=NUMBER, got a label {:?}", named.unwrap_or(""));
    Ok(bars)
}

struct Verifier {
    pairing: Pairing<TactileFrame, (u64, TactileTruth)>,
    stretches: EpisodeSplitter,
    scored: Scored,
    tally: Tally,
    clock: RosClock,
    log: Log,
    started: Instant,
}

/// Scores of the pairs so far.
#[derive(Default)]
struct Scored {
    newest: Header,
    model_id: String,
    topology: String,
    pairs: u64,
    invalid: u64,
    /// Stamp in seconds and score of each valid pair.
    frames: Vec<(f64, FrameScore)>,
    window: VecDeque<(f64, FrameScore, Sums)>,
    /// The first valid pairs: predictions and truths.
    kept: (TactileSequence, TactileSequence),
    /// Ends of the truth's stretches of time, in valid pairs; the last one is open.
    ends: Vec<usize>,
    /// Of the newest valid pair.
    stretch: u64,
    came: Option<Instant>,
    touch: Touch,
}

/// Scores of touch as `egotac verify` has them, as far as fields tell: vertices lie as in the rest pose.
#[derive(Default)]
struct Touch {
    hands: Option<RestHands>,
    /// Of the open stretch.
    open: Option<Scorer>,
    /// Of the stretches before.
    ended: Sums,
}

impl Touch {
    /// Takes a valid pair and returns what it adds.
    fn add(&mut self, secs: f64, predicted: &TactileField, target: &TactileField) -> crate::Result<Sums> {
        if self.hands.as_ref().is_none_or(|hands| hands.topology != target.topology) {
            self.end();
            self.hands = Some(RestHands::of(target.topology, None)?);
        }
        let Some(hands) = &self.hands else { return Ok(Sums::default()) };
        let truth = TruthFrame::new(secs, target.force.clone(), Vec::new(), hands.positions.clone(), None)?;
        let scorer = self.open.get_or_insert_with(|| Scorer::new(hands.groups.clone()));
        scorer.push(&truth, &predicted.contact, &predicted.force)
    }

    /// Leaves an invalid pair out.
    fn refuse(&mut self) {
        self.open.iter_mut().for_each(Scorer::refuse);
    }

    /// Ends the open stretch.
    fn end(&mut self) {
        if let Some(scorer) = self.open.take() {
            self.ended += &scorer.finish();
        }
    }

    /// Sums of all stretches, the open one as if it ended here.
    fn total(&self) -> Sums {
        let mut total = self.ended.clone();
        if let Some(scorer) = &self.open {
            total += &scorer.clone().finish();
        }
        total
    }
}

impl Verifier {
    fn take_prediction(&mut self, frame: crate::Result<TactileFrame>) {
        self.tally.received();
        match frame {
            Ok(frame) => {
                self.tally.processed(self.clock.secs_since(frame.header.stamp));
                let pair = self.pairing.left(frame.header.stamp, frame);
                self.score(pair);
            }
            Err(error) => self.refuse("tactile", &error),
        }
    }

    fn take_truth(&mut self, truth: crate::Result<TactileTruth>) {
        match truth {
            Ok(truth) => {
                let stretch = self.stretches.episode_number(&truth);
                let pair = self.pairing.right(truth.frame.header.stamp, (stretch, truth));
                self.score(pair);
            }
            Err(error) => self.refuse("truth", &error),
        }
    }

    fn refuse(&mut self, topic: &'static str, error: &crate::Error) {
        self.tally.dropped("malformed");
        self.log.warn_throttled(topic, format!("{topic}: message left out: {error}"));
    }

    fn score(&mut self, pair: Option<(TactileFrame, (u64, TactileTruth))>) {
        let Some((frame, (stretch, truth))) = pair else { return };
        if let Err(error) = self.scored.add(frame, &truth, stretch) {
            self.refuse("pair", &error);
        }
    }

    /// Once a second: metrics to the topic, a line to the terminal, and the node's state.
    fn tick(
        &mut self,
        publisher: &Publisher<TactileMetrics>,
        parameters: &Parameters,
        (tactile, truth): &(String, String),
    ) -> Report {
        let rates = self.tally.counts().rates();
        self.scored.slide(parameters.get("window_secs"));
        let values = self.values(rates.1);
        if let Err(error) = publisher.publish(&self.message(&values)) {
            self.log.warn_throttled("metrics", format!("~/metrics: {error:#}"));
        }
        if parameters.get("print") && self.scored.pairs > 0 {
            // Who listens may have gone; that ends nothing here.
            let _ = writeln!(std::io::stdout(), "{}", self.line(&values));
        }
        let (level, message) = match (rates.1 > 0.0, self.scored.window.is_empty()) {
            (false, _) => (Level::Stale, format!("no predictions on {tactile}")),
            (true, true) if self.scored.invalid > 0 => {
                (Level::Warn, format!("no valid pair; {} frames of {truth} were invalid", self.scored.invalid))
            }
            (true, true) => (Level::Warn, format!("nothing on {truth} has the stamp of a prediction")),
            (true, false) => (Level::Ok, format!("{} pairs", self.scored.pairs)),
        };
        Report { task: "pairs", level, message, values: self.tally.counts().values(rates) }
    }

    /// Names and values of the rolling metrics; NaN = undefined.
    fn values(&self, rate: f64) -> Vec<(String, f64)> {
        let report = metrics::summarize(self.scored.window.iter().map(|(_, score, _)| score));
        let mut values = Vec::new();
        flatten("", &json!(report), &mut values);
        let touch = self.scored.window.iter().fold(Sums::default(), |mut sum, (_, _, sums)| {
            sum += sums;
            sum
        });
        for (name, value) in scores_of(&touch) {
            // Beginnings and ends of touches are known at the end only; the rest is there by the same names.
            if !values.iter().any(|(known, _)| known == name) && !ROLLING_UNKNOWN.iter().any(|part| name.contains(part))
            {
                values.push((name.to_owned(), value.unwrap_or(f64::NAN)));
            }
        }
        let counts = self.tally.counts();
        values.push(("rate_hz".to_owned(), rate));
        values.push(("latency_p50_secs".to_owned(), counts.latency(0.5)));
        values.push(("latency_p95_secs".to_owned(), counts.latency(0.95)));
        values
    }

    fn message(&self, values: &[(String, f64)]) -> TactileMetrics {
        let (unmatched_predictions, unmatched_truths) = self.pairing.unmatched(PATIENCE);
        let window = &self.scored.window;
        let span = window.front().zip(window.back()).map_or(0.0, |(first, last)| last.0 - first.0);
        let (names, values) = values.iter().cloned().unzip();
        TactileMetrics {
            header: self.scored.newest.clone(),
            window_pairs: window.len() as u32,
            window_secs: span,
            pairs: self.scored.pairs,
            unmatched_predictions,
            unmatched_truths,
            invalid_truths: self.scored.invalid,
            names,
            values,
        }
    }

    fn line(&self, values: &[(String, f64)]) -> String {
        let value = |name: &str| values.iter().find(|(n, _)| n == name).map_or(f64::NAN, |(_, value)| *value);
        format!(
            "{:6} pairs {:5.1} Hz | MAE {:.4} N, active {:.3} N, r {:.2} | F1 {:.2}, IoU {:.2} | \
             latency p50 {:.0} ms, p95 {:.0} ms | without prediction {}",
            self.scored.pairs,
            value("rate_hz"),
            value("mae"),
            value("active_mae"),
            value("temporal_pearson"),
            value("pooled.f1"),
            value("pooled.iou"),
            value("latency_p50_secs") * 1e3,
            value("latency_p95_secs") * 1e3,
            self.pairing.unmatched(PATIENCE).1,
        )
    }

    /// Everything since the start.
    fn summary(&mut self) -> anyhow::Result<Value> {
        let counts = self.tally.counts();
        // At the end nothing more will come for those that wait.
        let (unmatched_predictions, unmatched_truths) = self.pairing.unmatched(0.0);
        let secs = self.started.elapsed().as_secs_f64();
        let report = self.scored.total()?;
        Ok(json!({
            "model_id": self.scored.model_id,
            "topology": self.scored.topology,
            "pairs": self.scored.pairs,
            "unmatched_predictions": unmatched_predictions,
            "unmatched_truths": unmatched_truths,
            "invalid_truths": self.scored.invalid,
            "malformed": counts.drops.get("malformed").copied().unwrap_or(0),
            "duration_secs": secs,
            "rate_hz": self.scored.rate(),
            "latency_secs": {
                "p50": finite(counts.latency(0.5)),
                "p95": finite(counts.latency(0.95)),
                "max": finite(counts.latency(1.0)),
            },
            "metrics": report,
            "touch": scores_of(&self.scored.touch.total()),
        }))
    }

    /// Which bars were missed, in words.
    fn missed(&self, bars: &[Requirement]) -> Vec<String> {
        let total = self.scored.touch.total();
        bars.iter().filter_map(|bar| bar.missed((bar.score.value)(&total))).collect()
    }
}

impl Scored {
    fn add(&mut self, frame: TactileFrame, truth: &TactileTruth, stretch: u64) -> crate::Result<()> {
        for (name, hands) in [("tactile.hands", &frame.hands), ("truth.hands", &truth.frame.hands)] {
            if hands.is_empty() {
                return Err(crate::Error::value(name, "at least one hand", "none, which means no result"));
            }
        }
        let (predicted, target) = (frame.to_field()?, truth.frame.to_field()?);
        predicted.topology.must_match(target.topology)?;
        self.pairs += 1;
        if truth.validity()? != Validity::Valid {
            self.invalid += 1;
            self.touch.refuse();
            return Ok(());
        }
        let score = FrameScore::new(&predicted.force, &predicted.contact, &target.force, &target.contact, &[], &[]);
        let stamp = frame.header.stamp.secs();
        if std::mem::replace(&mut self.stretch, stretch) != stretch && !self.frames.is_empty() {
            self.ends.push(self.frames.len());
            self.window.clear();
            self.touch.end();
        }
        let sums = self.touch.add(stamp, &predicted, &target)?;
        self.came = Some(Instant::now());
        self.frames.push((stamp, score.clone()));
        self.window.push_back((stamp, score, sums));
        // After a change of topology, pairs no longer fit those kept before.
        let fits = self.kept.0.topology.is_none_or(|kept| kept == predicted.topology);
        if fits && self.kept.0.n_frames() < KEPT {
            self.kept.0.push(&predicted)?;
            self.kept.1.push(&target)?;
        }
        self.newest = frame.header;
        self.model_id = frame.model_id;
        self.topology = frame.topology;
        Ok(())
    }

    /// Drops what is older than the window, all of it if nothing came for as long as it is.
    fn slide(&mut self, window_secs: f64) {
        if self.came.is_some_and(|came| came.elapsed().as_secs_f64() > window_secs) {
            self.window.clear();
        }
        let Some((newest, ..)) = self.window.back() else { return };
        let oldest = newest - window_secs;
        self.window.retain(|(stamp, ..)| *stamp >= oldest);
    }

    /// Ends of all stretches, in valid pairs.
    fn all_ends(&self) -> Vec<usize> {
        let open = (!self.frames.is_empty()).then_some(self.frames.len());
        self.ends.iter().copied().chain(open).collect()
    }

    /// The valid pairs of each stretch.
    fn stretches(&self) -> impl Iterator<Item = &[(f64, FrameScore)]> {
        let ends = self.all_ends();
        let starts = std::iter::once(0).chain(ends.clone());
        starts.zip(ends).map(|(start, end)| &self.frames[start..end])
    }

    /// Valid pairs per second of their stamps, within stretches; None of fewer than two.
    fn rate(&self) -> Option<f64> {
        let steps = self.stretches().flat_map(|stretch| stretch.windows(2).map(|pair| pair[1].0 - pair[0].0));
        let (secs, count) = steps.fold((0.0, 0), |(secs, count), step| (secs + step, count + 1));
        (secs > 0.0).then(|| f64::from(count) / secs)
    }

    /// All scores; beyond the pairs kept whole, those that need all vertices of all frames are undefined.
    fn total(&mut self) -> crate::Result<metrics::Metrics> {
        if self.frames.len() > self.kept.0.n_frames() {
            let summary = |frames: &[(f64, FrameScore)]| metrics::summarize(frames.iter().map(|(_, score)| score));
            let each: Vec<f64> = self.stretches().filter_map(|stretch| summary(stretch).temporal_pearson).collect();
            let temporal_pearson = (!each.is_empty()).then(|| each.iter().sum::<f64>() / each.len() as f64);
            return Ok(metrics::Metrics { temporal_pearson, ..summary(&self.frames) });
        }
        self.kept.1.episode_ends = self.all_ends();
        metrics::evaluate(&self.kept.0, &self.kept.1, &EvalOptions { fps: self.rate(), calibration: None })
    }
}

/// Nested numbers under dotted names; null = NaN.
pub(super) fn flatten(prefix: &str, value: &Value, values: &mut Vec<(String, f64)>) {
    match value {
        Value::Object(entries) => {
            for (key, value) in entries {
                let name = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
                flatten(&name, value, values);
            }
        }
        value => values.push((prefix.to_owned(), value.as_f64().unwrap_or(f64::NAN))),
    }
}

fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

fn write_report(path: &Path, summary: &Value) -> anyhow::Result<()> {
    file::write(path, format!("{summary:#}\n").as_bytes()).context("cannot write the report")
}
