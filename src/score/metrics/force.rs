//! Errors of the force, in newtons.

use std::ops::Add;

use super::statistics::finite;
use crate::tactile::CONTACT_FORCE_N;

/// Sums of absolute force errors over counted vertices.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ForceErrors {
    /// Sum of |predicted - true|, N.
    pub sum: f64,
    /// Entries in `sum`.
    pub count: u64,
    /// Sum of |predicted - true| where the true force is above 0.05 N, N.
    pub active_sum: f64,
    /// Entries in `active_sum`.
    pub active_count: u64,
    /// Counted entries without a prediction (NaN).
    pub unknown: u64,
}

impl ForceErrors {
    /// Sums the errors of (predicted, true) pairs, N.
    pub fn of(pairs: &[(f32, f32)]) -> Self {
        let mut errors = Self::default();
        for (pred, target) in pairs {
            if pred.is_nan() {
                errors.unknown += 1;
                continue;
            }
            let error = (f64::from(*pred) - f64::from(*target)).abs();
            errors.sum += error;
            errors.count += 1;
            if *target > CONTACT_FORCE_N {
                errors.active_sum += error;
                errors.active_count += 1;
            }
        }
        errors
    }

    /// Returns the mean absolute error, N; None if nothing counts or a prediction is unknown.
    pub fn mae(&self) -> Option<f64> {
        self.mean(self.sum, self.count)
    }

    /// Returns the mean absolute error where the true force is above 0.05 N; None without such entries.
    pub fn active_mae(&self) -> Option<f64> {
        self.mean(self.active_sum, self.active_count)
    }

    fn mean(&self, sum: f64, count: u64) -> Option<f64> {
        (self.unknown == 0 && count > 0).then(|| finite(sum / count as f64)).flatten()
    }
}

impl Add for ForceErrors {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            sum: self.sum + other.sum,
            count: self.count + other.count,
            active_sum: self.active_sum + other.active_sum,
            active_count: self.active_count + other.active_count,
            unknown: self.unknown + other.unknown,
        }
    }
}

/// Returns (predicted, true) forces where the mask is set and the truth is known; an empty mask is set everywhere.
pub fn pairs(pred: &[f32], target: &[f32], mask: &[u8]) -> Vec<(f32, f32)> {
    let counted = |index: usize| mask.is_empty() || mask.get(index).is_some_and(|m| *m != 0);
    let pairs = pred.iter().zip(target).enumerate();
    pairs.filter(|(index, (_, t))| counted(*index) && !t.is_nan()).map(|(_, (p, t))| (*p, *t)).collect()
}

/// Returns the predicted and the true total force of one frame, N. Both are None if no vertex counts: such a frame takes part
/// in no trace. The predicted one is also None if a counted vertex of it is unknown.
pub fn totals(pairs: &[(f32, f32)]) -> (Option<f64>, Option<f64>) {
    if pairs.is_empty() {
        return (None, None);
    }
    let (pred, target) =
        pairs.iter().fold((0.0, 0.0), |(p, t), (pred, target)| (p + f64::from(*pred), t + f64::from(*target)));
    (finite(pred), Some(target))
}
