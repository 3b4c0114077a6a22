//! Reasons for which the robot holds its pose.

use std::fmt;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use crate::node::lock::lock;

/// Reason for which the robot brakes and holds its pose.
#[derive(Debug, Clone, PartialEq)]
pub enum Hold {
    /// The parameter `enabled` is false.
    Disabled,
    /// The deadman switch is not held.
    Deadman,
    /// No hand came for this time, s.
    NoInput(f64),
    /// The measured positions of these joints are missing.
    NoMeasurement(Vec<String>),
}

impl Hold {
    /// Name of the count of hands that were dropped for this reason.
    pub fn counter(&self) -> &'static str {
        match self {
            Self::Disabled => "disabled",
            Self::Deadman => "deadman",
            Self::NoInput(_) => "late",
            Self::NoMeasurement(_) => "unmeasured",
        }
    }
}

impl fmt::Display for Hold {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Disabled => write!(f, "disabled"),
            Self::Deadman => write!(f, "holds the pose: the deadman switch is not held"),
            Self::NoInput(secs) => write!(f, "holds the pose: no hand for {secs:.1} s"),
            Self::NoMeasurement(joints) => write!(
                f,
                "waits for the measured position of {} on joint_states; with start:=rest the robot has to be in its rest pose",
                joints.join(", ")
            ),
        }
    }
}

/// Deadman switch: counts as held while true arrives often enough.
#[derive(Debug, Default)]
pub struct Deadman(Mutex<Option<Instant>>);

impl Deadman {
    /// Takes a message that arrived at `now`.
    pub fn update(&self, is_held: bool, now: Instant) {
        *lock(&self.0) = is_held.then_some(now);
    }

    /// Returns true if the last message said true and came within `timeout`.
    pub fn is_held(&self, timeout: Duration, now: Instant) -> bool {
        lock(&self.0).is_some_and(|arrived| now.saturating_duration_since(arrived) <= timeout)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_deadman_switch_is_held_only_while_true_keeps_arriving() {
        let (deadman, timeout, start) = (Deadman::default(), Duration::from_millis(250), Instant::now());
        assert!(!deadman.is_held(timeout, start));
        deadman.update(true, start);
        assert!(deadman.is_held(timeout, start + timeout));
        assert!(!deadman.is_held(timeout, start + timeout + Duration::from_millis(1)));
        deadman.update(true, start + timeout);
        deadman.update(false, start + timeout);
        assert!(!deadman.is_held(timeout, start + timeout));
    }
}
