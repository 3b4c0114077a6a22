//! Scores of the normalised total force: shape, and moments of rise and fall.

use serde::{Deserialize, Serialize};

use super::contact::Confusion;
use super::run::Run;
use super::statistics::{finite, is_constant};

/// A change of the normalised total force beyond this, per frame, is an event (paper, eta).
pub const EVENT_THRESHOLD: f64 = 1e-4;

/// Smallest and largest total force of a sensor, N; a trace is normalised by mapping them to 0 and 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Range {
    /// Force that maps to 0, N.
    pub min: f64,
    /// Force that maps to 1, N.
    pub max: f64,
}

/// Content of a calibration file: one range for both sides, or one each.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Calibration {
    /// `{"min": .., "max": ..}`
    Both(Range),
    /// `{"pred": {"min": .., "max": ..}, "target": {..}}`
    Each {
        /// Range of the predicted total force.
        pred: Range,
        /// Range of the true total force.
        target: Range,
    },
}

impl Calibration {
    /// Returns the range of the predicted total force.
    pub fn pred(&self) -> Range {
        match self {
            Self::Both(range) => *range,
            Self::Each { pred, .. } => *pred,
        }
    }

    /// Returns the range of the true total force.
    pub fn target(&self) -> Range {
        match self {
            Self::Both(range) => *range,
            Self::Each { target, .. } => *target,
        }
    }
}

/// Returns the range of the values; None without values.
pub fn range(values: impl IntoIterator<Item = f64>) -> Option<Range> {
    values.into_iter().fold(None, |range, x| {
        let Range { min, max } = range.unwrap_or(Range { min: x, max: x });
        Some(Range { min: min.min(x), max: max.max(x) })
    })
}

/// Maps `range` to 0..1 and clamps to it. A range of zero width, which a constant has, maps to 1 if the constant is above 0.
pub fn normalise(trace: &[f64], range: Range) -> Vec<f64> {
    let width = range.max - range.min;
    let one = |x: &f64| match width > 0.0 {
        true => ((x - range.min) / width).clamp(0.0, 1.0),
        false => f64::from(u8::from(*x > 0.0)),
    };
    trace.iter().map(one).collect()
}

/// Returns the cosine of two traces of the same length; 0 if the prediction is zero everywhere, None if the truth is.
pub fn cosine(pred: &[f64], target: &[f64]) -> Option<f64> {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    if is_constant(pred) && pred.first() == Some(&0.0) && dot(target, target) > 0.0 {
        return Some(0.0);
    }
    finite(dot(pred, target) / (dot(pred, pred).sqrt() * dot(target, target).sqrt()))
}

/// Returns the F1 of the steps at which the trace rises by more than [`EVENT_THRESHOLD`]; None if neither side ever does.
/// No step leads from one run to the next.
pub fn rise_f1(runs: &[Run]) -> Option<f64> {
    event_f1(runs, |change| change > EVENT_THRESHOLD)
}

/// Returns the F1 of the steps at which the trace falls by more than [`EVENT_THRESHOLD`], as [`rise_f1`] does.
pub fn fall_f1(runs: &[Run]) -> Option<f64> {
    event_f1(runs, |change| change < -EVENT_THRESHOLD)
}

fn event_f1(runs: &[Run], is_event: fn(f64) -> bool) -> Option<f64> {
    let events = |trace: &[f64]| -> Vec<bool> { trace.windows(2).map(|pair| is_event(pair[1] - pair[0])).collect() };
    let of_run = |run: &Run| events(&run.pred).into_iter().zip(events(&run.target)).collect::<Vec<_>>();
    let pairs: Vec<(f32, bool)> =
        runs.iter().flat_map(of_run).map(|(pred, target)| (f32::from(pred), target)).collect();
    Confusion::of(&pairs).scores().f1
}
