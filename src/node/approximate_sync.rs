//! Hands of one topic and touches of another, matched by near stamps.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use crate::message::Time;

/// Nanoseconds by which a stamp may lie before the newest one of its side; further back, time began anew.
const JUMP: i64 = 1_000_000_000;
/// Messages that may wait on each side.
const CAPACITY: usize = 200;
/// Silence of touches after which no hand waits for one, at least.
const SILENCE: Duration = Duration::from_secs(1);

/// Hands that wait for their touch, and touches for their hand.
///
/// A touch is computed from an image and comes later than the hand's pose, so a hand waits a while for it. What comes out
/// is in the order of the hands' stamps; hands that were overtaken are counted, not given out.
#[derive(Debug)]
pub(super) struct Matching<H, T> {
    hands: VecDeque<Waiting<H>>,
    touches: VecDeque<(Time, T)>,
    /// Most nanoseconds between the stamps of a hand and its touch.
    slop: i64,
    /// How long a hand waits for its touch.
    patience: Duration,
    newest: [Option<Time>; 2],
    taken: Option<Time>,
    /// When a touch came last.
    touched: Option<Instant>,
    began_anew: bool,
    overtaken: u64,
}

#[derive(Debug)]
struct Waiting<H> {
    stamp: Time,
    came: Instant,
    hand: H,
}

/// A hand, with its touch if there is one.
#[derive(Debug, PartialEq)]
pub(super) struct Matched<H, T> {
    pub(super) stamp: Time,
    pub(super) hand: H,
    pub(super) touch: Option<(Time, T)>,
    /// Whether stamps jumped back since the last one.
    pub(super) began_anew: bool,
}

impl<H, T> Matching<H, T> {
    /// Matches stamps at most `slop` seconds apart; a hand waits for `patience`.
    pub(super) fn new(slop: f64, patience: Duration) -> Self {
        Self {
            hands: VecDeque::new(),
            touches: VecDeque::new(),
            slop: (slop * 1e9).round() as i64,
            patience,
            newest: [None; 2],
            taken: None,
            touched: None,
            began_anew: false,
            overtaken: 0,
        }
    }

    /// A hand came.
    pub(super) fn hand(&mut self, stamp: Time, hand: H, now: Instant) {
        self.note(0, stamp);
        if self.taken.is_some_and(|taken| stamp <= taken) {
            self.overtaken += 1;
            return;
        }
        let at = self.hands.partition_point(|waiting| waiting.stamp <= stamp);
        self.hands.insert(at, Waiting { stamp, came: now, hand });
        if self.hands.len() > CAPACITY {
            self.hands.pop_front();
            self.overtaken += 1;
        }
    }

    /// A touch came.
    pub(super) fn touch(&mut self, stamp: Time, touch: T, now: Instant) {
        self.note(1, stamp);
        self.touched = Some(now);
        self.touches.push_back((stamp, touch));
        if self.touches.len() > CAPACITY {
            self.touches.pop_front();
        }
    }

    /// The newest hand whose touch is here; else the newest one that need not wait for it any longer.
    pub(super) fn take(&mut self, now: Instant) -> Option<Matched<H, T>> {
        let matched = (0..self.hands.len()).rev().find_map(|index| Some((index, Some(self.partner(index)?))));
        // Hands wait for touches that come at all.
        let silence = SILENCE.max(self.patience);
        let flows = self.touched.is_some_and(|touched| now.saturating_duration_since(touched) <= silence);
        let waited = |waiting: &Waiting<H>| now.saturating_duration_since(waiting.came) >= self.patience;
        let alone = || self.hands.iter().rposition(|waiting| !flows || waited(waiting)).map(|index| (index, None));
        let (index, partner) = matched.or_else(alone)?;
        let touch = partner.and_then(|partner| self.touches.remove(partner));
        self.overtaken += index as u64;
        let Waiting { stamp, hand, .. } = self.hands.drain(..=index).next_back()?;
        self.taken = Some(stamp);
        let oldest = stamp.nanos() - self.slop;
        self.touches.retain(|(touch, _)| touch.nanos() > oldest);
        Some(Matched { stamp, hand, touch, began_anew: std::mem::take(&mut self.began_anew) })
    }

    /// Hands that newer ones overtook so far.
    pub(super) fn overtaken(&self) -> u64 {
        self.overtaken
    }

    /// Whether touches have come of late.
    pub(super) fn touch_flows(&self, now: Instant) -> bool {
        self.touched.is_some_and(|touched| now.saturating_duration_since(touched) <= SILENCE.max(self.patience))
    }

