//! Mailbox that holds only the newest value and counts the values it displaced.

use std::sync::PoisonError;
use std::time::Duration;

use super::lock::{Condvar, Instant, Mutex, lock};

/// Passes the newest value from the receiving thread to the computing thread.
#[derive(Debug)]
pub(crate) struct Mailbox<T> {
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
    /// Stores a value; displaces and counts a value that was not taken yet.
    pub(crate) fn put(&self, value: T) {
        let mut state = lock(&self.state);
        if state.value.replace(value).is_some() {
            state.superseded += 1;
        }
        self.arrived.notify_one();
    }

    /// Takes the newest value; waits for one at most `timeout`.
    pub(crate) fn take(&self, timeout: Duration) -> Option<T> {
        let deadline = Instant::now() + timeout;
        let mut state = lock(&self.state);
        loop {
            if let Some(value) = state.value.take() {
                return Some(value);
            }
            let left = deadline.checked_duration_since(Instant::now())?;
            state = self.arrived.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Returns the number of values displaced so far.
    pub(crate) fn superseded(&self) -> u64 {
        lock(&self.state).superseded
    }
}
