//! Agreement of contact probabilities with frequencies, and of intervals of forces with the forces.

use std::ops::Range;

use serde::Serialize;

use super::contact::pairs;
use super::evaluate::check;
use super::statistics::finite;
use crate::error::Result;
use crate::hand::N_VERTICES;
use crate::model::Spread;
use crate::model::spread::{Intervals, LEAST_N, LEVEL};
use crate::tactile::TactileSequence;

/// Bins of the reliability diagram, of equal width in probability.
const BINS: usize = 15;
/// Probability from which a vertex counts for the second calibration error: nearly all vertices of nearly all frames are far
/// from any contact, and would hide all others in an average.
const IN_QUESTION: f32 = 0.05;

/// Reliability diagram of contact probabilities.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reliability {
    /// Mean distance between probability and frequency of the bins, weighted by their entries; None without an entry.
    pub expected_calibration_error: Option<f64>,
    /// Likewise, of the vertices with a probability of at least 0.05.
    pub expected_calibration_error_in_question: Option<f64>,
    /// Bins with an entry, by probability.
    pub bins: Vec<Bin>,
}

/// Bin of a reliability diagram.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Bin {
    /// Mean predicted probability.
    pub probability: f64,
    /// Share of true contacts.
    pub frequency: f64,
    /// Number of (frame, vertex) pairs.
    pub entries: u64,
}

/// Share of true forces within the predicted intervals.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Coverage {
    /// Probability that the intervals are made for.
    pub level: f64,
    /// Vertices with a predicted contact.
    pub touched: Option<f64>,
    /// Mean width of these intervals, N.
    pub touched_width: Option<f64>,
    /// Vertices with a predicted force of at least 0.01 N.
    pub pressed: Option<f64>,
    /// All vertices. Most predictions and truths are 0, so that this is above the level.
    pub all: Option<f64>,
    /// Total forces of hands with a predicted contact.
    pub total: Option<f64>,
    /// Mean width of these intervals, N.
    pub total_width: Option<f64>,
}

/// Computes the reliability diagram of the entries that count and whose prediction is known.
pub fn reliability(pred: &TactileSequence, target: &TactileSequence) -> Reliability {
    let mut pairs = pairs(&pred.contact, &target.contact, &target.counted_contact());
    pairs.retain(|(probability, _)| !probability.is_nan());
    let bins = bins(&pairs);
    let expected_calibration_error = error(&bins);
    pairs.retain(|(probability, _)| *probability >= IN_QUESTION);
    Reliability {
        expected_calibration_error,
        expected_calibration_error_in_question: error(&self::bins(&pairs)),
        bins: bins.into_iter().filter(|bin| bin.entries > 0).collect(),
    }
}

fn bins(pairs: &[(f32, bool)]) -> Vec<Bin> {
    let mut sums = [(0.0f64, 0u64, 0u64); BINS];
    for (probability, truth) in pairs {
        let at = ((probability * BINS as f32) as usize).min(BINS - 1);
        sums[at].0 += f64::from(*probability);
        sums[at].1 += u64::from(*truth);
        sums[at].2 += 1;
    }
    let of = |(probability, positives, entries): (f64, u64, u64)| {
        let n = entries.max(1) as f64;
        Bin { probability: probability / n, frequency: positives as f64 / n, entries }
    };
    sums.into_iter().map(of).collect()
}

fn error(bins: &[Bin]) -> Option<f64> {
    let n: u64 = bins.iter().map(|bin| bin.entries).sum();
    let sum: f64 = bins.iter().map(|bin| bin.entries as f64 * (bin.probability - bin.frequency).abs()).sum();
    finite(sum / n as f64)
}

/// Sums over intervals.
#[derive(Default)]
struct Covered {
    inside: u64,
    width: f64,
    count: u64,
}

impl Covered {
    fn push(&mut self, [low, high]: [f32; 2], truth: f32) {
        // Rounding of a sum of 778 forces.
        let slack = 1e-5 * high.abs();
        self.inside += u64::from((low - slack..=high + slack).contains(&truth));
        self.width += f64::from(high - low);
        self.count += 1;
    }

    fn share(&self) -> Option<f64> {
        finite(self.inside as f64 / self.count as f64)
    }

    fn mean_width(&self) -> Option<f64> {
        finite(self.width / self.count as f64)
    }
}

/// Computes how many true forces lie within the intervals, where they count and the prediction is known.
///
/// # Errors
/// If the two sequences differ in length.
pub fn coverage(pred: &TactileSequence, target: &TactileSequence, spread: &Spread) -> Result<Coverage> {
    let [mut touched, mut pressed, mut all, mut total] = [(); 4].map(|()| Covered::default());
    for [predicted, truth, contact] in vertex_forces(pred, target)? {
        let interval = spread.vertex.at(predicted);
        all.push(interval, truth);
        if contact > super::contact::CONTACT_THRESHOLD {
            touched.push(interval, truth);
        }
        if predicted >= LEAST_N {
            pressed.push(interval, truth);
        }
    }
    for [predicted, truth, contact] in total_forces(pred, target)? {
        if contact > super::contact::CONTACT_THRESHOLD {
            total.push(spread.total.at(predicted), truth);
        }
    }
    Ok(Coverage {
        level: LEVEL,
        touched: touched.share(),
        touched_width: touched.mean_width(),
        pressed: pressed.share(),
        all: all.share(),
        total: total.share(),
        total_width: total.mean_width(),
    })
}

