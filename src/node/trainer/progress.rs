//! Progress of a training, for status, feedback and diagnostics.

use std::path::PathBuf;

use crate::message::TrainerStatus;
use crate::node::flatten::flatten;
use crate::train::Event;
use crate::train::job::JobEvent;
use crate::train::pass::Losses;

/// Weight of the previous value in the exponential smoothing of the throughput; averages over about ten steps.
const THROUGHPUT_SMOOTHING: f64 = 0.9;

/// Progress of a training.
#[derive(Debug, Clone)]
pub(super) struct Progress {
    /// State as in TrainerStatus.
    pub(super) state: &'static str,
    /// Message as in TrainerStatus.
    pub(super) message: String,
    /// Steps taken.
    pub(super) step: usize,
    /// Steps of the goal.
    pub(super) steps: usize,
    /// Losses of the newest step, by name.
    pub(super) losses: Vec<(String, f64)>,
    /// Newest scores on the held-out stores, by name.
    pub(super) scores: Vec<(String, f64)>,
    /// Smoothed throughput, windows per second.
    pub(super) windows_per_s: f64,
    /// Time to the last step, s.
    pub(super) remaining_secs: f64,
    /// Checkpoint of a round that has ended, until it is announced.
    pub(super) round_checkpoint: Option<PathBuf>,
}

impl Default for Progress {
    fn default() -> Self {
        Self {
            state: TrainerStatus::IDLE,
            message: String::new(),
            step: 0,
            steps: 0,
            losses: Vec::new(),
            scores: Vec::new(),
            windows_per_s: f64::NAN,
            remaining_secs: f64::NAN,
            round_checkpoint: None,
        }
    }
}

impl Progress {
    /// Applies an event of the training thread.
    pub(super) fn update(&mut self, event: &JobEvent) {
        match event {
            JobEvent::Waiting(there, wanted) => {
                self.state = TrainerStatus::WAITING;
                self.message = format!("{there} of {wanted} live frames");
            }
            JobEvent::Training(before, Event::Stepped(step)) => {
                self.state = TrainerStatus::TRAINING;
                self.message.clear();
                self.step = before + step.step;
                let losses = Losses::NAMES.iter().zip(step.losses.values());
                self.losses = losses.map(|(name, value)| ((*name).to_owned(), value.into())).collect();
                self.update_throughput(step.windows as f64, step.secs);
            }
            JobEvent::Training(_, Event::Validated(_, report)) => self.scores = flatten(&serde_json::json!(report)),
            JobEvent::Training(..) => {}
            JobEvent::RoundEnded(checkpoint) => self.round_checkpoint = Some(checkpoint.to_path_buf()),
        }
    }

    /// Updates throughput and remaining time after a step of `windows` windows in `secs` seconds.
    fn update_throughput(&mut self, windows: f64, secs: f64) {
        let newest = windows / secs.max(1e-9);
        self.windows_per_s = match self.windows_per_s.is_nan() {
            true => newest,
            false => THROUGHPUT_SMOOTHING * self.windows_per_s + (1.0 - THROUGHPUT_SMOOTHING) * newest,
        };
        let left = self.steps.saturating_sub(self.step) as f64;
        self.remaining_secs = left * windows / self.windows_per_s;
    }
}

/// Converts a status to r2r's own type, which the action's feedback holds.
pub(super) fn native_status(status: &TrainerStatus) -> r2r::egotac_msgs::msg::TrainerStatus {
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
