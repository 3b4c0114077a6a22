//! Baselines that see no image: constant predictions, and the truth of a moment ago.
//!
//! A network that beats the constants uses the image. Persistence reads the truth, so no network competes with it: it says how
//! much of a score follows from touch that changes slowly.

use crate::tactile::{N_FIELD, TactileSequence};

/// A prediction that is the same in every frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Constant {
    /// Name, e.g. `mean`.
    pub name: &'static str,
    /// (1556) force, N.
    pub force: Vec<f32>,
    /// (1556) contact probability.
    pub contact: Vec<f32>,
}

impl Constant {
    /// Returns the prediction for `n_frames` frames.
    pub fn sequence(&self, n_frames: usize) -> TactileSequence {
        let (force, contact) = (self.force.repeat(n_frames), self.contact.repeat(n_frames));
        TactileSequence { force, contact, ..Default::default() }
    }
}

/// Returns the prediction of no touch at all.
pub fn zero() -> Constant {
    Constant { name: "zero", force: vec![0.0; N_FIELD], contact: vec![0.0; N_FIELD] }
}

/// Returns zero, and the mean and the median of each vertex over its supervised frames (0 where there is none).
pub fn constants(train: &TactileSequence) -> [Constant; 3] {
    let column = |values: &[f32], mask: &[u8], vertex: usize| -> Vec<f32> {
        let entries = values.iter().enumerate().skip(vertex).step_by(N_FIELD);
        entries.filter(|(entry, _)| mask.get(*entry).is_none_or(|mask| *mask == 1)).map(|(_, value)| *value).collect()
    };
    let (mask_force, mask_contact) = (train.counted_force(), train.counted_contact());
    let each = |statistic: fn(Vec<f32>) -> f32| {
        let of = |values: &[f32], mask: &[u8]| (0..N_FIELD).map(|v| statistic(column(values, mask, v))).collect();
        (of(&train.force, &mask_force), of(&train.contact, &mask_contact))
    };
    let [mean, median] = [each(mean), each(median)];
    [
        zero(),
        Constant { name: "mean", force: mean.0, contact: mean.1 },
        Constant { name: "median", force: median.0, contact: median.1 },
    ]
}

/// Returns the truth of `lag` seconds before each frame: that of the newest frame of the episode, at least `lag` old, whose
/// label counts; zero where there is none. Without time stamps or a lag, of the frame before.
pub fn persistence(truth: &TactileSequence, lag: Option<f64>) -> TactileSequence {
    let n = truth.force.len();
    let mut held = TactileSequence { force: vec![0.0; n], contact: vec![0.0; n], ..Default::default() };
    let masks = [truth.counted_force(), truth.counted_contact()];
    let sides = [(&truth.force, &mut held.force), (&truth.contact, &mut held.contact)];
    for ((values, held), mask) in sides.into_iter().zip(masks) {
        for episode in truth.episodes() {
            let (mut last, mut next) = (vec![0.0; N_FIELD], episode.start);
            for frame in episode {
                // Stamps are rounded: a frame is as old as the lag within a microsecond.
                let is_old = |at: usize| match (lag, truth.timestamps.is_empty()) {
                    (Some(lag), false) => truth.timestamps[frame] - truth.timestamps[at] >= lag - 1e-6,
                    _ => true,
                };
                while next < frame && is_old(next) {
                    for (vertex, last) in last.iter_mut().enumerate() {
                        let entry = next * N_FIELD + vertex;
                        if mask.get(entry).is_none_or(|mask| *mask != 0) && !values[entry].is_nan() {
                            *last = values[entry];
                        }
                    }
                    next += 1;
                }
                held[frame * N_FIELD..(frame + 1) * N_FIELD].copy_from_slice(&last);
            }
        }
    }
    held
}

/// Returns the mean; 0 without values.
fn mean(values: Vec<f32>) -> f32 {
    match values.len() {
        0 => 0.0,
        n => (values.iter().map(|x| f64::from(*x)).sum::<f64>() / n as f64) as f32,
    }
}

/// Returns the median: the middle value, or the mean of the middle two; 0 without values.
fn median(mut values: Vec<f32>) -> f32 {
    values.sort_unstable_by(f32::total_cmp);
    match values.len() {
        0 => 0.0,
        n if n % 2 == 1 => values[n / 2],
        n => 0.5 * (values[n / 2 - 1] + values[n / 2]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_are_per_vertex_over_supervised_frames() {
        let mut train = TactileSequence::from_force(None, vec![0.0; 4 * N_FIELD]);
        train.mask_force = vec![1; 4 * N_FIELD];
        for (frame, force) in [1.0, 2.0, 9.0, 100.0].into_iter().enumerate() {
            train.force[frame * N_FIELD + 5] = force;
            train.contact[frame * N_FIELD + 5] = 1.0;
        }
        train.mask_force[3 * N_FIELD + 5] = 0;
        let [zero, mean, median] = constants(&train);
        assert_eq!((zero.force[5], mean.force[5], median.force[5]), (0.0, 4.0, 2.0));
        assert_eq!((zero.contact[5], mean.contact[5], median.contact[5]), (0.0, 1.0, 1.0));
        assert_eq!((mean.force[6], median.force[6]), (0.0, 0.0));
        assert_eq!(mean.sequence(3).force[2 * N_FIELD + 5], 4.0);
    }

    #[test]
    fn persistence_repeats_the_last_counted_truth_of_the_episode() {
        let mut truth = TactileSequence::from_force(None, vec![0.0; 7 * N_FIELD]);
        (0..7).for_each(|frame| truth.force[frame * N_FIELD + 9] = 1.0 + frame as f32);
        truth.episode_ends = vec![5, 7];
        truth.validity = vec![0, 0, 1, 0, 0, 0, 0];
        let at = |held: &TactileSequence| -> Vec<f32> { (0..7).map(|frame| held.force[frame * N_FIELD + 9]).collect() };
        // Frame 2 does not count, so that frame 3 repeats frame 1.
        assert_eq!(at(&persistence(&truth, None)), [0.0, 1.0, 2.0, 2.0, 4.0, 0.0, 6.0]);
        assert_eq!(at(&persistence(&truth, Some(0.08))), [0.0, 1.0, 2.0, 2.0, 4.0, 0.0, 6.0], "no stamps, no lag");
        truth.timestamps = (0..7).map(|frame| 0.04 * f64::from(frame)).collect();
        assert_eq!(at(&persistence(&truth, Some(0.08))), [0.0, 0.0, 1.0, 2.0, 2.0, 0.0, 0.0]);
        assert_eq!(persistence(&truth, Some(0.04)), persistence(&truth, None));
    }
}
