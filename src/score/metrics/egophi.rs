//! Scores by the protocol of EgoPHI (ECCV 2026), for comparison with its numbers.
//!
//! | | paper of EgoTac (the other scores here) | EgoPHI |
//! |---|---|---|
//! | contact is predicted above | 0.5 | 0.3 |
//! | unit of the average | frame with a contact in truth | hand in a frame with a contact in truth |
//! | force error | over all (active) vertices of all frames | over the touched vertices of a hand, then averaged over hands |
//!
//! Every hand in every frame in which it touches something counts once. Hands without contact are left out, so that false
//! alarms in frames without contact cost nothing.

use std::collections::BTreeMap;

use serde::Serialize;

use super::bootstrap;
use super::contact::{self, Confusion, ContactScores};
use super::evaluate::{Mask, check};
use crate::error::Result;
use crate::hand::Side;
use crate::tactile::{N_FIELD, TactileSequence};

/// A vertex is predicted in contact above this probability.
pub const CONTACT_THRESHOLD: f32 = 0.3;

/// Names of the scores.
const NAMES: [&str; 7] = ["precision", "recall", "f1", "iou", "masked_mae", "masked_rmse", "volumetric_iou"];

/// Scores of EgoPHI's protocol, each averaged over the hands in the frames in which they touch; None where undefined, and if
/// the prediction is unknown at a vertex that counts.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct EgophiScores {
    /// Share of the vertices predicted in contact that are.
    pub precision: Option<f64>,
    /// Share of the vertices in contact that are predicted.
    pub recall: Option<f64>,
    /// F1 of contact at the threshold 0.3.
    pub f1: Option<f64>,
    /// IoU of contact at the threshold 0.3.
    pub iou: Option<f64>,
    /// Mean absolute error of the force on touched vertices, N.
    pub masked_mae: Option<f64>,
    /// Root mean square error of the force on touched vertices, N.
    pub masked_rmse: Option<f64>,
    /// Sum of the smaller over the sum of the greater of predicted and true force, over all vertices of the hand.
    pub volumetric_iou: Option<f64>,
    /// Hands that count.
    pub hands: usize,
    /// 95 % intervals by a bootstrap over episodes, by name of the score; empty for fewer than two episodes.
    pub intervals: BTreeMap<&'static str, [f64; 2]>,
}

/// Scores `pred` against `target`; `seed` is that of the bootstrap. Entries that the target masks out do not count.
///
/// # Errors
/// As [`evaluate`](super::evaluate()).
pub fn evaluate_egophi(pred: &TactileSequence, target: &TactileSequence, seed: u64) -> Result<EgophiScores> {
    check(pred, target)?;
    let mask = Mask::of(target);
    let of = |episode: std::ops::Range<usize>| {
        let mut terms = Terms::default();
        for frame in episode {
            Side::BOTH.into_iter().for_each(|side| terms.add_hand(pred, target, &mask, frame, side));
        }
        terms
    };
    let episodes: Vec<Terms> = target.episodes().into_iter().map(of).collect();
    let sum = |drawn: &mut dyn Iterator<Item = &Terms>| {
        let mut sum = Terms::default();
        drawn.for_each(|terms| sum.add(terms));
        sum
    };
    let total = sum(&mut episodes.iter());
    let [precision, recall, f1, iou, masked_mae, masked_rmse, volumetric_iou] = total.means();
    let intervals = bootstrap::intervals(&episodes, seed, sum, |sum| sum.means().to_vec());
    Ok(EgophiScores {
        precision,
        recall,
        f1,
        iou,
        masked_mae,
        masked_rmse,
        volumetric_iou,
        hands: total.hands,
        intervals: NAMES.into_iter().zip(intervals).filter_map(|(name, interval)| Some((name, interval?))).collect(),
    })
}

/// Sums of scores over the hands of one episode.
#[derive(Debug, Clone, Default)]
struct Terms {
    /// Hands that touch.
    hands: usize,
    /// Sum and number of each score.
    sums: [(f64, usize); NAMES.len()],
    /// True for contact, and for force, if the prediction is unknown somewhere.
    unknown: [bool; 2],
}

