//! Approximate synchroniser: pairs hands of one topic with touches of another by near stamps.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use super::time_jump;
use crate::message::Time;

/// Most messages that wait per topic; more than three seconds of any camera.
const CAPACITY: usize = 200;
/// Shortest silence of the touch topic after which hands no longer wait for touches: a predictor that runs publishes
/// several times per second.
const MIN_TOUCH_TIMEOUT: Duration = Duration::from_secs(1);

/// Pairs hands with touches; both wait in queues of bounded length.
///
/// A touch is computed from an image and arrives later than the pose of the same hand, so a hand waits for it. Hands leave
/// in the order of their stamps; hands that a newer one overtook are counted and dropped.
#[derive(Debug)]
pub(crate) struct ApproximateSync<H, T> {
    hands: VecDeque<WaitingHand<H>>,
    touches: VecDeque<(Time, T)>,
    /// Largest difference between the stamps of a hand and its touch, nanoseconds.
    slop_nanos: i64,
    /// Longest time that a hand waits for its touch.
    max_wait: Duration,
    newest_hand: Option<Time>,
    newest_touch: Option<Time>,
    /// Stamp of the hand that left last.
    last_taken: Option<Time>,
    /// Arrival of the newest touch.
    last_touch: Option<Instant>,
    /// Stamps of the newest hands, also of those that left.
    hand_stamps: VecDeque<Time>,
    /// Time at which a hand and a touch with near stamps were last seen, in either order of arrival.
    last_match: Option<Instant>,
    restarted: bool,
    overtaken: u64,
}

#[derive(Debug)]
struct WaitingHand<H> {
    stamp: Time,
    arrived: Instant,
    hand: H,
}

/// Touches that arrive at present.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Touches {
    /// None.
    None,
    /// Touches with the stamps of hands.
    Matching,
    /// Touches whose stamps are not those of hands; seconds from the newest hand's to the newest touch's.
    Apart(f64),
}

/// A hand with its touch, if there is one.
#[derive(Debug, PartialEq)]
pub(crate) struct SyncedHand<H, T> {
    pub(crate) stamp: Time,
    /// Arrival of the hand.
    pub(crate) arrived: Instant,
    pub(crate) hand: H,
    pub(crate) touch: Option<(Time, T)>,
    /// True if stamps jumped back since the hand before.
    pub(crate) restarted: bool,
}

impl<H, T> ApproximateSync<H, T> {
    /// Pairs stamps at most `slop` seconds apart; a hand waits for its touch at most `max_wait`.
    pub(crate) fn new(slop: f64, max_wait: Duration) -> Self {
        Self {
            hands: VecDeque::new(),
            touches: VecDeque::new(),
            slop_nanos: (slop * 1e9).round() as i64,
            max_wait,
            newest_hand: None,
            newest_touch: None,
            last_taken: None,
            last_touch: None,
            hand_stamps: VecDeque::new(),
            last_match: None,
            restarted: false,
            overtaken: 0,
        }
    }

    /// Takes a hand that arrived at `now`.
    pub(crate) fn push_hand(&mut self, stamp: Time, hand: H, now: Instant) {
        if time_jump::jumps_back(self.newest_hand, stamp) {
            self.restart();
        }
        self.newest_hand = self.newest_hand.max(Some(stamp));
        if self.last_taken.is_some_and(|taken| stamp <= taken) {
            self.overtaken += 1;
            return;
        }
        self.hand_stamps.push_back(stamp);
        if self.hand_stamps.len() > CAPACITY {
            self.hand_stamps.pop_front();
        }
        if self.touches.iter().any(|(touch, _)| self.is_near(*touch, stamp)) {
            self.last_match = Some(now);
        }
        let index = self.hands.partition_point(|waiting| waiting.stamp <= stamp);
        self.hands.insert(index, WaitingHand { stamp, arrived: now, hand });
        if self.hands.len() > CAPACITY {
            self.hands.pop_front();
            self.overtaken += 1;
        }
    }

    /// Takes a touch that arrived at `now`.
    pub(crate) fn push_touch(&mut self, stamp: Time, touch: T, now: Instant) {
        if time_jump::jumps_back(self.newest_touch, stamp) {
            self.restart();
        }
        self.newest_touch = self.newest_touch.max(Some(stamp));
        self.last_touch = Some(now);
        if self.hand_stamps.iter().any(|hand| self.is_near(*hand, stamp)) {
            self.last_match = Some(now);
        }
        self.touches.push_back((stamp, touch));
        if self.touches.len() > CAPACITY {
            self.touches.pop_front();
        }
    }

