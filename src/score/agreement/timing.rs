//! When touches begin and end, by one label and by another.
//!
//! A touch is a stretch of frames in which some vertex of a part of the hand is labelled; pauses of up to [`PAUSE`] do
//! not end it. A true touch is compared with the labelled one that overlaps it longest: the errors are the differences
//! of their first and of their last frames' times. A touch that is under way where the episode starts or ends, or next
//! to a refused frame, has no known beginning or end there.

/// Longest pause within one touch, s.
pub const PAUSE: f64 = 0.1;

/// Sums over touches.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Timing {
    /// True touches.
    pub touches: u64,
    /// Those without any label.
    pub missed: u64,
    /// Labelled touches.
    pub labelled: u64,
    /// Those that overlap no true one.
    pub invented: u64,
    /// Beginnings compared.
    pub onset: Differences,
    /// Ends compared.
    pub offset: Differences,
}

/// Sums of labelled minus true times.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Differences {
    /// Number of pairs.
    pub count: u64,
    /// Sum of the differences, s; positive = the label is late.
    pub sum: f64,
    /// Sum of their absolute values, s.
    pub absolute: f64,
}

impl Differences {
    fn take(&mut self, difference: f64) {
        self.count += 1;
        self.sum += difference;
        self.absolute += difference.abs();
    }

    fn add(&mut self, other: &Self) {
        self.count += other.count;
        self.sum += other.sum;
        self.absolute += other.absolute;
    }
}

impl Timing {
    /// Adds the sums of other touches.
    pub fn add(&mut self, other: &Self) {
        self.touches += other.touches;
        self.missed += other.missed;
        self.labelled += other.labelled;
        self.invented += other.invented;
        self.onset.add(&other.onset);
        self.offset.add(&other.offset);
    }
}

/// One instant of a part: when, whether it is truly touched, whether it is labelled.
pub type Instant = (f64, bool, bool);

/// Compares the touches of one part over one stretch of frames without a gap, oldest first.
pub fn compare(stretch: &[Instant]) -> Timing {
    let truth = touches(stretch.iter().map(|(time, truth, _)| (*time, *truth)));
    let label = touches(stretch.iter().map(|(time, _, label)| (*time, *label)));
    let overlap = |a: &Touch, b: &Touch| a.last.min(b.last) - a.first.max(b.first);
    let mut timing = Timing { touches: truth.len() as u64, labelled: label.len() as u64, ..Timing::default() };
    for touch in &truth {
        let best = label.iter().max_by(|a, b| overlap(touch, a).total_cmp(&overlap(touch, b)));
        let Some(best) = best.filter(|best| overlap(touch, best) >= 0.0) else {
            timing.missed += 1;
            continue;
        };
        if touch.begins && best.begins {
            timing.onset.take(best.first - touch.first);
        }
        if touch.ends && best.ends {
            timing.offset.take(best.last - touch.last);
        }
    }
    timing.invented = label.iter().filter(|label| truth.iter().all(|t| overlap(t, label) < 0.0)).count() as u64;
    timing
}

struct Touch {
    first: f64,
    last: f64,
    /// Whether the frame before its first is known.
    begins: bool,
    /// Whether the frame after its last is known.
    ends: bool,
}

fn touches(frames: impl Iterator<Item = (f64, bool)>) -> Vec<Touch> {
    let mut touches: Vec<Touch> = Vec::new();
    for (index, (time, touched)) in frames.enumerate() {
        match touches.last_mut() {
            // A little more than the pause, for stamps that are no round numbers.
            Some(touch) if touched && time - touch.last <= PAUSE + 1e-6 => (touch.last, touch.ends) = (time, false),
            _ if touched => touches.push(Touch { first: time, last: time, begins: index > 0, ends: false }),
            Some(touch) => touch.ends = true,
            None => {}
        }
    }
    touches
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(truth: &str, label: &str) -> Vec<Instant> {
        let marks = truth.chars().zip(label.chars()).enumerate();
        marks.map(|(i, (t, l))| (0.04 * i as f64, t == '#', l == '#')).collect()
    }

    #[test]
    fn a_late_label_is_late_by_its_frames() {
        let timing = compare(&frames("..######..", "....#####."));
        assert_eq!((timing.touches, timing.missed, timing.labelled, timing.invented), (1, 0, 1, 0));
        assert!((timing.onset.sum - 0.08).abs() < 1e-12 && (timing.offset.sum - 0.04).abs() < 1e-12, "{timing:?}");
        let early = compare(&frames("....#####.", "..######.."));
        assert!((early.onset.sum + 0.08).abs() < 1e-12 && (early.onset.absolute - 0.08).abs() < 1e-12);
    }

    #[test]
    fn a_touch_under_way_at_the_edge_has_no_beginning_or_end() {
        let timing = compare(&frames("####", "..##"));
        assert_eq!((timing.touches, timing.onset.count, timing.offset.count), (1, 0, 0));
        let timing = compare(&frames("###.", "#..."));
        assert_eq!((timing.onset.count, timing.offset.count), (0, 1));
        assert!((timing.offset.sum + 0.08).abs() < 1e-12);
    }

    #[test]
    fn a_short_pause_does_not_end_a_touch() {
        // From frame to frame 0.08 s and 0.12 s.
        assert_eq!(compare(&frames(".##.##..", "........")).touches, 1);
        assert_eq!(compare(&frames(".##..##.", "........")).touches, 2);
    }

    #[test]
    fn missed_and_invented_touches_are_counted() {
        let timing = compare(&frames(".##......##.", ".....#......"));
        assert_eq!((timing.touches, timing.missed, timing.labelled, timing.invented), (2, 2, 1, 1));
        let longest = compare(&frames("...########..", ".##....####.."));
        assert_eq!((longest.missed, longest.invented), (0, 1));
        assert!((longest.onset.sum - 0.16).abs() < 1e-12 && longest.offset.sum == 0.0, "{longest:?}");
    }
}
