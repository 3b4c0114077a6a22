//! The observation window: which frames stand for the observation steps before an instant.
//!
//! Step i of a window at time t is the frame whose stamp is nearest to t - i · `frame_dt`; of two frames that are equally
//! near, the older. Step 0 is always the newest frame. Stream ([`super::Predictor`]) and batch (training, evaluation) use
//! these functions, so that both give the network the same frames for the same stamps.

/// Difference of two distances, in seconds, below which they count as equal. A camera at 25 Hz has two frames at 0.02 s
/// from t - 0.1 s, whose computed distances differ by rounding, some 1e-15 s; real distances differ by microseconds.
const TIE_SECS: f64 = 1e-9;
/// Rounding of a distance, relative to the stamp: three roundings of stamps and one of the wanted time, of half a unit of
/// the last place each. It exceeds [`TIE_SECS`] where stamps count from 1970: they are multiples of 2.4e-7 s.
const ROUNDING: f64 = 4.0 * f64::EPSILON;

/// Returns the places in `stamps` of a window's frames, oldest first. The last stamp is the newest frame of the window.
///
/// `stamps`: seconds, increasing. Where they do not reach back far enough, the first frame is repeated.
pub fn window(stamps: &[f64], horizon: usize, frame_dt: f64) -> Vec<usize> {
    let Some(newest) = stamps.last() else { return Vec::new() };
    let place = |i: usize| match i {
        0 => stamps.len() - 1,
        _ => nearest(stamps, newest - i as f64 * frame_dt),
    };
    (0..horizon).rev().map(place).collect()
}

/// Returns the places in `stamps` of the frames at t + k · `frame_dt`, k = 0 .. `predict` - 1, where t is the first stamp;
/// `None` where no frame is within half a step.
///
/// `stamps`: seconds, increasing.
pub fn targets(stamps: &[f64], predict: usize, frame_dt: f64) -> Vec<Option<usize>> {
    let Some(first) = stamps.first() else { return vec![None; predict] };
    let place = |k: usize| {
        let wanted = first + k as f64 * frame_dt;
        let at = if k == 0 { 0 } else { nearest(stamps, wanted) };
        ((stamps[at] - wanted).abs() <= 0.5 * frame_dt + tie_secs(wanted)).then_some(at)
    };
    (0..predict).map(place).collect()
}

/// True if the oldest frame of the window stands in for earlier frames: it is over half a step younger than the time that
/// the oldest step asks for.
pub fn is_warming_up(stamps: &[f64], horizon: usize, frame_dt: f64) -> bool {
    let (Some(oldest), Some(newest)) = (stamps.first(), stamps.last()) else { return true };
    *oldest > oldest_wanted(*newest, horizon, frame_dt) + 0.5 * frame_dt
}

/// Returns the number of frames at the start of `stamps` that no window at the last stamp or later can contain.
///
/// Let s be the last stamp at or before the time of the oldest step. A frame over the tie tolerance older than s is
/// farther than s from every time that a later window asks for, and no tie makes it equal; all others may be needed.
pub fn obsolete(stamps: &[f64], horizon: usize, frame_dt: f64) -> usize {
    let Some(newest) = stamps.last() else { return 0 };
    let wanted = oldest_wanted(*newest, horizon, frame_dt);
    let reached = stamps.partition_point(|stamp| *stamp <= wanted);
    let Some(last) = reached.checked_sub(1).map(|at| stamps[at]) else { return 0 };
    // Twice the tolerance leaves room for the rounding of the distances themselves.
    stamps.partition_point(|stamp| *stamp < last - 2.0 * tie_secs(*newest))
}

/// Time that the oldest step of a window asks for.
fn oldest_wanted(newest: f64, horizon: usize, frame_dt: f64) -> f64 {
    newest - horizon.saturating_sub(1) as f64 * frame_dt
}

/// Returns the place of the stamp nearest to `wanted`; of equally near ones, the oldest. `stamps` is not empty.
fn nearest(stamps: &[f64], wanted: f64) -> usize {
    let distance = |at: usize| (stamps[at] - wanted).abs();
    let after = stamps.partition_point(|stamp| *stamp < wanted).min(stamps.len() - 1);
    let before = after.saturating_sub(1);
    let farthest = distance(before).min(distance(after)) + tie_secs(wanted);
    let mut at = if distance(before) <= farthest { before } else { after };
    while at > 0 && distance(at - 1) <= farthest {
        at -= 1;
    }
    at
}

