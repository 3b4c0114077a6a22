//! Contact scores: decisions at a threshold, and ranking.

use std::ops::Add;

use rayon::slice::ParallelSliceMut;
use serde::Serialize;

use super::statistics::finite;

/// A vertex is predicted in contact above this probability.
pub const CONTACT_THRESHOLD: f32 = 0.5;

/// Confusion matrix of contact decisions.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Confusion {
    /// True positives: predicted and true.
    pub tp: u64,
    /// False positives: predicted, not true.
    pub fp: u64,
    /// False negatives: true, not predicted.
    pub fn_: u64,
    /// True negatives: neither.
    pub tn: u64,
    /// Counted entries without a prediction (NaN).
    pub unknown: u64,
}

/// Contact scores; each is None where undefined.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct ContactScores {
    /// TP / (TP + FP); 0 if there are positives but none is predicted.
    pub precision: Option<f64>,
    /// TP / (TP + FN).
    pub recall: Option<f64>,
    /// 2 TP / (2 TP + FP + FN).
    pub f1: Option<f64>,
    /// TP / (TP + FP + FN).
    pub iou: Option<f64>,
    /// Area under the ROC curve of the probability, ties counted half.
    pub auroc: Option<f64>,
}

impl Confusion {
    /// Counts the decisions of (probability, truth) pairs at the threshold 0.5.
    pub fn of(pairs: &[(f32, bool)]) -> Self {
        Self::at(pairs, CONTACT_THRESHOLD)
    }

    /// Counts the decisions of (probability, truth) pairs at a threshold.
    pub fn at(pairs: &[(f32, bool)], threshold: f32) -> Self {
        let mut counts = Self::default();
        for (score, truth) in pairs {
            let slot = match (*score > threshold, truth) {
                _ if score.is_nan() => &mut counts.unknown,
                (true, true) => &mut counts.tp,
                (true, false) => &mut counts.fp,
                (false, true) => &mut counts.fn_,
                (false, false) => &mut counts.tn,
            };
            *slot += 1;
        }
        counts
    }

    /// Entries that are true.
    pub fn positives(&self) -> u64 {
        self.tp + self.fn_
    }

    /// Entries with a decision.
    pub fn total(&self) -> u64 {
        self.tp + self.fp + self.fn_ + self.tn
    }

    /// Returns true if an entry counts, with or without a decision.
    pub fn counts(&self) -> bool {
        self.total() + self.unknown > 0
    }

    /// Returns FP / (FP + TN); None without negatives or with an unknown prediction.
    pub fn false_positive_rate(&self) -> Option<f64> {
        (self.unknown == 0).then(|| finite(self.fp as f64 / (self.fp + self.tn) as f64)).flatten()
    }

    /// Returns precision, recall, F1 and IoU ([`auroc`] needs the probabilities), as scikit-learn does with
    /// `zero_division=0`; a score whose counts are all zero is undefined.
    pub fn scores(&self) -> ContactScores {
        let ratio = |part: u64, whole: u64| {
            (self.unknown == 0 && whole > 0).then(|| finite(part as f64 / whole as f64)).flatten()
        };
        let precision = match self.tp + self.fp {
            0 if self.positives() > 0 => ratio(0, 1),
            predicted => ratio(self.tp, predicted),
        };
        ContactScores {
            precision,
            recall: ratio(self.tp, self.positives()),
            f1: ratio(2 * self.tp, 2 * self.tp + self.fp + self.fn_),
            iou: ratio(self.tp, self.tp + self.fp + self.fn_),
            auroc: None,
        }
    }
}

impl Add for Confusion {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            tp: self.tp + other.tp,
            fp: self.fp + other.fp,
            fn_: self.fn_ + other.fn_,
            tn: self.tn + other.tn,
            unknown: self.unknown + other.unknown,
        }
    }
}

/// Returns (probability, truth) where the mask is set and the truth is known; an empty mask is set everywhere.
pub fn pairs(score: &[f32], truth: &[f32], mask: &[u8]) -> Vec<(f32, bool)> {
    let counted = |index: usize| mask.is_empty() || mask.get(index).is_some_and(|m| *m != 0);
    let pairs = score.iter().zip(truth).enumerate();
    pairs
        .filter(|(index, (_, t))| counted(*index) && !t.is_nan())
        .map(|(_, (s, t))| (*s, *t > CONTACT_THRESHOLD))
        .collect()
}

/// Returns the probability that a positive scores above a negative, ties counted half (the normalised Mann-Whitney U);
/// None without positives, without negatives, or with an unknown probability.
pub fn auroc(mut pairs: Vec<(f32, bool)>) -> Option<f64> {
    if pairs.iter().any(|(score, _)| score.is_nan()) {
        return None;
    }
    // -0 and 0 tie, but not under a total order: adding 0 turns -0 into 0.
    pairs.iter_mut().for_each(|(score, _)| *score += 0.0);
    pairs.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let (mut positives, mut negatives, mut u) = (0u64, 0u64, 0.0f64);
    for tied in pairs.chunk_by(|a, b| a.0 == b.0) {
        let tied_positives = tied.iter().filter(|(_, truth)| *truth).count() as u64;
        let tied_negatives = tied.len() as u64 - tied_positives;
        u += tied_positives as f64 * (negatives as f64 + 0.5 * tied_negatives as f64);
        positives += tied_positives;
        negatives += tied_negatives;
    }
    (positives > 0 && negatives > 0).then(|| u / (positives as f64 * negatives as f64))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn auroc_is_a_half_for_a_constant_score_and_undefined_for_one_class() {
        assert_eq!(auroc(vec![(0.3, true), (0.3, false), (0.3, false)]), Some(0.5));
        assert_eq!(auroc(vec![(0.0, true), (-0.0, false)]), Some(0.5));
        assert_eq!(auroc(vec![(0.9, true), (0.1, false)]), Some(1.0));
        assert_eq!(auroc(vec![(0.9, true), (0.1, true)]), None);
        assert_eq!(auroc(vec![(0.9, false)]), None);
        assert_eq!(auroc(vec![(f32::NAN, false), (0.2, true)]), None);
    }

    #[test]
    fn scores_with_all_counts_zero_are_undefined() {
        let of = |tp, fp, fn_, tn| Confusion { tp, fp, fn_, tn, unknown: 0 }.scores();
        assert_eq!(of(0, 0, 0, 9), ContactScores::default());
        let missed = of(0, 0, 3, 6);
        assert_eq!(
            (missed.precision, missed.recall, missed.f1, missed.iou),
            (Some(0.0), Some(0.0), Some(0.0), Some(0.0))
        );
        let false_alarm = of(0, 2, 0, 7);
        assert_eq!((false_alarm.precision, false_alarm.recall, false_alarm.f1), (Some(0.0), None, Some(0.0)));
        assert_eq!(Confusion { tp: 1, unknown: 1, ..Default::default() }.scores(), ContactScores::default());
    }
}
