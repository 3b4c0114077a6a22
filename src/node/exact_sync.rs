//! Exact synchroniser: pairs messages of two topics by equal stamps.

use std::collections::BTreeMap;

use super::time_jump;
use crate::message::Time;

/// Pairs messages of a left and a right topic by equal stamps; keeps a bounded number of unpaired messages per topic.
///
/// Each topic delivers in the order of its stamps. Once a pair is made, older messages therefore stay unmatched. If stamps
/// jump back, time restarted, and all waiting messages stay unmatched, too.
#[derive(Debug)]
pub(crate) struct ExactSync<L, R> {
    left: Queue<L>,
    right: Queue<R>,
    capacity: usize,
    budget: Budget<L>,
}

/// Memory that waiting messages of the left topic may use.
#[derive(Debug)]
struct Budget<L> {
    bytes: usize,
    size: fn(&L) -> usize,
}

/// Messages of one topic that wait for their partner.
#[derive(Debug)]
struct Queue<T> {
    messages: BTreeMap<Time, T>,
    newest: Option<Time>,
    unmatched: u64,
}

impl<L, R> ExactSync<L, R> {
    /// Keeps at most `capacity` unpaired messages per topic.
    pub(crate) fn new(capacity: usize) -> Self {
        Self::with_budget(capacity, usize::MAX, |_| 0)
    }

    /// Keeps at most `capacity` unpaired messages per topic, and at most `bytes` of the left one, whose messages have a `size`.
    pub(crate) fn with_budget(capacity: usize, bytes: usize, size: fn(&L) -> usize) -> Self {
        Self { left: Queue::new(), right: Queue::new(), capacity, budget: Budget { bytes, size } }
    }

    /// Takes a message of the left topic; returns it with its partner if the partner came before.
    pub(crate) fn push_left(&mut self, stamp: Time, message: L) -> Option<(L, R)> {
        if time_jump::jumps_back(self.left.newest, stamp) {
            self.restart();
        }
        self.left.newest = self.left.newest.max(Some(stamp));
        let Some(partner) = self.right.take(stamp) else {
            self.left.keep(stamp, message, self.capacity);
            self.left.shrink(&self.budget);
            return None;
        };
        self.left.drop_before(stamp);
        Some((message, partner))
    }

    /// Takes a message of the right topic; returns it with its partner if the partner came before.
    pub(crate) fn push_right(&mut self, stamp: Time, message: R) -> Option<(L, R)> {
        if time_jump::jumps_back(self.right.newest, stamp) {
            self.restart();
        }
        self.right.newest = self.right.newest.max(Some(stamp));
        let Some(partner) = self.left.take(stamp) else {
            self.right.keep(stamp, message, self.capacity);
            return None;
        };
        self.right.drop_before(stamp);
        Some((partner, message))
    }

    /// Returns the numbers of unmatched messages of the left and right topic. A message that still waits counts if it is
    /// more than `timeout` seconds older than the newest message of both topics.
    pub(crate) fn unmatched(&self, timeout: f64) -> (u64, u64) {
        let newest = self.left.newest.max(self.right.newest).map_or(0.0, Time::secs);
        (self.left.unmatched_until(newest - timeout), self.right.unmatched_until(newest - timeout))
    }

    fn restart(&mut self) {
        self.left.drop_all();
        self.right.drop_all();
    }
}

impl<T> Queue<T> {
    fn new() -> Self {
        Self { messages: BTreeMap::new(), newest: None, unmatched: 0 }
    }

    fn unmatched_until(&self, secs: f64) -> u64 {
        self.unmatched + self.messages.keys().take_while(|stamp| stamp.secs() <= secs).count() as u64
    }

    fn drop_all(&mut self) {
        self.unmatched += self.messages.len() as u64;
        self.messages.clear();
        self.newest = None;
    }

    fn keep(&mut self, stamp: Time, message: T, capacity: usize) {
        // A second message with the same stamp replaces the first one, which stays unmatched.
        self.unmatched += u64::from(self.messages.insert(stamp, message).is_some());
        while self.messages.len() > capacity {
            self.messages.pop_first();
            self.unmatched += 1;
        }
    }

