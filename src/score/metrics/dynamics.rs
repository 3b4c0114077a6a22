//! Scores of the normalised total force: shape, and moments of rise and fall.

use serde::Deserialize;

use super::contact::Confusion;
use super::statistics::finite;

/// A change of the normalised total force beyond this, per frame, is an event (paper, eta).
pub const EVENT_THRESHOLD: f64 = 1e-4;

/// Smallest and largest total force of a sensor, N; a trace is normalised by mapping them to 0 and 1.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Range {
    /// Force that maps to 0, N.
    pub min: f64,
    /// Force that maps to 1, N.
    pub max: f64,
}

/// Content of a calibration file: one range for both sides, or one each.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
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

/// Returns the range of a trace.
pub fn range(trace: &[f64]) -> Range {
    let fold = |start: f64, pick: fn(f64, f64) -> f64| trace.iter().copied().fold(start, pick);
    Range { min: fold(f64::INFINITY, f64::min), max: fold(f64::NEG_INFINITY, f64::max) }
}

/// Maps `range` to 0..1 and clamps to it; a range of zero width maps to 0.
pub fn normalise(trace: &[f64], range: Range) -> Vec<f64> {
    let width = range.max - range.min;
    let one = |x: &f64| if width > 0.0 { ((x - range.min) / width).clamp(0.0, 1.0) } else { 0.0 };
    trace.iter().map(one).collect()
}

/// Returns the cosine of two traces; None if one is zero everywhere or they differ in length.
pub fn cosine(pred: &[f64], target: &[f64]) -> Option<f64> {
    if pred.len() != target.len() {
        return None;
    }
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    finite(dot(pred, target) / (dot(pred, pred).sqrt() * dot(target, target).sqrt()))
}

/// Returns the F1 of the steps at which the trace rises by more than [`EVENT_THRESHOLD`]; None if neither side ever does.
pub fn rise_f1(pred: &[f64], target: &[f64]) -> Option<f64> {
    event_f1(pred, target, |change| change > EVENT_THRESHOLD)
}

/// Returns the F1 of the steps at which the trace falls by more than [`EVENT_THRESHOLD`]; None if neither side ever does.
pub fn fall_f1(pred: &[f64], target: &[f64]) -> Option<f64> {
    event_f1(pred, target, |change| change < -EVENT_THRESHOLD)
}

fn event_f1(pred: &[f64], target: &[f64], is_event: fn(f64) -> bool) -> Option<f64> {
    if pred.len() != target.len() {
        return None;
    }
    let events = |trace: &[f64]| -> Vec<bool> { trace.windows(2).map(|pair| is_event(pair[1] - pair[0])).collect() };
    let pairs: Vec<(f32, bool)> =
        events(pred).into_iter().zip(events(target)).map(|(pred, target)| (f32::from(pred), target)).collect();
    Confusion::of(&pairs).scores().f1
}