/// Fits the intervals of a [`Spread`] to predictions and their truth.
///
/// # Errors
/// If the two sequences differ in length, or too few predictions are above zero.
pub fn fit_spread(pred: &TactileSequence, target: &TactileSequence) -> Result<Spread> {
    let pair = |[predicted, truth, _]: [f32; 3]| [predicted, truth];
    let vertex = vertex_forces(pred, target)?.into_iter().map(pair).collect();
    let total = total_forces(pred, target)?.into_iter().map(pair).collect();
    Ok(Spread {
        vertex: Intervals::fit("forces of vertices", vertex)?,
        total: Intervals::fit("total forces of hands", total)?,
    })
}

/// Returns predicted and true force, N, and contact probability of the vertices whose force counts and is known.
fn vertex_forces(pred: &TactileSequence, target: &TactileSequence) -> Result<Vec<[f32; 3]>> {
    check(pred, target)?;
    let mask = target.counted_force();
    let counts = |index: usize| mask.get(index).is_none_or(|mask| *mask != 0);
    let entries = pred.force.iter().zip(&target.force).zip(&pred.contact).enumerate();
    let known = entries.filter(|(index, ((p, t), _))| counts(*index) && !p.is_nan() && !t.is_nan());
    Ok(known.map(|(_, ((predicted, truth), contact))| [*predicted, *truth, *contact]).collect())
}

/// Returns predicted and true total force, N, and largest contact probability of the hands all of whose forces count and are
/// known.
fn total_forces(pred: &TactileSequence, target: &TactileSequence) -> Result<Vec<[f32; 3]>> {
    check(pred, target)?;
    let mask = target.counted_force();
    let hands = (0..target.force.len()).step_by(N_VERTICES).map(|start| start..start + N_VERTICES);
    let of = |hand: Range<usize>| {
        let sum = |forces: &[f32]| forces[hand.clone()].iter().sum::<f32>();
        let totals = [sum(&pred.force), sum(&target.force)];
        let contact = pred.contact[hand.clone()].iter().fold(0.0f32, |most, contact| most.max(*contact));
        let counts =
            mask.get(hand.clone()).is_none_or(|mask| !mask.contains(&0)) && totals.iter().all(|total| !total.is_nan());
        counts.then_some([totals[0], totals[1], contact])
    };
    Ok(hands.filter_map(of).collect())
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::tactile::N_FIELD;

    fn sequence(force: Vec<f32>, contact: Vec<f32>) -> TactileSequence {
        TactileSequence { force, contact, ..TactileSequence::default() }
    }

    #[test]
    fn drawn_contacts_agree_with_their_probability_and_squared_probabilities_do_not() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let n = 60 * N_FIELD;
        let probability: Vec<f32> = (0..n).map(|_| rng.random()).collect();
        let truth: Vec<f32> = probability.iter().map(|p| f32::from(rng.random::<f32>() < *p)).collect();
        let target = sequence(vec![0.0; n], truth);
        let fair = reliability(&sequence(vec![0.0; n], probability.clone()), &target);
        assert!(fair.expected_calibration_error.unwrap() < 0.01, "{fair:?}");
        assert_eq!(fair.bins.iter().map(|bin| bin.entries).sum::<u64>(), n as u64);
        let squared = probability.iter().map(|p| p * p).collect();
        let bold = reliability(&sequence(vec![0.0; n], squared), &target);
        // E (p - p²) of a uniform p: 1/2 - 1/3.
        let expected = 1.0 / 6.0;
        assert!((bold.expected_calibration_error.unwrap() - expected).abs() < 0.01, "{bold:?}");
    }

    #[test]
    fn intervals_hold_nine_of_ten_forces_of_other_draws() {
        let draw = |seed: u64, n: usize| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (mut predicted, mut truth, mut contact) = (Vec::new(), Vec::new(), Vec::new());
            for index in 0..n {
                // Four of five vertices are not touched, nor predicted so.
                let is_touched = index % 5 == 0;
                let p: f32 = if is_touched { rng.random_range(0.02..2.0) } else { 0.0 };
                predicted.push(p);
                truth.push(p * rng.random_range(0.5..1.5));
                contact.push(f32::from(is_touched));
            }
            (sequence(predicted, contact.clone()), sequence(truth, contact))
        };
        let n = 400 * N_FIELD;
        let ((pred, target), (other, other_target)) = (draw(1, n), draw(2, n));
        let spread = fit_spread(&pred, &target).unwrap();
        let coverage = coverage(&other, &other_target, &spread).unwrap();
        for share in [coverage.touched, coverage.pressed, coverage.total] {
            assert!((0.87..0.93).contains(&share.unwrap()), "{coverage:?}");
        }
        assert!(coverage.all.unwrap() > 0.97, "untouched vertices lie in the interval 0: {coverage:?}");
        // Nine tenths of a uniform factor from 0.5 to 1.5.
        let [low, high] = spread.vertex.at(1.0);
        assert!((0.45..0.65).contains(&low) && (high - low - 0.9).abs() < 0.06, "{low} {high}");
        let [low, high] = spread.vertex.at(4.0);
        assert!(
            (0.4..0.7).contains(&(low / 4.0)) && ((high - low) / 4.0 - 0.9).abs() < 0.08,
            "beyond the table: {low} {high}"
        );
        assert_eq!(spread.vertex.at(0.0), [0.0, 0.0]);
    }

    #[test]
    fn masked_and_unknown_entries_do_not_count() {
        let n = N_FIELD;
        let mut pred = sequence(vec![0.0; n], vec![1.0; n]);
        let mut target = sequence(vec![0.0; n], vec![0.0; n]);
        target.mask_contact = vec![0; n];
        assert_eq!(reliability(&pred, &target).expected_calibration_error, None);
        target.mask_contact[..4].fill(1);
        pred.contact[1..4].fill(f32::NAN);
        let only = reliability(&pred, &target);
        assert_eq!((only.expected_calibration_error, only.bins[0].entries), (Some(1.0), 1));
    }
}
