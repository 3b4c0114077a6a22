//! Fit of the temperature of contact probabilities.

use crate::tactile::TactileSequence;

/// Range of temperatures that are tried.
const RANGE: [f64; 2] = [0.05, 20.0];
/// Width of a bin of logits. The loss is computed from bins: a frame has 1556 logits, a split tens of millions.
const BIN: f64 = 0.01;
/// Largest magnitude of a logit that is told apart: beyond it a probability in f32 is 1, or its loss far from any threshold.
const LARGEST: f64 = 30.0;
/// Steps of the search, each of which shortens the range to 0.62 of it: to 1e-6 of it.
const STEPS: usize = 30;

/// Returns the temperature T > 0 with the least cross-entropy of σ(l / T) over the entries that count and whose prediction is
/// known; None without a true contact or without a vertex without one. `pred` has probabilities at T = 1.
///
/// The cross-entropy is convex in 1 / T, so that it has one minimum.
pub fn temperature(pred: &TactileSequence, target: &TactileSequence) -> Option<f32> {
    let mask = target.counted_contact();
    let bins = 2 * (LARGEST / BIN) as usize + 1;
    let mut counts = vec![[0u64; 2]; bins];
    for (index, (probability, truth)) in pred.contact.iter().zip(&target.contact).enumerate() {
        if mask.get(index) == Some(&0) || probability.is_nan() || truth.is_nan() {
            continue;
        }
        let p = f64::from(*probability);
        let logit = (p.ln() - (1.0 - p).ln()).clamp(-LARGEST, LARGEST);
        counts[((logit + LARGEST) / BIN).round() as usize][usize::from(*truth > 0.5)] += 1;
    }
    if [0, 1].iter().any(|class| counts.iter().all(|count| count[*class] == 0)) {
        return None;
    }
    let loss = |log_temperature: f64| -> f64 {
        let inverse = (-log_temperature).exp();
        let of = |(bin, [negatives, positives]): (usize, &[u64; 2])| {
            let x = inverse * (bin as f64 * BIN - LARGEST);
            // ln(1 + e^x) without overflow.
            let softplus = |x: f64| x.max(0.0) + (-x.abs()).exp().ln_1p();
            *negatives as f64 * softplus(x) + *positives as f64 * softplus(-x)
        };
        counts.iter().enumerate().map(of).sum()
    };
    // Golden-section search: a monotone change of the variable keeps the one minimum.
    let ratio = 0.5 * (5f64.sqrt() - 1.0);
    let [mut low, mut high] = RANGE.map(f64::ln);
    for _ in 0..STEPS {
        let (left, right) = (high - ratio * (high - low), low + ratio * (high - low));
        if loss(left) < loss(right) { high = right } else { low = left }
    }
    Some((0.5 * (low + high)).exp() as f32)
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn the_temperature_of_drawn_contacts_is_found() {
        for expected in [0.4f32, 1.0, 2.5] {
            let mut rng = ChaCha8Rng::seed_from_u64(3);
            let (mut pred, mut target) = (TactileSequence::default(), TactileSequence::default());
            for _ in 0..200_000 {
                let logit: f32 = rng.random_range(-6.0..6.0);
                let sigma = |x: f32| 1.0 / (1.0 + (-x).exp());
                pred.contact.push(sigma(logit));
                target.contact.push(f32::from(rng.random::<f32>() < sigma(logit / expected)));
                target.mask_contact.push(1);
            }
            // Neither of these counts.
            pred.contact.extend([f32::NAN, 0.9]);
            target.contact.extend([0.0, 0.0]);
            target.mask_contact.extend([1, 0]);
            let found = temperature(&pred, &target).unwrap();
            assert!((found / expected - 1.0).abs() < 0.03, "{found}, expected {expected}");
        }
    }

    #[test]
    fn contacts_of_one_kind_have_no_temperature() {
        let pred = TactileSequence { contact: vec![0.2, 0.9], ..TactileSequence::default() };
        for truth in [0.0, 1.0] {
            let target = TactileSequence { contact: vec![truth; 2], mask_contact: vec![1; 2], ..pred.clone() };
            assert_eq!(temperature(&pred, &target), None);
        }
    }
}
