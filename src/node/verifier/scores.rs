//! Scores of the pairs of prediction and truth, over the rolling window and since the start.

use std::collections::{BTreeMap, VecDeque};
use std::time::Instant;

use serde_json::json;

use super::touch_scores::TouchScores;
use crate::message::{Header, TactileFrame, TactileTruth};
use crate::node::flatten::flatten;
use crate::score::agreement::Sums;
use crate::score::metrics::{self, EvalOptions, FrameScore, baseline};
use crate::score::verify::report::scores_of;
use crate::tactile::{TactileField, TactileSequence, Validity};

/// Parts of the names of scores that need whole touches and are therefore unknown in the rolling window.
const WHOLE_TOUCH_SCORES: [&str; 2] = ["_secs", "_touches"];
/// Most pairs whose fields are kept for the scores that need all vertices of all frames; about 100 MB.
const MAX_KEPT_FIELDS: usize = 2000;

/// Scores of the pairs so far.
#[derive(Default)]
pub(super) struct Scores {
    /// Header of the newest valid pair.
    pub(super) header: Header,
    pub(super) model_id: String,
    pub(super) topology: String,
    /// Pairs so far, with valid and invalid truth.
    pub(super) pairs: u64,
    /// Pairs with invalid truth.
    pub(super) invalid: u64,
    /// Pairs with valid truth and a hand that the predictor does not know; these hands leave all scores.
    pub(super) unknown: u64,
    pub(super) touch: TouchScores,
    /// Scores of all pairs; a pair with invalid truth is a gap.
    running: metrics::RunningSummary,
    /// Sum of the time between two pairs of an episode, s, and their number.
    steps: (f64, u64),
    /// Stamp of the newest pair of the open episode, s.
    last_secs: Option<f64>,
    /// Scores and touch sums of the valid pairs in the rolling window.
    window: VecDeque<(StampedScore, Sums)>,
    /// Fields of the first valid pairs.
    predicted: TactileSequence,
    target: TactileSequence,
    /// Ends of the closed episodes, as indices into the fields; complete while all fields are kept.
    episode_ends: Vec<usize>,
    /// Number of the episode of the newest valid pair.
    episode: u64,
    /// Arrival of the newest valid pair.
    arrived: Option<Instant>,
}

struct StampedScore {
    secs: f64,
    score: FrameScore,
}

/// Makes truth unknown where the mask is 0, so that it leaves all scores; an empty mask keeps it.
fn without_unknown(mut truth: TactileField, known: &[u8]) -> TactileField {
    for values in [&mut truth.force, &mut truth.contact] {
        values.iter_mut().zip(known).filter(|(_, known)| **known == 0).for_each(|(value, _)| *value = f32::NAN);
    }
    truth
}

impl Scores {
    /// Adds a pair; `episode` is the number of the truth's episode.
    ///
    /// # Errors
    /// If a message has no hands, or the fields of the pair do not fit each other.
    pub(super) fn push(&mut self, frame: TactileFrame, truth: &TactileTruth, episode: u64) -> crate::Result<()> {
        for (name, hands) in [("tactile.hands", &frame.hands), ("truth.hands", &truth.frame.hands)] {
            if hands.is_empty() {
                return Err(crate::Error::value(name, "at least one hand", "none, which means no result"));
            }
        }
        let (predicted, target) = (frame.to_field()?, truth.frame.to_field()?);
        predicted.topology.must_match(target.topology)?;
        self.pairs += 1;
        let secs = frame.header.stamp.secs();
        let validity = truth.validity()?;
        if validity != Validity::Valid {
            self.invalid += 1;
            self.touch.skip();
            if self.episode == episode {
                self.count(secs, &FrameScore::default());
                self.keep(&predicted, &target, validity)?;
            }
            return Ok(());
        }
        if std::mem::replace(&mut self.episode, episode) != episode && self.running.frames() > 0 {
            if self.keeps_all() {
                self.episode_ends.push(self.running.frames());
            }
            self.running.end_episode();
            self.last_secs = None;
            self.window.clear();
            self.touch.end_episode();
        }
        let known = predicted.known_hands();
        self.unknown += u64::from(!known.is_empty());
        let target = without_unknown(target, &known);
        let sums = self.touch.push(secs, &predicted, &target)?;
        let score =
            FrameScore::new(&predicted.force, &predicted.contact, &target.force, &target.contact, &known, &known);
        self.count(secs, &score);
        self.window.push_back((StampedScore { secs, score }, sums));
        self.arrived = Some(Instant::now());
        self.keep(&predicted, &target, validity)?;
        self.header = frame.header;
        self.model_id = frame.model_id;
        self.topology = frame.topology;
        Ok(())
    }