    /// The touch whose stamp is nearest to a hand's.
    fn partner(&self, hand: usize) -> Option<usize> {
        let stamp = self.hands[hand].stamp.nanos();
        let apart = |touch: usize| (self.touches[touch].0.nanos() - stamp).abs();
        (0..self.touches.len()).filter(|touch| apart(*touch) <= self.slop).min_by_key(|touch| apart(*touch))
    }

    fn note(&mut self, side: usize, stamp: Time) {
        if self.newest[side].is_some_and(|newest| newest.nanos() - stamp.nanos() > JUMP) {
            self.overtaken += self.hands.len() as u64;
            self.hands.clear();
            self.touches.clear();
            (self.newest, self.taken, self.began_anew) = ([None; 2], None, true);
        }
        self.newest[side] = self.newest[side].max(Some(stamp));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATIENCE: Duration = Duration::from_millis(200);

    fn at(millis: u32) -> Time {
        Time { sec: 7, nanosec: millis * 1_000_000 }
    }

    /// What comes out: hand and touch.
    fn take(matching: &mut Matching<char, u32>, now: Instant) -> Option<(char, Option<u32>)> {
        matching.take(now).map(|matched| (matched.hand, matched.touch.map(|(_, touch)| touch)))
    }

    #[test]
    fn a_hand_waits_for_its_touch_and_not_for_ever() {
        let start = Instant::now();
        let mut matching = Matching::new(0.02, PATIENCE);
        matching.touch(at(0), 0, start);
        matching.hand(at(0), 'a', start);
        assert_eq!(take(&mut matching, start), Some(('a', Some(0))));
        matching.hand(at(40), 'b', start);
        assert_eq!(take(&mut matching, start), None);
        matching.touch(at(45), 1, start);
        assert_eq!(take(&mut matching, start), Some(('b', Some(1))));
        matching.hand(at(80), 'c', start);
        assert_eq!(take(&mut matching, start + PATIENCE / 2), None);
        assert_eq!(take(&mut matching, start + PATIENCE), Some(('c', None)));
    }

    #[test]
    fn without_touches_no_hand_waits() {
        let start = Instant::now();
        let mut matching: Matching<char, u32> = Matching::new(0.02, PATIENCE);
        matching.hand(at(0), 'a', start);
        assert_eq!(take(&mut matching, start), Some(('a', None)));
        matching.touch(at(0), 0, start);
        matching.hand(at(40), 'b', start + 2 * SILENCE);
        assert_eq!(take(&mut matching, start + 2 * SILENCE), Some(('b', None)));
    }

    #[test]
    fn the_nearest_touch_within_the_slop_is_taken() {
        let start = Instant::now();
        let mut matching = Matching::new(0.02, PATIENCE);
        for (millis, touch) in [(0, 0), (30, 1), (38, 2), (75, 3)] {
            matching.touch(at(millis), touch, start);
        }
        matching.hand(at(40), 'a', start);
        assert_eq!(take(&mut matching, start), Some(('a', Some(2))));
        // 21 ms off is none.
        matching.hand(at(54), 'b', start);
        assert_eq!(take(&mut matching, start), None);
    }

    #[test]
    fn the_newest_hand_with_a_touch_overtakes_the_others() {
        let start = Instant::now();
        let mut matching = Matching::new(0.01, PATIENCE);
        for (millis, hand) in [(0, 'a'), (40, 'b'), (80, 'c')] {
            matching.hand(at(millis), hand, start);
        }
        matching.touch(at(40), 1, start);
        assert_eq!(take(&mut matching, start), Some(('b', Some(1))));
        assert_eq!(matching.overtaken(), 1);
        assert_eq!(take(&mut matching, start), None);
        // One from before comes too late.
        matching.hand(at(20), 'd', start);
        assert_eq!(matching.overtaken(), 2);
        assert_eq!(take(&mut matching, start + PATIENCE), Some(('c', None)));
    }

    #[test]
    fn stamps_that_jump_back_begin_anew() {
        let start = Instant::now();
        let mut matching: Matching<char, u32> = Matching::new(0.02, PATIENCE);
        matching.hand(Time { sec: 100, nanosec: 0 }, 'a', start);
        assert!(!matching.take(start).unwrap().began_anew);
        matching.hand(at(0), 'b', start);
        let matched = matching.take(start).unwrap();
        assert_eq!((matched.hand, matched.began_anew), ('b', true));
        matching.hand(at(40), 'c', start);
        assert!(!matching.take(start).unwrap().began_anew);
    }

    #[test]
    fn what_waits_is_bounded() {
        let start = Instant::now();
        let mut matching = Matching::new(0.0, PATIENCE);
        for millis in 0..999 {
            matching.touch(at(millis), millis, start);
            matching.hand(at(millis), 'a', start);
        }
        assert_eq!((matching.hands.len(), matching.touches.len()), (CAPACITY, CAPACITY));
    }
}
