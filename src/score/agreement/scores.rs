//! Agreement scores by name: ratios of [`Sums`], each undefined where its denominator is 0.

use super::Sums;
use crate::error::{Error, Result};

/// Direction in which a score is better.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// A gate sets a lower bound.
    HigherIsBetter,
    /// A gate sets an upper bound.
    LowerIsBetter,
    /// The score describes the data and can't be required.
    Descriptive,
}

/// One score.
#[derive(Debug, Clone, Copy)]
pub struct Score {
    /// Name in JSON, tables and gates.
    pub name: &'static str,
    /// Direction in which it is better.
    pub direction: Direction,
    /// Meaning, with the unit.
    pub meaning: &'static str,
    /// Computes the score; None = undefined.
    pub value: fn(&Sums) -> Option<f64>,
}

/// All scores, in the order of tables.
pub const SCORES: [Score; 24] = [
    higher("frame_mean.f1", "F1 of labelled and touched vertices, mean over frames with touch", |s| frame_mean(s, 2)),
    higher("frame_mean.precision", "share of labelled vertices that are touched, likewise", |s| frame_mean(s, 0)),
    higher("frame_mean.recall", "share of touched vertices that are labelled, likewise", |s| frame_mean(s, 1)),
    higher("frame_mean.iou", "labelled and touched over labelled or touched, likewise", |s| frame_mean(s, 3)),
    lower("false_positive_rate", "share of vertices that are labelled in frames without touch", |s| {
        s.quiet.false_positive_rate()
    }),
    Score {
        name: "share_without_positives",
        direction: Direction::Descriptive,
        meaning: "share of frames without touch, left out of the frame mean",
        value: |s| ratio(s.quiet_frames as f64, (s.quiet_frames + s.frame_scores.0) as f64),
    },
    higher("pooled.f1", "F1 over all vertices of all frames", |s| s.counts.scores().f1),
    higher("pooled.precision", "", |s| s.counts.scores().precision),
    higher("pooled.recall", "", |s| s.counts.scores().recall),
    higher("pooled.iou", "", |s| s.counts.scores().iou),
    lower("missed_force", "share of the force on touched vertices that lands on unlabelled ones", |s| {
        known(s, ratio(s.missed_force, s.force))
    }),
    lower("false_contact_mass", "share of labelled vertices farther than 3 mm from every contact with force", |s| {
        known(s, ratio(s.labelled.1 as f64, s.labelled.0 as f64))
    }),
    lower("missed_touches", "share of touches without any label", |s| {
        known(s, ratio(s.timing.missed as f64, s.timing.touches as f64))
    }),
    lower("false_touches", "share of labelled touches that overlap no true one", |s| {
        known(s, ratio(s.timing.invented as f64, s.timing.labelled as f64))
    }),
    lower("onset_error_secs", "how far beginnings of touches are off, s", |s| {
        known(s, ratio(s.timing.onset.absolute, s.timing.onset.count as f64))
    }),
    lower("offset_error_secs", "how far ends of touches are off, s", |s| {
        known(s, ratio(s.timing.offset.absolute, s.timing.offset.count as f64))
    }),
    Score {
        name: "onset_bias_secs",
        direction: Direction::Descriptive,
        meaning: "positive: labels begin late, s",
        value: |s| known(s, ratio(s.timing.onset.sum, s.timing.onset.count as f64)),
    },
    Score {
        name: "offset_bias_secs",
        direction: Direction::Descriptive,
        meaning: "positive: labels end late, s",
        value: |s| known(s, ratio(s.timing.offset.sum, s.timing.offset.count as f64)),
    },
    lower("mae", "mean absolute error of the force, N", |s| s.errors.mae()),
    lower("active_mae", "the same on touched vertices, N", |s| s.errors.active_mae()),
    lower("link_force_error", "sum over links of |force error| over the sum of their force", |s| {
        let sum = |k: usize| s.group_force.iter().map(|group| group[k]).sum::<f64>();
        if s.errors.unknown == 0 { ratio(sum(0), sum(1)) } else { None }
    }),
    lower("cop_distance_mm", "distance of the centres of pressure of pressed links, mm", |s| {
        if s.errors.unknown == 0 { ratio(1e3 * s.centres.1, s.centres.0 as f64) } else { None }
    }),
    Score {
        name: "contact_ratio",
        direction: Direction::Descriptive,
        meaning: "share of all vertices that are touched",
        value: |s| ratio(s.counts.positives() as f64, s.counts.total() as f64),
    },
    Score {
        name: "labelled_ratio",
        direction: Direction::Descriptive,
        meaning: "share of all vertices that are labelled",
        value: |s| known(s, ratio((s.counts.tp + s.counts.fp) as f64, s.counts.total() as f64)),
    },
];

/// Short names: those of the paper's averaging are the plain ones.
const SHORT: [(&str, &str); 8] = [
    ("f1", "frame_mean.f1"),
    ("precision", "frame_mean.precision"),
    ("recall", "frame_mean.recall"),
    ("iou", "frame_mean.iou"),
    ("pooled_f1", "pooled.f1"),
    ("pooled_precision", "pooled.precision"),
    ("pooled_recall", "pooled.recall"),
    ("pooled_iou", "pooled.iou"),
];

/// Returns the score of the given name; `f1` is short for `frame_mean.f1`, `pooled_f1` for `pooled.f1`, and so on.
///
/// # Errors
/// If there is no such score; the error lists the names.
pub fn find(name: &str) -> Result<&'static Score> {
    let full = SHORT.iter().find(|(short, _)| *short == name).map_or(name, |(_, full)| full);
    let names = SHORT.iter().map(|(short, _)| *short).chain(SCORES.iter().map(|score| score.name));
    SCORES.iter().find(|score| score.name == full).ok_or_else(|| Error::unknown("score", name, names))
}

const fn higher(name: &'static str, meaning: &'static str, value: fn(&Sums) -> Option<f64>) -> Score {
    Score { name, direction: Direction::HigherIsBetter, meaning, value }
}

const fn lower(name: &'static str, meaning: &'static str, value: fn(&Sums) -> Option<f64>) -> Score {
    Score { name, direction: Direction::LowerIsBetter, meaning, value }
}

fn frame_mean(sums: &Sums, which: usize) -> Option<f64> {
    known(sums, ratio(sums.frame_scores.1[which], sums.frame_scores.0 as f64))
}

/// Returns None if the label is unknown at a vertex that counts.
fn known(sums: &Sums, value: Option<f64>) -> Option<f64> {
    value.filter(|_| sums.counts.unknown == 0)
}

fn ratio(part: f64, whole: f64) -> Option<f64> {
    (whole > 0.0).then(|| part / whole).filter(|ratio| ratio.is_finite())
}
