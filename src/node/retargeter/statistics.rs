//! Statistics of followed and refused hands, for /diagnostics.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use super::Inputs;
use super::hold::Hold;
use crate::error::Error;
use crate::node::approximate_sync::Touches;
use crate::node::diagnostics::{self, Level, Tally, TaskReport};
use crate::node::lock::lock;
use crate::node::runtime::Runtime;
use crate::retarget::Status;
use crate::statistics::percentile;

/// Number of latest solve times that percentiles cover.
const WINDOW: usize = 500;

/// Statistics shared by the control loop and the diagnostics.
#[derive(Clone, Default)]
pub struct Statistics {
    /// Hands received, followed, and dropped by reason.
    pub hands: Tally,
    counts: Arc<Mutex<FollowCounts>>,
}

/// Counts since the start.
#[derive(Default)]
struct FollowCounts {
    with_touch: u64,
    statuses: [u64; Status::ALL.len()],
    solve_secs: VecDeque<f64>,
    /// Cycles that the control loop missed.
    missed_cycles: u64,
    /// Error of the newest hand, if it was refused.
    refused: Option<String>,
    /// Reason for which the robot holds its pose, if it does.
    hold: Option<Hold>,
}

impl Statistics {
    /// Counts a hand that was followed; `solve_secs`: time of the solver, s.
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

    /// Counts a hand that could not be followed.
    pub fn refused(&self, error: &Error) {
        self.hands.dropped("refused");
        let mut counts = self.counts();
        counts.statuses[Status::Held as usize] += 1;
        counts.refused = Some(error.to_string());
    }

    /// Counts a missed cycle of the control loop.
    pub fn missed_cycle(&self) {
        self.counts().missed_cycles += 1;
    }

    /// Sets the reason for which the robot holds its pose.
    pub fn set_hold(&self, hold: Option<Hold>) {
        self.counts().hold = hold;
    }

    fn counts(&self) -> std::sync::MutexGuard<'_, FollowCounts> {
        lock(&self.counts)
    }
}

/// Starts to publish /diagnostics.
///
/// # Errors
/// If ROS refuses it.
pub fn report(runtime: &mut Runtime, inputs: Inputs, statistics: Statistics, robot: String) -> anyhow::Result<()> {
    let topics = format!("{} or {}", runtime.resolve("hand_pose"), runtime.resolve("keypoints"));
    diagnostics::publish(
        runtime,
        move || robot.clone(),
        move |runtime| {
            let (overtaken, touches) = {
                let inputs = lock(&inputs);
                (inputs.overtaken(), inputs.touches(Instant::now()))
            };
            statistics.hands.set_dropped("superseded", overtaken);
            let mut tally = statistics.hands.counts();
            let rates = tally.rates();
            let mut counts = statistics.counts();
            let (level, message) = if !runtime.parameters().get::<bool>("enabled") {
                (Level::Ok, "disabled".to_owned())
            } else if let Some(error) = &counts.refused {
                (Level::Warn, format!("holds the last pose: {error}"))
            } else if rates.received == 0.0 {
                let held = counts.hold.as_ref().filter(|hold| **hold != Hold::Disabled);
                let held = held.map(|hold| format!(": {hold}")).unwrap_or_default();
                (Level::Stale, format!("no hands on {topics}{held}"))
            } else if let Some(hold) = counts.hold.as_ref().filter(|hold| **hold != Hold::Disabled) {
                (Level::Warn, hold.to_string())
            } else {
                let follows = format!("follows {:.1} hands per second", rates.processed);
                match touches {
                    Touches::None => (Level::Ok, format!("{follows}, no touch")),
                    Touches::Matching => (Level::Ok, format!("{follows}, with touch")),
                    Touches::Apart(secs) => (
                        Level::Warn,
                        format!("{follows}; the stamps of touches are {secs:+.3} s from those of hands: not used"),
                    ),
                }
            };
            let mut values = tally.values(rates);
            values.push(("with_touch".to_owned(), counts.with_touch.to_string()));
            values.push(("late_cycles".to_owned(), counts.missed_cycles.to_string()));
            for (name, count) in STATUS_NAMES.into_iter().zip(counts.statuses) {
                values.push((format!("status_{name}"), count.to_string()));
            }
            for (name, q) in [("p50", 0.5), ("p99", 0.99), ("max", 1.0)] {
                let secs = percentile(counts.solve_secs.make_contiguous().iter().copied(), q);
                values.push((format!("solve_{name}_us"), format!("{:.0}", 1e6 * secs)));
            }
            vec![TaskReport { task: "hands".into(), level, message, values }]
        },
    )
}

/// Names of [`Status::ALL`] in diagnostics.
const STATUS_NAMES: [&str; Status::ALL.len()] = ["solved", "repaired", "limited", "capped", "held"];