    /// Adds a pair to the scores of all pairs.
    fn count(&mut self, secs: f64, score: &FrameScore) {
        self.running.push(score);
        if let Some(last) = self.last_secs.replace(secs) {
            self.steps = (self.steps.0 + secs - last, self.steps.1 + 1);
        }
    }

    /// Keeps the fields of a pair for the scores that need them.
    fn keep(&mut self, predicted: &TactileField, target: &TactileField, validity: Validity) -> crate::Result<()> {
        // After a change of topology, pairs no longer fit those kept before.
        let fits = self.predicted.topology.is_none_or(|kept| kept == predicted.topology);
        if fits && self.predicted.n_frames() < MAX_KEPT_FIELDS {
            self.predicted.push(predicted)?;
            self.target.push(target)?;
            self.target.validity.resize(self.target.n_frames(), 0);
            if let Some(code) = self.target.validity.last_mut() {
                *code = validity.code();
            }
        }
        Ok(())
    }

    /// Drops pairs older than the rolling window; all of them if none arrived for the length of the window.
    pub(super) fn slide_window(&mut self, window_secs: f64) {
        if self.arrived.is_some_and(|arrived| arrived.elapsed().as_secs_f64() > window_secs) {
            self.window.clear();
        }
        let Some((newest, _)) = self.window.back() else { return };
        let oldest = newest.secs - window_secs;
        self.window.retain(|(frame, _)| frame.secs >= oldest);
    }

    /// Number of pairs in the rolling window.
    pub(super) fn window_len(&self) -> usize {
        self.window.len()
    }

    /// Returns the time between the oldest and the newest pair of the rolling window, s.
    pub(super) fn window_secs(&self) -> f64 {
        let ends = self.window.front().zip(self.window.back());
        ends.map_or(0.0, |((first, _), (last, _))| last.secs - first.secs)
    }

    /// Returns names and values of the scores over the rolling window; NaN = undefined.
    pub(super) fn window_scores(&self) -> Vec<(String, f64)> {
        let report = metrics::summarize(self.window.iter().map(|(frame, _)| &frame.score));
        let mut scores = flatten(&json!(report));
        let touch = self.window.iter().fold(Sums::default(), |mut total, (_, sums)| {
            total += sums;
            total
        });
        for (name, value) in scores_of(&touch) {
            let is_known = scores.iter().any(|(known, _)| known == name);
            if !is_known && !WHOLE_TOUCH_SCORES.iter().any(|part| name.contains(part)) {
                scores.push((name.to_owned(), value.unwrap_or(f64::NAN)));
            }
        }
        scores
    }

    /// Returns the pairs per second of their stamps, within episodes; None for fewer than two pairs.
    pub(super) fn rate(&self) -> Option<f64> {
        let (secs, count) = self.steps;
        (secs > 0.0).then(|| count as f64 / secs)
    }

    /// Returns the metrics of no touch at all and of the truth of the frame before, over the same pairs; none if not all
    /// fields were kept.
    ///
    /// # Errors
    /// If the metrics cannot be computed.
    pub(super) fn baselines(&mut self) -> crate::Result<BTreeMap<&'static str, metrics::Metrics>> {
        if !self.keeps_all() {
            return Ok(BTreeMap::new());
        }
        self.target.episode_ends = self.all_episode_ends();
        let options = EvalOptions { fps: self.rate(), calibration: None };
        let zero = baseline::zero().sequence(self.target.n_frames());
        let fields = [("zero", zero), ("persistence", baseline::persistence(&self.target, None))];
        let score = |fields: &TactileSequence| metrics::evaluate(fields, &self.target, &options);
        fields.iter().map(|(name, fields)| score(fields).map(|scores| (*name, scores))).collect()
    }

    /// Returns the metrics over all pairs; those with invalid truth are gaps. If not all fields were kept, metrics that need
    /// all vertices of all frames are undefined.
    ///
    /// # Errors
    /// If the metrics cannot be computed.
    pub(super) fn total(&mut self) -> crate::Result<metrics::Metrics> {
        if !self.keeps_all() {
            return Ok(self.running.metrics());
        }
        self.target.episode_ends = self.all_episode_ends();
        metrics::evaluate(&self.predicted, &self.target, &EvalOptions { fps: self.rate(), calibration: None })
    }

    /// Ends of all episodes, the open one included; complete while all fields are kept.
    fn all_episode_ends(&self) -> Vec<usize> {
        let open = (self.running.frames() > 0).then_some(self.running.frames());
        self.episode_ends.iter().copied().chain(open).collect()
    }

    /// True if the fields of all pairs were kept.
    fn keeps_all(&self) -> bool {
        self.predicted.n_frames() == self.running.frames()
    }
}
