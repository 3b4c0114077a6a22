//! Episodes of a stream of truth, as far as the stream tells.

use crate::message::TactileTruth;

/// A pause of the truth that ends a stretch of time, s, if it is also out of step; nothing looks across it.
const PAUSE: f64 = 1.0;

/// Numbers the truth's stretches of time.
#[derive(Debug, Clone, Default)]
pub struct EpisodeSplitter {
    number: u64,
    last: Option<f64>,
    step: Option<f64>,
    model_id: String,
}

impl EpisodeSplitter {
    /// The stretch that a truth belongs to. A new one begins with another scene, when stamps go back, and after a pause.
    pub fn episode_number(&mut self, truth: &TactileTruth) -> u64 {
        let stamp = truth.frame.header.stamp.secs();
        if let Some(last) = self.last {
            let step = stamp - last;
            let pauses = step > PAUSE && self.step.is_some_and(|usual| step > 3.0 * usual);
            if step < 0.0 || pauses || self.model_id != truth.frame.model_id {
                self.number += 1;
            } else {
                self.step = Some(step);
            }
        }
        self.last = Some(stamp);
        self.model_id.clone_from(&truth.frame.model_id);
        self.number
    }
}
