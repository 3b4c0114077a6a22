//! A mailbox of one: the newest message wins, and what it displaced is counted.

use std::sync::{Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Hands the newest value from the thread that receives to the thread that computes.
#[derive(Debug)]
pub struct Mailbox<T> {
    state: Mutex<State<T>>,
    arrived: Condvar,
}

#[derive(Debug)]
struct State<T> {
    value: Option<T>,
    superseded: u64,
}

impl<T> Default for Mailbox<T> {
    fn default() -> Self {
        Self { state: Mutex::new(State { value: None, superseded: 0 }), arrived: Condvar::new() }
    }
}

impl<T> Mailbox<T> {
    /// Puts a value in; one that nobody took yet is displaced and counted.
    pub fn put(&self, value: T) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if state.value.replace(value).is_some() {
            state.superseded += 1;
        }
        self.arrived.notify_one();
    }

    /// Takes the newest value, waiting up to `patience` for one.
    pub fn take(&self, patience: Duration) -> Option<T> {
        let deadline = Instant::now() + patience;
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            if let Some(value) = state.value.take() {
                return Some(value);
            }
            let left = deadline.checked_duration_since(Instant::now())?;
            state = self.arrived.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// How many values were displaced by newer ones so far.
    pub fn superseded(&self) -> u64 {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).superseded
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_value_wins_and_the_rest_is_counted() {
        let mailbox = Mailbox::default();
        (0..5).for_each(|value| mailbox.put(value));
        assert_eq!(mailbox.take(Duration::ZERO), Some(4));
        assert_eq!(mailbox.take(Duration::ZERO), None);
        assert_eq!(mailbox.superseded(), 4);
    }

    #[test]
    fn a_value_wakes_the_thread_that_waits() {
        let mailbox = Mailbox::default();
        let taken = std::thread::scope(|scope| {
            let waiting = scope.spawn(|| mailbox.take(Duration::from_secs(60)));
            mailbox.put("here");
            waiting.join()
        });
        assert_eq!(taken.unwrap(), Some("here"));
    }
}