    /// Returns the newest hand that has its touch, else the newest hand that need not wait any longer.
    pub(crate) fn take(&mut self, now: Instant) -> Option<SyncedHand<H, T>> {
        let (index, touch_index) = self.newest_paired().or_else(|| self.newest_unpaired(now))?;
        let touch = touch_index.and_then(|touch| self.touches.remove(touch));
        self.overtaken += index as u64;
        let WaitingHand { stamp, arrived, hand } = self.hands.drain(..=index).next_back()?;
        self.last_taken = Some(stamp);
        let oldest = stamp.nanos() - self.slop_nanos;
        self.touches.retain(|(touch, _)| touch.nanos() > oldest);
        Some(SyncedHand { stamp, arrived, hand, touch, restarted: std::mem::take(&mut self.restarted) })
    }

    /// Drops all waiting messages; returns the number of hands among them.
    pub(crate) fn clear(&mut self) -> usize {
        self.touches.clear();
        let count = self.hands.len();
        self.last_taken = self.last_taken.max(self.hands.back().map(|waiting| waiting.stamp));
        self.hands.clear();
        count
    }

    /// Number of hands that newer ones overtook so far.
    pub(crate) fn overtaken(&self) -> u64 {
        self.overtaken
    }

    /// Returns which touches arrive at present.
    pub(crate) fn touches(&self, now: Instant) -> Touches {
        let timeout = MIN_TOUCH_TIMEOUT.max(self.max_wait);
        let is_recent = |then: Option<Instant>| then.is_some_and(|then| now.saturating_duration_since(then) <= timeout);
        match (is_recent(self.last_touch), is_recent(self.last_match), self.newest_touch.zip(self.newest_hand)) {
            (true, false, Some((touch, hand))) => Touches::Apart((touch.nanos() - hand.nanos()) as f64 / 1e9),
            (true, true, _) => Touches::Matching,
            _ => Touches::None,
        }
    }

    fn is_near(&self, a: Time, b: Time) -> bool {
        (a.nanos() - b.nanos()).abs() <= self.slop_nanos
    }

    /// Returns the indices of the newest hand that has a touch, and of this touch.
    fn newest_paired(&self) -> Option<(usize, Option<usize>)> {
        (0..self.hands.len()).rev().find_map(|hand| Some((hand, Some(self.nearest_touch(hand)?))))
    }

    /// Returns the index of the newest hand that need not wait for a touch any longer.
    fn newest_unpaired(&self, now: Instant) -> Option<(usize, Option<usize>)> {
        // Waiting is in vain if the stamps never match, for instance because the clocks differ.
        let touches_match = self.touches(now) == Touches::Matching;
        let may_leave = |waiting: &WaitingHand<H>| {
            !touches_match || now.saturating_duration_since(waiting.arrived) >= self.max_wait
        };
        Some((self.hands.iter().rposition(may_leave)?, None))
    }

    /// Returns the index of the touch whose stamp is nearest to a hand's, if it lies within the slop.
    fn nearest_touch(&self, hand: usize) -> Option<usize> {
        let stamp = self.hands[hand].stamp.nanos();
        let distance = |touch: usize| (self.touches[touch].0.nanos() - stamp).abs();
        (0..self.touches.len()).filter(|touch| distance(*touch) <= self.slop_nanos).min_by_key(|touch| distance(*touch))
    }

