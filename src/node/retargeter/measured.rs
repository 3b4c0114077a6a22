//! Measured joint positions of the robot, from which it starts.

use std::collections::HashMap;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use crate::message::JointState;
use crate::node::lock::lock;

/// Age above which a measured position counts as unknown; drivers of robots publish at 10 Hz or more.
const MAX_AGE: Duration = Duration::from_secs(1);

/// Newest measured position of each joint, rad or m, with its arrival. Several drivers may each publish a part of the joints.
#[derive(Default)]
pub struct MeasuredJoints(Mutex<HashMap<String, (f64, Instant)>>);

impl MeasuredJoints {
    /// Takes the positions of a message that arrived at `now`, except for those that are not finite.
    pub fn update(&self, message: &JointState, wanted: &[String], now: Instant) {
        let mut newest = lock(&self.0);
        for (name, position) in message.name.iter().zip(&message.position) {
            if position.is_finite() && wanted.contains(name) {
                newest.insert(name.clone(), (*position, now));
            }
        }
    }

    /// Returns the position of each of `names`; None for one that is unknown or too old.
    pub fn positions(&self, names: &[String], now: Instant) -> Vec<Option<f64>> {
        let newest = lock(&self.0);
        let known = |name: &String| {
            let (position, arrived) = newest.get(name)?;
            (now.saturating_duration_since(*arrived) <= MAX_AGE).then_some(*position)
        };
        names.iter().map(known).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::Header;

    #[test]
    fn positions_of_several_drivers_are_joined_and_expire() {
        let names: Vec<String> = ["a", "b"].map(String::from).into();
        let measured = MeasuredJoints::default();
        let message = |name: &str, position: f64| JointState {
            header: Header::default(),
            name: vec!["arm".into(), name.into()],
            position: vec![7.0, position],
            velocity: Vec::new(),
            effort: Vec::new(),
        };
        let start = Instant::now();
        measured.update(&message("a", 0.25), &names, start);
        assert_eq!(measured.positions(&names, start), [Some(0.25), None]);
        measured.update(&message("b", f64::NAN), &names, start);
        assert_eq!(measured.positions(&names, start), [Some(0.25), None]);
        measured.update(&message("b", -0.5), &names, start + MAX_AGE);
        assert_eq!(measured.positions(&names, start + MAX_AGE), [Some(0.25), Some(-0.5)]);
        assert_eq!(measured.positions(&names, start + 2 * MAX_AGE), [None, Some(-0.5)]);
        assert!(!lock(&measured.0).contains_key("arm"));
    }
}
