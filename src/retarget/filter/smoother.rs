//! Smoothing of points, with a delay in seconds that does not depend on the frame rate.

use glam::DVec3;

use crate::hand::N_KEYPOINTS;

/// Number of low-pass stages in series.
const STAGES: usize = 6;
/// Time constant of one stage, relative to the delay of the whole filter. Six stages delay by 6 x 0.58 = 3.48 delays, of
/// which the lead takes 2.48 back.
const STAGE_RATIO: f64 = 0.58;

/// Smooths points by six equal low-pass stages and a lead that compensates most of their delay.
///
/// Slow motion comes out `delay` seconds late. Motion faster than a hand's is suppressed by all six stages, while the lead
/// amplifies it by one order only.
#[derive(Debug, Clone)]
pub struct Smoother<const N: usize = N_KEYPOINTS> {
    delay: f64,
    stages: [[DVec3; N]; STAGES],
    is_empty: bool,
}

impl<const N: usize> Smoother<N> {
    /// Creates a smoother that delays slow motion by `delay` seconds; 0 returns points unchanged.
    pub fn new(delay: f64) -> Self {
        Self { delay, stages: [[DVec3::ZERO; N]; STAGES], is_empty: true }
    }

    /// Forgets all points.
    pub fn reset(&mut self) {
        self.is_empty = true;
    }

    /// Takes the next points, `dt` seconds after the last ones, and returns smoothed ones.
    pub fn push(&mut self, points: &[DVec3; N], dt: f64) -> [DVec3; N] {
        if self.delay <= 0.0 || !dt.is_finite() {
            return *points;
        }
        if std::mem::take(&mut self.is_empty) {
            self.stages = [*points; STAGES];
            return *points;
        }
        let stage_delay = STAGE_RATIO * self.delay;
        let lead = STAGES as f64 * stage_delay - self.delay;
        let gain = dt / (dt + stage_delay);
        std::array::from_fn(|k| {
            let mut input = points[k];
            let mut rate = DVec3::ZERO;
            for stage in &mut self.stages {
                stage[k] += gain * (input - stage[k]);
                rate = (input - stage[k]) / stage_delay;
                input = stage[k];
            }
            input + lead * rate
        })
    }
}
