//! Onset and offset times of touches, labelled against true.
//!
//! A touch is a run of frames in which some vertex of a group is labelled; pauses of up to [`MAX_PAUSE`] do not end it. A
//! true touch is compared with the labelled touch that overlaps it longest: the errors are the differences between the times
//! of their first frames (onset) and of their last frames (offset). A touch that is under way at the start or end of the
//! episode, or beside a refused frame, has no known onset or offset there.

/// Longest pause within one touch, s: at 25 Hz, one missing frame does not end a touch, two do.
pub const MAX_PAUSE: f64 = 0.1;

/// Sums over touches.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Timing {
    /// True touches.
    pub touches: u64,
    /// True touches that no labelled touch overlaps.
    pub missed: u64,
    /// Labelled touches.
    pub labelled: u64,
    /// Labelled touches that overlap no true one.
    pub invented: u64,
    /// Differences of the onsets.
    pub onset: Differences,
    /// Differences of the offsets.
    pub offset: Differences,
}

/// Sums of the differences between labelled and true times.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Differences {
    /// Number of pairs.
    pub count: u64,
    /// Sum of the differences, s; positive = the label is late.
    pub sum: f64,
    /// Sum of the absolute differences, s.
    pub absolute: f64,
}

impl Differences {
    fn push(&mut self, difference: f64) {
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

/// One group in one frame: time (s), touched in truth, labelled.
pub type TouchSample = (f64, bool, bool);

/// Compares the touches of one group over consecutive frames, oldest first.
pub fn compare(samples: &[TouchSample]) -> Timing {
    let truth = touches(samples.iter().map(|(time, truth, _)| (*time, *truth)));
    let label = touches(samples.iter().map(|(time, _, label)| (*time, *label)));
    let overlap = |a: &Touch, b: &Touch| a.last.min(b.last) - a.first.max(b.first);
    let mut timing = Timing { touches: truth.len() as u64, labelled: label.len() as u64, ..Timing::default() };
    for touch in &truth {
        let best = label.iter().max_by(|a, b| overlap(touch, a).total_cmp(&overlap(touch, b)));
        let Some(best) = best.filter(|best| overlap(touch, best) >= 0.0) else {
            timing.missed += 1;
            continue;
        };
        if touch.has_onset && best.has_onset {
            timing.onset.push(best.first - touch.first);
        }
        if touch.has_offset && best.has_offset {
            timing.offset.push(best.last - touch.last);
        }
    }
    timing.invented = label.iter().filter(|label| truth.iter().all(|t| overlap(t, label) < 0.0)).count() as u64;
    timing
}

struct Touch {
    first: f64,
    last: f64,
    /// True if the frame before the touch is known.
    has_onset: bool,
    /// True if the frame after the touch is known.
    has_offset: bool,
}

fn touches(frames: impl Iterator<Item = (f64, bool)>) -> Vec<Touch> {
    let mut touches: Vec<Touch> = Vec::new();
    for (index, (time, touched)) in frames.enumerate() {
        match touches.last_mut() {
            // A little more than the pause, for stamps that are no round numbers.
            Some(touch) if touched && time - touch.last <= MAX_PAUSE + 1e-6 => {
                (touch.last, touch.has_offset) = (time, false)
            }
            _ if touched => touches.push(Touch { first: time, last: time, has_onset: index > 0, has_offset: false }),
            Some(touch) => touch.has_offset = true,
            None => {}
        }
    }
    touches
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(truth: &str, label: &str) -> Vec<TouchSample> {
        let marks = truth.chars().zip(label.chars()).enumerate();
        marks.map(|(i, (t, l))| (0.04 * i as f64, t == '#', l == '#')).collect()
    }

    #[test]
    fn a_late_label_gives_a_positive_difference() {
        let timing = compare(&frames("..######..", "....#####."));
        assert_eq!((timing.touches, timing.missed, timing.labelled, timing.invented), (1, 0, 1, 0));
        assert!((timing.onset.sum - 0.08).abs() < 1e-12 && (timing.offset.sum - 0.04).abs() < 1e-12, "{timing:?}");
        let early = compare(&frames("....#####.", "..######.."));
        assert!((early.onset.sum + 0.08).abs() < 1e-12 && (early.onset.absolute - 0.08).abs() < 1e-12);
    }

    #[test]
    fn a_touch_cut_off_by_the_edge_has_no_onset_or_offset() {
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
