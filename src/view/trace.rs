//! Total force and familiarity over a whole recording.

use serde::Serialize;

use super::moment::known;
use crate::dataset::Labelled;
use crate::hand::Side;
use crate::report::totals;
use crate::tactile::TactileSequence;

/// Largest number of points; in longer recordings each point stands for several frames.
const MAX_POINTS: usize = 4000;

/// Total force of both hands, and familiarity, over a recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Course {
    /// Number of frames that a point stands for.
    pub step: usize,
    /// Largest total force of the left and the right hand at each point, N; None = unknown.
    pub force: [Vec<Option<f32>>; 2],
    /// The same of the truth; empty without truth.
    pub truth: [Vec<Option<f32>>; 2],
    /// Least familiarity at each point; None = not estimated; empty = of no frame.
    pub familiarity: Vec<Option<f32>>,
}

impl Course {
    /// Returns the course of a labelled recording.
    pub(super) fn of(labelled: &Labelled, truth: Option<&TactileSequence>) -> Self {
        let labels = &labelled.labels;
        let step = labels.n_frames().div_ceil(MAX_POINTS).max(1);
        let force = |sequence: &TactileSequence| Side::BOTH.map(|side| largest(&totals(&sequence.force, side), step));
        let least = |group: &[f32]| known(group.iter().copied().fold(f32::NAN, f32::min));
        Self {
            step,
            force: force(labels),
            truth: truth.map(force).unwrap_or_default(),
            familiarity: labels.familiarity.chunks(step).map(least).collect(),
        }
    }
}

/// Returns the largest value of each group of `step` neighbours; None where a whole group is unknown.
fn largest(values: &[f64], step: usize) -> Vec<Option<f32>> {
    values.chunks(step).map(|group| known(group.iter().copied().fold(f64::NAN, f64::max) as f32)).collect()
}