    fn restart(&mut self) {
        self.overtaken += self.hands.len() as u64;
        self.hands.clear();
        self.touches.clear();
        self.hand_stamps.clear();
        (self.newest_hand, self.newest_touch, self.last_taken) = (None, None, None);
        self.restarted = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MAX_WAIT: Duration = Duration::from_millis(200);

    fn at(millis: u32) -> Time {
        Time { sec: 7, nanosec: millis * 1_000_000 }
    }

    /// Returns hand and touch of the next pair.
    fn take(sync: &mut ApproximateSync<char, u32>, now: Instant) -> Option<(char, Option<u32>)> {
        sync.take(now).map(|synced| (synced.hand, synced.touch.map(|(_, touch)| touch)))
    }

    #[test]
    fn a_hand_waits_for_its_touch_at_most_max_wait() {
        let start = Instant::now();
        let mut sync = ApproximateSync::new(0.02, MAX_WAIT);
        sync.push_touch(at(0), 0, start);
        sync.push_hand(at(0), 'a', start);
        assert_eq!(take(&mut sync, start), Some(('a', Some(0))));
        sync.push_hand(at(40), 'b', start);
        assert_eq!(take(&mut sync, start), None);
        sync.push_touch(at(45), 1, start);
        assert_eq!(take(&mut sync, start), Some(('b', Some(1))));
        sync.push_hand(at(80), 'c', start);
        assert_eq!(take(&mut sync, start + MAX_WAIT / 2), None);
        assert_eq!(take(&mut sync, start + MAX_WAIT), Some(('c', None)));
    }

    #[test]
    fn hands_do_not_wait_while_no_touches_arrive() {
        let start = Instant::now();
        let mut sync: ApproximateSync<char, u32> = ApproximateSync::new(0.02, MAX_WAIT);
        sync.push_hand(at(0), 'a', start);
        assert_eq!(take(&mut sync, start), Some(('a', None)));
        sync.push_touch(at(0), 0, start);
        sync.push_hand(at(40), 'b', start + 2 * MIN_TOUCH_TIMEOUT);
        assert_eq!(take(&mut sync, start + 2 * MIN_TOUCH_TIMEOUT), Some(('b', None)));
    }

    #[test]
    fn a_hand_gets_the_nearest_touch_within_the_slop() {
        let start = Instant::now();
        let mut sync = ApproximateSync::new(0.02, MAX_WAIT);
        for (millis, touch) in [(0, 0), (30, 1), (38, 2), (75, 3)] {
            sync.push_touch(at(millis), touch, start);
        }
        sync.push_hand(at(40), 'a', start);
        assert_eq!(take(&mut sync, start), Some(('a', Some(2))));
        // The nearest touch is 21 ms away.
        sync.push_hand(at(54), 'b', start);
        assert_eq!(take(&mut sync, start), None);
    }

    #[test]
    fn hands_do_not_wait_for_touches_of_another_clock() {
        let start = Instant::now();
        let mut sync = ApproximateSync::new(0.02, MAX_WAIT);
        for frame in 0..20 {
            sync.push_touch(Time { sec: 1007, nanosec: frame * 1_000_000 }, frame, start);
            sync.push_hand(at(frame), 'a', start);
            assert_eq!(take(&mut sync, start), Some(('a', None)));
        }
        assert_eq!(sync.touches(start), Touches::Apart(1000.0));
        // Once the clocks agree, hands wait.
        sync.push_touch(at(21), 21, start);
        sync.push_hand(at(21), 'b', start);
        assert_eq!(take(&mut sync, start), Some(('b', Some(21))));
        sync.push_hand(at(45), 'c', start);
        assert_eq!((take(&mut sync, start), sync.touches(start)), (None, Touches::Matching));
    }

    #[test]
    fn the_newest_hand_with_a_touch_overtakes_older_hands() {
        let start = Instant::now();
        let mut sync = ApproximateSync::new(0.01, MAX_WAIT);
        for (millis, hand) in [(0, 'a'), (40, 'b'), (80, 'c')] {
            sync.push_hand(at(millis), hand, start);
        }
        sync.push_touch(at(40), 1, start);
        assert_eq!(take(&mut sync, start), Some(('b', Some(1))));
        assert_eq!(sync.overtaken(), 1);
        assert_eq!(take(&mut sync, start), None);
        // An older hand arrives too late.
        sync.push_hand(at(20), 'd', start);
        assert_eq!(sync.overtaken(), 2);
        assert_eq!(take(&mut sync, start + MAX_WAIT), Some(('c', None)));
    }

    #[test]
    fn cleared_hands_are_not_followed_and_newer_ones_are() {
        let start = Instant::now();
        let mut sync: ApproximateSync<char, u32> = ApproximateSync::new(0.02, MAX_WAIT);
        sync.push_touch(at(0), 0, start);
        sync.push_hand(at(0), 'a', start);
        sync.push_hand(at(40), 'b', start);
        assert_eq!(sync.clear(), 2);
        assert_eq!(take(&mut sync, start + MAX_WAIT), None);
        sync.push_hand(at(80), 'c', start);
        assert_eq!(take(&mut sync, start + MAX_WAIT), Some(('c', None)));
    }

    #[test]
    fn stamps_that_jump_back_restart_the_synchroniser() {
        let start = Instant::now();
        let mut sync: ApproximateSync<char, u32> = ApproximateSync::new(0.02, MAX_WAIT);
        sync.push_hand(Time { sec: 100, nanosec: 0 }, 'a', start);
        assert!(!sync.take(start).unwrap().restarted);
        sync.push_hand(at(0), 'b', start);
        let synced = sync.take(start).unwrap();
        assert_eq!((synced.hand, synced.restarted), ('b', true));
        sync.push_hand(at(40), 'c', start);
        assert!(!sync.take(start).unwrap().restarted);
    }

    #[test]
    fn the_number_of_waiting_messages_is_bounded() {
        let start = Instant::now();
        let mut sync = ApproximateSync::new(0.0, MAX_WAIT);
        for millis in 0..999 {
            sync.push_touch(at(millis), millis, start);
            sync.push_hand(at(millis), 'a', start);
        }
        assert_eq!((sync.hands.len(), sync.touches.len()), (CAPACITY, CAPACITY));
    }
}