/// Difference below which two distances from a time near `stamp` count as equal.
fn tie_secs(stamp: f64) -> f64 {
    TIE_SECS.max(ROUNDING * stamp.abs())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Stamps of a regular camera from `start` on.
    fn regular(start: f64, rate: f64, frames: usize) -> Vec<f64> {
        (0..frames).map(|i| start + i as f64 / rate).collect()
    }

    #[test]
    fn a_window_has_the_nearest_frames_and_repeats_the_first() {
        let stamps = regular(3.0, 25.0, 11);
        assert_eq!(window(&stamps, 3, 0.12), [4, 7, 10]);
        assert_eq!(window(&stamps[8..], 3, 0.12), [0, 0, 2]);
        assert_eq!(window(&stamps[..1], 4, 0.12), [0, 0, 0, 0]);
        assert_eq!(window(&[0.0, 0.04, 0.2, 0.24, 0.28], 3, 0.12), [1, 2, 4], "two frames were dropped");
        assert_eq!(window(&[], 3, 0.12), [0; 0]);
    }

    #[test]
    fn of_two_equally_near_frames_the_older_is_taken_wherever_the_clock_starts() {
        // At 25 Hz, 0.1 s and 0.3 s before a frame lie midway between two frames.
        for start in [0.0, 0.04, 17.3, 86_400.0, 1.7e9, 1.7e9 + 0.123_456_7] {
            let stamps = regular(start, 25.0, 350);
            for newest in 8..350 {
                let expected = [newest - 8, newest - 5, newest - 3, newest];
                assert_eq!(window(&stamps[..=newest], 4, 0.1), expected, "start {start} s, frame {newest}");
            }
        }
    }

    #[test]
    fn targets_lie_ahead_and_end_with_the_episode() {
        let stamps = regular(0.4, 25.0, 10);
        assert_eq!(targets(&stamps, 3, 0.12), [Some(0), Some(3), Some(6)]);
        assert_eq!(targets(&stamps[..4], 3, 0.12), [Some(0), Some(3), None]);
        assert_eq!(targets(&stamps, 3, 0.1), [Some(0), Some(2), Some(5)], "0.1 s lies midway between two frames");
    }

    #[test]
    fn a_stream_warms_up_until_it_reaches_the_oldest_step() {
        let stamps = regular(0.0, 25.0, 20);
        let warm: Vec<bool> = (1..=20).map(|count| is_warming_up(&stamps[..count], 3, 0.12)).collect();
        assert_eq!(warm.iter().filter(|warming_up| **warming_up).count(), 5, "0.24 s less half a step of 0.06 s");
        assert!(warm.is_sorted_by(|a, b| a >= b));
        assert!(!is_warming_up(&stamps[..1], 1, 0.12));
    }

    proptest! {
        /// Intervals from exact ties and near-duplicates up to gaps of several windows.
        #[test]
        fn a_stream_that_drops_obsolete_frames_has_the_windows_of_all_frames(
            steps in prop::collection::vec(
                prop_oneof![
                    4 => prop::sample::select(vec![0.02, 0.04, 0.05, 1.0 / 30.0, 1.0 / 60.0]),
                    1 => prop::sample::select(vec![4e-10, 1e-9, 2e-9, 3e-9, 1e-6]),
                    1 => 1e-3..0.7f64,
                ],
                1..120,
            ),
            start in prop::sample::select(vec![0.0, 12.5, 1.7e9]),
            (horizon, frame_dt) in (1usize..6, prop::sample::select(vec![0.04, 0.1, 0.12])),
        ) {
            let mut all = vec![start];
            for step in steps {
                let next = all[all.len() - 1] + step;
                // Near 1.7e9 s the smallest steps vanish.
                if next > all[all.len() - 1] {
                    all.push(next);
                }
            }
            let mut kept = Vec::new();
            for newest in 0..all.len() {
                kept.push(all[newest]);
                kept.drain(..obsolete(&kept, horizon, frame_dt));
                let stamps = |of: &[f64]| -> Vec<f64> { window(of, horizon, frame_dt).iter().map(|at| of[*at]).collect() };
                prop_assert_eq!(stamps(&kept), stamps(&all[..=newest]));
            }
            let wanted = oldest_wanted(all[all.len() - 1], horizon, frame_dt);
            if let Some(reached) = all.iter().rfind(|stamp| **stamp <= wanted) {
                prop_assert!(kept[0] > reached - 1e-5, "obsolete frames are kept: {:?}", kept);
            }
        }
    }
}
