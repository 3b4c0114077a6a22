//! Messages of two topics, paired by equal stamps.

use std::collections::BTreeMap;

use crate::message::Time;

/// Keeps messages that wait for their partner, a bounded number on each side.
///
/// Both sides come in the order of their stamps, so once a pair is made, whatever is older will stay alone. Stamps that
/// jump back mean that time began anew: what waits then stays alone, too.
#[derive(Debug)]
pub struct Pairing<A, B> {
    left: Waiting<A>,
    right: Waiting<B>,
    capacity: usize,
}

#[derive(Debug)]
struct Waiting<T> {
    messages: BTreeMap<Time, T>,
    newest: Option<Time>,
    unmatched: u64,
}

/// Nanoseconds by which a stamp may lie before the newest one of its side; further back is a jump.
const JUMP: i64 = 1_000_000_000;

impl<A, B> Pairing<A, B> {
    /// Keeps at most `capacity` waiting messages per side.
    pub fn new(capacity: usize) -> Self {
        let (left, right) = (Waiting::new(), Waiting::new());
        Self { left, right, capacity }
    }

    /// A message of the left side came; returns it with its partner if that is here.
    pub fn left(&mut self, stamp: Time, message: A) -> Option<(A, B)> {
        if self.left.jumps_back_to(stamp) {
            self.begin_anew();
        }
        self.left.newest = self.left.newest.max(Some(stamp));
        let Some(partner) = self.right.take(stamp) else {
            self.left.keep(stamp, message, self.capacity);
            return None;
        };
        self.left.forget_before(stamp);
        Some((message, partner))
    }

    /// A message of the right side came; returns it with its partner if that is here.
    pub fn right(&mut self, stamp: Time, message: B) -> Option<(A, B)> {
        if self.right.jumps_back_to(stamp) {
            self.begin_anew();
        }
        self.right.newest = self.right.newest.max(Some(stamp));
        let Some(partner) = self.left.take(stamp) else {
            self.right.keep(stamp, message, self.capacity);
            return None;
        };
        self.right.forget_before(stamp);
        Some((partner, message))
    }

    /// Messages of the left and right side that stayed alone, and of those that still wait the ones older than `patience`
    /// seconds before the newest message.
    pub fn unmatched(&self, patience: f64) -> (u64, u64) {
        let newest = self.left.newest.max(self.right.newest).map_or(0.0, Time::secs);
        (self.left.alone(newest - patience), self.right.alone(newest - patience))
    }

    fn begin_anew(&mut self) {
        self.left.forget_all();
        self.right.forget_all();
    }
}

impl<T> Waiting<T> {
    fn new() -> Self {
        Self { messages: BTreeMap::new(), newest: None, unmatched: 0 }
    }

    fn jumps_back_to(&self, stamp: Time) -> bool {
        self.newest.is_some_and(|newest| newest.nanos() - stamp.nanos() > JUMP)
    }

    fn alone(&self, overdue_secs: f64) -> u64 {
        self.unmatched + self.messages.keys().take_while(|stamp| stamp.secs() <= overdue_secs).count() as u64
    }

    fn forget_all(&mut self) {
        self.unmatched += self.messages.len() as u64;
        self.messages.clear();
        self.newest = None;
    }

    fn keep(&mut self, stamp: Time, message: T, capacity: usize) {
        // A second message with the same stamp displaces the first, which then stays alone.
        self.unmatched += u64::from(self.messages.insert(stamp, message).is_some());
        while self.messages.len() > capacity {
            self.messages.pop_first();
            self.unmatched += 1;
        }
    }

    fn take(&mut self, stamp: Time) -> Option<T> {
        let message = self.messages.remove(&stamp)?;
        self.forget_before(stamp);
        Some(message)
    }

    fn forget_before(&mut self, stamp: Time) {
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
    fn equal_stamps_pair_whichever_comes_first() {
        let mut pairing = Pairing::new(10);
        assert_eq!(pairing.left(at(1), 'a'), None);
        assert_eq!(pairing.right(at(1), 1), Some(('a', 1)));
        assert_eq!(pairing.right(at(2), 2), None);
        assert_eq!(pairing.left(at(2), 'b'), Some(('b', 2)));
        assert_eq!(pairing.unmatched(1.0), (0, 0));
    }

    #[test]
    fn what_a_pair_overtakes_is_counted_and_what_follows_waits() {
        let mut pairing = Pairing::new(10);
        for millis in [1, 2, 3, 4] {
            assert_eq!(pairing.right(at(millis), millis), None);
        }
        assert_eq!(pairing.left(at(3), 'c'), Some(('c', 3)));
        assert_eq!(pairing.unmatched(1.0), (0, 2));
        assert_eq!(pairing.left(at(4), 'd'), Some(('d', 4)));
        assert_eq!(pairing.unmatched(1.0), (0, 2));
    }

    #[test]
    fn what_waits_too_long_or_to_the_end_counts_as_alone() {
        let mut pairing: Pairing<(), u32> = Pairing::new(10);
        for millis in [0, 100, 900] {
            pairing.right(at(millis), millis);
        }
        assert_eq!(pairing.unmatched(1.0), (0, 0));
        assert_eq!(pairing.unmatched(0.85), (0, 1));
        assert_eq!(pairing.unmatched(0.0), (0, 3));
    }

    #[test]
    fn a_clock_that_begins_anew_pairs_again() {
        let mut pairing = Pairing::new(3);
        for sec in 100..110 {
            pairing.right(Time { sec, nanosec: 0 }, sec);
        }
        // Both sides restart; the truth comes first each time.
        for sec in 1..4 {
            assert_eq!(pairing.right(Time { sec, nanosec: 0 }, sec), None);
            assert_eq!(pairing.left(Time { sec, nanosec: 0 }, 'a'), Some(('a', sec)));
        }
        assert_eq!(pairing.unmatched(0.0), (0, 10));
    }

    #[test]
    fn a_near_stamp_is_no_partner() {
        let mut pairing = Pairing::new(10);
        assert_eq!(pairing.left(Time { sec: 1, nanosec: 5 }, 'a'), None);
        assert_eq!(pairing.right(Time { sec: 1, nanosec: 6 }, 1), None);
    }

    #[test]
    fn waiting_messages_are_bounded() {
        let mut pairing: Pairing<(), u32> = Pairing::new(3);
        for millis in 0..10 {
            pairing.right(at(millis), millis);
        }
        assert_eq!(pairing.unmatched(1.0), (0, 7));
        assert_eq!(pairing.left(at(6), ()), None);
        assert_eq!(pairing.left(at(7), ()), Some(((), 7)));
    }
}
