//! Filtering of keypoints: outlier rejection, smoothing, size of the hand.
//!
//! Keypoints are filtered before the pose is solved, so limits, couplings, contacts and distances hold in the result.

mod gate;
mod size;
mod smoother;

use glam::DVec3;

pub use self::gate::{GateResult, OutlierGate};
pub use self::size::SizeEstimate;
pub use self::smoother::Smoother;

use super::robot::spec::FilterSpec;
use crate::error::{Error, Result};
use crate::hand::N_KEYPOINTS;

/// Delay of the points that directions of bones are taken from, relative to that of the fingertips: bones are short, so
/// jitter of keypoints turns them far.
const DIRECTION_DELAY_RATIO: f64 = 1.5;
/// Input gap after which the hand may be anywhere, so that nothing is rejected or smoothed across it, s.
const NEW_HAND_GAP_SECS: f64 = 0.5;

/// Filters the keypoints of one hand.
#[derive(Debug)]
pub(super) struct HandFilter {
    gate: OutlierGate,
    smoother: Smoother,
    direction_smoother: Smoother,
    size: SizeEstimate,
}

/// Filtered keypoints of one frame, in the wrist frame.
#[derive(Debug, Clone)]
pub(super) struct FilteredPoints {
    /// (21) keypoints, m.
    pub points: [DVec3; N_KEYPOINTS],
    /// (21) keypoints smoothed more, for the directions of bones, m.
    pub direction_points: [DVec3; N_KEYPOINTS],
    /// Number of keypoints replaced as outliers.
    pub replaced: usize,
}

impl HandFilter {
    /// Creates a filter without past.
    pub fn new(spec: &FilterSpec) -> Self {
        Self {
            gate: OutlierGate::new(spec.outlier),
            smoother: Smoother::new(spec.time_constant),
            direction_smoother: Smoother::new(DIRECTION_DELAY_RATIO * spec.time_constant),
            size: SizeEstimate::default(),
        }
    }

    /// True if a hand that comes `dt` seconds after the last one may be anywhere.
    pub fn is_new_hand(dt: f64) -> bool {
        dt > NEW_HAND_GAP_SECS
    }

    /// Forgets where the hand was, but not how large it is.
    pub fn forget_pose(&mut self) {
        self.gate.forget();
        self.smoother.reset();
        self.direction_smoother.reset();
    }

    /// Filters (21) keypoints in the wrist frame, m, `dt` seconds after the last ones.
    ///
    /// # Errors
    /// If the hand is the mirror image of the one expected.
    pub fn push(&mut self, points: &[DVec3; N_KEYPOINTS], dt: f64) -> Result<FilteredPoints> {
        let (points, replaced) = match self.gate.push(points, dt.min(NEW_HAND_GAP_SECS)) {
            GateResult::Points(points, replaced) => (points, replaced),
            GateResult::Mirrored => {
                return Err(Error::value("keypoints", "the hand as before", "its mirror image"));
            }
        };
        if replaced == 0 {
            self.size.push(&points);
        }
        Ok(FilteredPoints {
            points: self.smoother.push(&points, dt),
            direction_points: self.direction_smoother.push(&points, dt),
            replaced,
        })
    }

    /// Size of the hand so far.
    pub fn size(&self) -> &SizeEstimate {
        &self.size
    }
}