impl Terms {
    /// Adds one hand of one frame, if it touches.
    fn add_hand(&mut self, pred: &TactileSequence, target: &TactileSequence, mask: &Mask, frame: usize, side: Side) {
        let hand = side.range();
        let rows = frame * N_FIELD + hand.start..frame * N_FIELD + hand.end;
        let counted = mask.contact.get(rows.clone()).unwrap_or_default();
        let (score, truth) = (&pred.contact[rows.clone()], &target.contact[rows.clone()]);
        let contacts = Confusion::at(&contact::pairs(score, truth, counted), CONTACT_THRESHOLD);
        if contacts.positives() == 0 {
            return;
        }
        self.hands += 1;
        self.unknown[0] |= contacts.unknown > 0;
        let ContactScores { precision, recall, f1, iou, .. } = contacts.scores();
        let errors = ForceTerms::of(
            &pred.force[rows.clone()],
            &target.force[rows.clone()],
            truth,
            mask.force.get(rows).unwrap_or_default(),
        );
        self.unknown[1] |= errors.is_unknown;
        let scores = [precision, recall, f1, iou, errors.mae(), errors.rmse(), errors.volumetric_iou()];
        for ((sum, count), score) in self.sums.iter_mut().zip(scores) {
            *sum += score.unwrap_or(0.0);
            *count += usize::from(score.is_some());
        }
    }

    fn add(&mut self, other: &Self) {
        self.hands += other.hands;
        for ((sum, count), (more, n)) in self.sums.iter_mut().zip(other.sums) {
            *sum += more;
            *count += n;
        }
        self.unknown = [0, 1].map(|kind| self.unknown[kind] || other.unknown[kind]);
    }

    /// Returns the scores in the order of [`NAMES`]; the last three are those of force.
    fn means(&self) -> [Option<f64>; NAMES.len()] {
        let mut means = self.sums.map(|(sum, count)| (count > 0).then(|| sum / count as f64));
        let (contact, force) = means.split_at_mut(4);
        for (scores, unknown) in [contact, force].into_iter().zip(self.unknown) {
            scores.iter_mut().filter(|_| unknown).for_each(|score| *score = None);
        }
        means
    }
}

/// Sums of the force errors of one hand in one frame.
#[derive(Debug, Clone, Copy, Default)]
struct ForceTerms {
    /// Touched vertices whose force counts.
    touched: usize,
    absolute: f64,
    squared: f64,
    smaller: f64,
    greater: f64,
    is_unknown: bool,
}

impl ForceTerms {
    /// All slices are of one hand's vertices; an empty mask counts every vertex.
    fn of(pred: &[f32], target: &[f32], contact: &[f32], mask: &[u8]) -> Self {
        let mut terms = Self::default();
        for (vertex, (pred, target)) in pred.iter().zip(target).enumerate() {
            if mask.get(vertex).is_some_and(|mask| *mask == 0) || target.is_nan() {
                continue;
            }
            let (pred, target) = (f64::from(*pred), f64::from(*target));
            terms.is_unknown |= !pred.is_finite();
            terms.smaller += pred.min(target);
            terms.greater += pred.max(target);
            if contact[vertex] > contact::CONTACT_THRESHOLD {
                terms.touched += 1;
                terms.absolute += (pred - target).abs();
                terms.squared += (pred - target).powi(2);
            }
        }
        terms
    }

    fn mae(&self) -> Option<f64> {
        (self.touched > 0).then(|| self.absolute / self.touched as f64)
    }

    fn rmse(&self) -> Option<f64> {
        (self.touched > 0).then(|| (self.squared / self.touched as f64).sqrt())
    }

    fn volumetric_iou(&self) -> Option<f64> {
        (self.touched > 0).then(|| if self.greater > 0.0 { self.smaller / self.greater } else { 0.0 })
    }
}

/// Selects one score.
type Score = fn(&EgophiScores) -> Option<f64>;

/// Returns a table with one column per named prediction.
pub fn egophi_table(reports: &[(&str, &EgophiScores)]) -> String {
    let rows: [(&str, Score); NAMES.len()] = [
        ("precision at 0.3", |s| s.precision),
        ("recall at 0.3", |s| s.recall),
        ("F1 at 0.3", |s| s.f1),
        ("IoU at 0.3", |s| s.iou),
        ("masked MAE (N)", |s| s.masked_mae),
        ("masked RMSE (N)", |s| s.masked_rmse),
        ("volumetric IoU", |s| s.volumetric_iou),
    ];
    let first = reports.first().map(|(_, first)| *first);
    let mut text = format!("{:20}", "EgoPHI's protocol");
    reports.iter().for_each(|(name, _)| text += &format!("{name:>13}"));
    text += &format!("{:>24}", "95 % of the first");
    for ((row, score), name) in rows.into_iter().zip(NAMES) {
        text += &format!("\n{row:20}");
        for (_, report) in reports {
            text += &score(report).map_or(format!("{:>13}", "undefined"), |value| format!("{value:>13.5}"));
        }
        let interval = first.and_then(|first| first.intervals.get(name));
        text +=
            &interval.map_or(format!("{:>24}", "-"), |[low, high]| format!("{:>24}", format!("{low:.5} .. {high:.5}")));
    }
    text + &format!("\naverages over {} hands in frames in which they touch", first.map_or(0, |first| first.hands))
}
