//! Splits a truth stream into episodes.

use crate::message::TactileTruth;

/// Shortest pause that may end an episode, s. It must also exceed three frame intervals, so that a slow stream is not cut.
const MIN_PAUSE: f64 = 1.0;

/// Numbers the episodes of a truth stream.
#[derive(Debug, Clone, Default)]
pub struct EpisodeSplitter {
    number: u64,
    last_stamp: Option<f64>,
    interval: Option<f64>,
    model_id: String,
}

impl EpisodeSplitter {
    /// Returns the number of the episode that `truth` belongs to. A new episode begins when the scene changes, when stamps go
    /// back, and after a pause.
    pub fn episode_number(&mut self, truth: &TactileTruth) -> u64 {
        let stamp = truth.frame.header.stamp.secs();
        if let Some(last) = self.last_stamp {
            let step = stamp - last;
            let paused = step > MIN_PAUSE && self.interval.is_some_and(|interval| step > 3.0 * interval);
            if step < 0.0 || paused || self.model_id != truth.frame.model_id {
                self.number += 1;
            } else {
                self.interval = Some(step);
            }
        }
        self.last_stamp = Some(stamp);
        self.model_id.clone_from(&truth.frame.model_id);
        self.number
    }
}
