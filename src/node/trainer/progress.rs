//! How far a training is.

use std::sync::{Mutex, PoisonError};

use crate::message::TrainerStatus;
use crate::node::verifier::flatten;
use crate::train::Event;
use crate::train::job::JobEvent;
use crate::train::pass::Losses;

/// What the training thread tells.
#[derive(Debug, Clone)]
pub struct Progress {
    /// As in TrainerStatus.
    pub state: &'static str,
    /// As in TrainerStatus.
    pub message: String,
    /// Steps taken.
    pub step: usize,
    /// Steps wanted.
    pub steps: usize,
    /// Losses of the newest step, by name.
    pub losses: Vec<(String, f64)>,
    /// Scores on the held-out stores, by name.
    pub scores: Vec<(String, f64)>,
    /// Throughput, smoothed.
    pub windows_per_s: f64,
    /// Seconds to go.
    pub remaining_secs: f64,
}

impl Default for Progress {
    fn default() -> Self {
        Self {
            state: "idle",
            message: String::new(),
            step: 0,
            steps: 0,
            losses: Vec::new(),
            scores: Vec::new(),
            windows_per_s: f64::NAN,
            remaining_secs: f64::NAN,
        }
    }
}

/// Writes down what the training thread says.
pub fn tell(progress: &Mutex<Progress>, steps: usize, news: &JobEvent) {
    const KEEP: f64 = 0.9;
    let mut progress = progress.lock().unwrap_or_else(PoisonError::into_inner);
    match news {
        JobEvent::Waiting(there, wanted) => {
            progress.state = "waiting";
            progress.message = format!("{there} of {wanted} live frames");
        }
        JobEvent::Training(before, Event::Stepped(step)) => {
            progress.state = "training";
            progress.message.clear();
            progress.step = before + step.step;
            progress.losses = Losses::NAMES
                .iter()
                .zip(step.losses.values())
                .map(|(name, value)| ((*name).to_owned(), value.into()))
                .collect();
            let now = step.windows as f64 / step.secs.max(1e-9);
            let smooth = progress.windows_per_s;
            progress.windows_per_s = if smooth.is_nan() { now } else { KEEP * smooth + (1.0 - KEEP) * now };
            let left = steps.saturating_sub(progress.step) as f64;
            progress.remaining_secs = left * step.windows as f64 / progress.windows_per_s;
        }
        JobEvent::Training(_, Event::Validated(_, report)) => progress.scores = flat(&serde_json::json!(report)),
        JobEvent::Training(..) => {}
    }
}

/// Numbers of a JSON object, by names with dots; null = NaN.
pub fn flat(value: &serde_json::Value) -> Vec<(String, f64)> {
    let mut values = Vec::new();
    flatten("", value, &mut values);
    values
}

/// r2r's form of a status.
pub fn native(status: &TrainerStatus) -> r2r::egotac_msgs::msg::TrainerStatus {
    let s = status.clone();
    let stamp = r2r::builtin_interfaces::msg::Time { sec: s.header.stamp.sec, nanosec: s.header.stamp.nanosec };
    r2r::egotac_msgs::msg::TrainerStatus {
        header: r2r::std_msgs::msg::Header { stamp, frame_id: s.header.frame_id },
        state: s.state,
        message: s.message,
        recorded_frames: s.recorded_frames,
        recorded_episodes: s.recorded_episodes,
        evicted_episodes: s.evicted_episodes,
        recorded_bytes: s.recorded_bytes,
        step: s.step,
        steps: s.steps,
        names: s.names,
        values: s.values,
        windows_per_s: s.windows_per_s,
        remaining_secs: s.remaining_secs,
    }
}
