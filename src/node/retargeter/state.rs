//! What became of the hands, for /diagnostics.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use super::Inputs;
use crate::error::Error;
use crate::node::diagnostics::{self, Level, Tally, TaskReport};
use crate::node::runtime::Runtime;
use crate::retarget::Status;
use crate::statistics::percentile;

/// The newest times of the solver that percentiles look back on.
const WINDOW: usize = 500;

/// What the control loop tells the diagnostics.
#[derive(Clone, Default)]
pub struct State {
    /// Hands that came, were followed, or were not, and why.
    pub hands: Tally,
    counts: Arc<Mutex<Counts>>,
}

#[derive(Default)]
struct Counts {
    with_touch: u64,
    statuses: [u64; Status::ALL.len()],
    solve_secs: VecDeque<f64>,
    /// Times that the loop missed.
    late: u64,
    /// What is wrong with the newest hand, if anything.
    refused: Option<String>,
}

impl State {
    /// A hand was followed, and the solver took so long.
    pub fn followed(&self, status: Status, has_touch: bool, solve_secs: f64) {
        let mut counts = self.counts();
        counts.refused = None;
        counts.statuses[status as usize] += 1;
        counts.with_touch += u64::from(has_touch);
        if counts.solve_secs.len() == WINDOW {
            counts.solve_secs.pop_front();
        }
        counts.solve_secs.push_back(solve_secs);
    }

    /// A hand could not be followed.
    pub fn refused(&self, error: &Error) {
        self.hands.dropped("refused");
        let mut counts = self.counts();
        counts.statuses[Status::Held as usize] += 1;
        counts.refused = Some(error.to_string());
    }

    /// The control loop missed a cycle.
    pub fn late(&self) {
        self.counts().late += 1;
    }

    fn counts(&self) -> std::sync::MutexGuard<'_, Counts> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Publishes /diagnostics from now on.
///
/// # Errors
/// If ROS refuses it.
pub fn report(runtime: &mut Runtime, inputs: Inputs, state: State, robot: String) -> anyhow::Result<()> {
    let topics = format!("{} or {}", runtime.resolve("hand_pose"), runtime.resolve("keypoints"));
    diagnostics::publish(
        runtime,
        move || robot.clone(),
        move |runtime| {
            let (overtaken, touched) = {
                let inputs = inputs.lock().unwrap_or_else(PoisonError::into_inner);
                (inputs.overtaken(), inputs.touches_arrive(Instant::now()))
            };
            state.hands.set_dropped("superseded", overtaken);
            let mut tally = state.hands.counts();
            let rates = tally.rates();
            let mut counts = state.counts();
            let (level, message) = if !runtime.parameters().get::<bool>("enabled") {
                (Level::Ok, "disabled".to_owned())
            } else if let Some(error) = &counts.refused {
                (Level::Warn, format!("holds the last pose: {error}"))
            } else if rates.received == 0.0 {
                (Level::Stale, format!("no hands on {topics}"))
            } else {
                let touch = if touched { "with touch" } else { "no touch" };
                (Level::Ok, format!("follows {:.1} hands per second, {touch}", rates.processed))
            };
            let mut values = tally.values(rates);
            values.push(("with_touch".to_owned(), counts.with_touch.to_string()));
            values.push(("late_cycles".to_owned(), counts.late.to_string()));
            for (name, count) in STATUS_NAMES.into_iter().zip(counts.statuses) {
                values.push((format!("status_{name}"), count.to_string()));
            }
            for (name, q) in [("p50", 0.5), ("p99", 0.99), ("max", 1.0)] {
                let secs = percentile(counts.solve_secs.make_contiguous().iter().copied(), q);
                values.push((format!("solve_{name}_us"), format!("{:.0}", 1e6 * secs)));
            }
            TaskReport { task: "hands", level, message, values }
        },
    )
}

/// Names of [`Status::ALL`] in diagnostics.
const STATUS_NAMES: [&str; Status::ALL.len()] = ["solved", "repaired", "limited", "capped", "held"];
