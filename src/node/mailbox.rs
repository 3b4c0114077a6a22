//! Mailbox of several sources that holds only the newest value of each and counts the values it displaced.

use std::sync::PoisonError;
use std::time::Duration;

use super::lock::{Condvar, Instant, Mutex, lock};

/// Passes the newest value of each source from the receiving thread to the computing thread.
#[derive(Debug)]
pub(crate) struct Mailbox<T> {
    slots: Mutex<Vec<Slot<T>>>,
    arrived: Condvar,
}

/// Place of one source.
#[derive(Debug)]
struct Slot<T> {
    value: Option<T>,
    superseded: u64,
}

impl<T> Mailbox<T> {
    /// Creates a mailbox for `sources` sources, numbered from 0.
    pub(crate) fn new(sources: usize) -> Self {
        let slots = (0..sources).map(|_| Slot { value: None, superseded: 0 }).collect();
        Self { slots: Mutex::new(slots), arrived: Condvar::new() }
    }

    /// Stores a value of a source; displaces and counts a value of this source that was not taken yet.
    pub(crate) fn put(&self, source: usize, value: T) {
        let mut slots = lock(&self.slots);
        let Some(slot) = slots.get_mut(source) else { return };
        if slot.value.replace(value).is_some() {
            slot.superseded += 1;
        }
        self.arrived.notify_one();
    }

    /// Takes the newest value of each source that has one, with the source; waits for one at most `timeout`.
    pub(crate) fn take(&self, timeout: Duration) -> Vec<(usize, T)> {
        let deadline = Instant::now() + timeout;
        let mut slots = lock(&self.slots);
        loop {
            let taken = slots.iter_mut().enumerate().filter_map(|(source, slot)| Some((source, slot.value.take()?)));
            let taken: Vec<_> = taken.collect();
            if !taken.is_empty() {
                return taken;
            }
            let Some(left) = deadline.checked_duration_since(Instant::now()) else { return Vec::new() };
            slots = self.arrived.wait_timeout(slots, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Returns the number of values of a source that were displaced so far.
    pub(crate) fn superseded(&self, source: usize) -> u64 {
        lock(&self.slots).get(source).map_or(0, |slot| slot.superseded)
    }
}
