//! Clock of a node.

use std::sync::{Arc, Mutex};

use super::lock::lock;
use crate::message::Time;

/// Clock of a node: the wall clock, or `/clock` if the parameter `use_sim_time` is set. Clones share one clock.
#[derive(Clone)]
pub(crate) struct RosClock(Arc<Mutex<r2r::Clock>>);

impl RosClock {
    /// Wraps the clock of an r2r node.
    pub(crate) fn new(clock: Arc<Mutex<r2r::Clock>>) -> Self {
        Self(clock)
    }

    /// Returns the current time; zero before the first message on `/clock` if simulated time is used.
    pub(crate) fn now(&self) -> Time {
        let now = lock(&self.0).get_now();
        let nanos = now.map_or(0, |now| i64::try_from(now.as_nanos()).unwrap_or(i64::MAX));
        Time::from_nanos(nanos)
    }

    /// Returns the seconds from `stamp` to now; None if `stamp` or the current time is zero, which means "not set".
    pub(crate) fn secs_since(&self, stamp: Time) -> Option<f64> {
        let now = self.now();
        (!stamp.is_zero() && !now.is_zero()).then(|| (now.nanos() - stamp.nanos()) as f64 * 1e-9)
    }
}