    fn shrink(&mut self, Budget { bytes, size }: &Budget<T>) {
        let mut total: usize = self.messages.values().map(size).sum();
        while total > *bytes
            && let Some((_, message)) = self.messages.pop_first()
        {
            total -= size(&message);
            self.unmatched += 1;
        }
    }

    fn take(&mut self, stamp: Time) -> Option<T> {
        let message = self.messages.remove(&stamp)?;
        self.drop_before(stamp);
        Some(message)
    }

    fn drop_before(&mut self, stamp: Time) {
        let later = self.messages.split_off(&stamp);
        self.unmatched += self.messages.len() as u64;
        self.messages = later;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u32) -> Time {
        Time { sec: 7, nanosec: millis * 1_000_000 }
    }

    #[test]
    fn equal_stamps_pair_in_either_order_of_arrival() {
        let mut sync = ExactSync::new(10);
        assert_eq!(sync.push_left(at(1), 'a'), None);
        assert_eq!(sync.push_right(at(1), 1), Some(('a', 1)));
        assert_eq!(sync.push_right(at(2), 2), None);
        assert_eq!(sync.push_left(at(2), 'b'), Some(('b', 2)));
        assert_eq!(sync.unmatched(1.0), (0, 0));
    }

    #[test]
    fn messages_older_than_a_pair_are_counted_and_newer_ones_wait() {
        let mut sync = ExactSync::new(10);
        for millis in [1, 2, 3, 4] {
            assert_eq!(sync.push_right(at(millis), millis), None);
        }
        assert_eq!(sync.push_left(at(3), 'c'), Some(('c', 3)));
        assert_eq!(sync.unmatched(1.0), (0, 2));
        assert_eq!(sync.push_left(at(4), 'd'), Some(('d', 4)));
        assert_eq!(sync.unmatched(1.0), (0, 2));
    }

    #[test]
    fn messages_that_wait_longer_than_the_timeout_count_as_unmatched() {
        let mut sync: ExactSync<(), u32> = ExactSync::new(10);
        for millis in [0, 100, 900] {
            sync.push_right(at(millis), millis);
        }
        assert_eq!(sync.unmatched(1.0), (0, 0));
        assert_eq!(sync.unmatched(0.85), (0, 1));
        assert_eq!(sync.unmatched(0.0), (0, 3));
    }

    #[test]
    fn pairs_are_made_after_the_clock_restarts() {
        let mut sync = ExactSync::new(3);
        for sec in 100..110 {
            sync.push_right(Time { sec, nanosec: 0 }, sec);
        }
        // Both topics restart; the right message comes first each time.
        for sec in 1..4 {
            assert_eq!(sync.push_right(Time { sec, nanosec: 0 }, sec), None);
            assert_eq!(sync.push_left(Time { sec, nanosec: 0 }, 'a'), Some(('a', sec)));
        }
        assert_eq!(sync.unmatched(0.0), (0, 10));
    }

    #[test]
    fn stamps_that_differ_by_a_nanosecond_do_not_pair() {
        let mut sync = ExactSync::new(10);
        assert_eq!(sync.push_left(Time { sec: 1, nanosec: 5 }, 'a'), None);
        assert_eq!(sync.push_right(Time { sec: 1, nanosec: 6 }, 1), None);
    }

    #[test]
    fn the_bytes_of_waiting_messages_are_bounded_and_losses_counted() {
        let mut sync: ExactSync<Vec<u8>, ()> = ExactSync::with_budget(100, 10, Vec::len);
        for millis in 0..6 {
            sync.push_left(at(millis), vec![0; 4]);
        }
        assert_eq!(sync.unmatched(1.0), (4, 0));
        assert_eq!(sync.push_right(at(3), ()), None);
        assert_eq!(sync.push_right(at(4), ()), Some((vec![0; 4], ())));
        // One message alone may be too large.
        sync.push_left(at(7), vec![0; 11]);
        assert_eq!(sync.push_right(at(7), ()), None);
    }

    #[test]
    fn the_number_of_waiting_messages_is_bounded() {
        let mut sync: ExactSync<(), u32> = ExactSync::new(3);
        for millis in 0..10 {
            sync.push_right(at(millis), millis);
        }
        assert_eq!(sync.unmatched(1.0), (0, 7));
        assert_eq!(sync.push_left(at(6), ()), None);
        assert_eq!(sync.push_left(at(7), ()), Some(((), 7)));
    }
}
