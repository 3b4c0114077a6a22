//! Contributions of single episodes to all scores, from which confidence intervals are drawn.

use std::collections::BTreeMap;

use super::bootstrap;
use super::contact::{self, Confusion, ContactScores};
use super::evaluate::{EvalOptions, Mask, check, score_frames, score_traces};
use super::force::ForceErrors;
use super::summary::Metrics;
use super::trace::TraceScores;
use crate::error::Result;
use crate::tactile::{N_FIELD, TactileSequence};

/// Bins of equal population that predicted probabilities are sorted into for the AUROC of a resample; 4096 of them keep
/// it exact to 1 in 10 000.
const AUROC_BINS: usize = 4096;

/// Number of scores with a name.
const N_SCORES: usize = 20;

/// Names of the scores in the JSON report, in the order of tables.
pub(super) const NAMES: [&str; N_SCORES] = [
    "mae",
    "active_mae",
    "temporal_pearson",
    "frame_mean.precision",
    "frame_mean.recall",
    "frame_mean.f1",
    "frame_mean.iou",
    "frame_mean.auroc",
    "false_positive_rate",
    "pooled.precision",
    "pooled.recall",
    "pooled.f1",
    "pooled.iou",
    "pooled.auroc",
    "force_cosine",
    "rise_f1",
    "fall_f1",
    "dft_pearson",
    "spectral_convergence",
    "dominant_frequency_error_hz",
];

/// 95 % interval by name of the score, such as `frame_mean.f1`; scores without an interval are left out.
pub type Intervals = BTreeMap<&'static str, [f64; 2]>;

/// Returns the 95 % intervals of all scores by a bootstrap over episodes; none for fewer than two episodes.
///
/// # Errors
/// As [`evaluate`](super::evaluate()).
pub fn intervals(
    pred: &TactileSequence,
    target: &TactileSequence,
    options: &EvalOptions,
    seed: u64,
) -> Result<Intervals> {
    check(pred, target)?;
    let episodes = episode_terms(pred, target, options);
    let sum = |drawn: &mut dyn Iterator<Item = &EpisodeTerms>| {
        let mut sum = TermSum::default();
        drawn.for_each(|terms| sum.add(terms));
        sum
    };
    let intervals = bootstrap::intervals(&episodes, seed, sum, |sum| sum.scores().to_vec());
    Ok(NAMES.into_iter().zip(intervals).filter_map(|(name, interval)| Some((name, interval?))).collect())
}

impl Metrics {
    /// Returns a score by its name in the JSON report, such as `frame_mean.f1`; None if it is undefined or there is no such
    /// score.
    pub fn score(&self, name: &str) -> Option<f64> {
        let at = NAMES.iter().position(|own| *own == name)?;
        self.values()[at]
    }

    /// Returns the scores in the order of [`NAMES`].
    pub(super) fn values(&self) -> [Option<f64>; N_SCORES] {
        let Self { frame_mean: f, pooled: p, .. } = self;
        [
            self.mae,
            self.active_mae,
            self.temporal_pearson,
            f.precision,
            f.recall,
            f.f1,
            f.iou,
            f.auroc,
            self.false_positive_rate,
            p.precision,
            p.recall,
            p.f1,
            p.iou,
            p.auroc,
            self.force_cosine,
            self.rise_f1,
            self.fall_f1,
            self.dft_pearson,
            self.spectral_convergence,
            self.dominant_frequency_error_hz,
        ]
    }
}

/// Contribution of one episode to the scores of one prediction.
#[derive(Debug, Clone, Default)]
pub(super) struct EpisodeTerms {
    force: ForceErrors,
    contact: Confusion,
    /// Contact decisions in frames without positives.
    quiet: Confusion,
    /// Sums and counts over the frames that have positives: precision, recall, F1, IoU, AUROC.
    frames: [(f64, usize); 5],
    trace: TraceScores,
    /// Negatives and positives by bin of their probability; empty if a probability is unknown.
    bins: Vec<[u32; 2]>,
}

/// Returns the contribution of each episode of `target`.
pub(super) fn episode_terms(
    pred: &TactileSequence,
    target: &TactileSequence,
    options: &EvalOptions,
) -> Vec<EpisodeTerms> {
    let mask = Mask::of(target);
    let frames = score_frames(pred, target, &mask);
    let traces = score_traces(&frames, target, options);
    let edges = edges(contact::pairs(&pred.contact, &target.contact, &mask.contact));
    let of = |(episode, trace): (std::ops::Range<usize>, TraceScores)| {
        let mut terms = EpisodeTerms { trace, bins: vec![[0; 2]; edges.len()], ..EpisodeTerms::default() };
        for frame in &frames[episode.clone()] {
            terms.force = terms.force + frame.force;
            terms.contact = terms.contact + frame.contact;
            if frame.contact.positives() == 0 {
                terms.quiet = terms.quiet + frame.contact;
                continue;
            }
            let ContactScores { precision, recall, f1, iou, .. } = frame.contact.scores();
            for ((sum, count), score) in terms.frames.iter_mut().zip([precision, recall, f1, iou, frame.auroc]) {
                *sum += score.unwrap_or(0.0);
                *count += usize::from(score.is_some());
            }
        }
        let rows = episode.start * N_FIELD..episode.end * N_FIELD;
        let mask = mask.contact.get(rows.clone()).unwrap_or_default();
        for (score, truth) in contact::pairs(&pred.contact[rows.clone()], &target.contact[rows], mask) {
            if let Some(bin) = terms.bins.get_mut(edges.partition_point(|edge| *edge < score)) {
                bin[usize::from(truth)] += 1;
            }
        }
        terms
    };
    target.episodes().into_iter().zip(traces).map(of).collect()
}

/// Returns the upper ends of bins of equal population; none if a probability is unknown.
fn edges(pairs: Vec<(f32, bool)>) -> Vec<f32> {
    let mut scores: Vec<f32> = pairs.into_iter().map(|(score, _)| score).collect();
    if scores.iter().any(|score| score.is_nan()) {
        return Vec::new();
    }
    scores.sort_unstable_by(f32::total_cmp);
    let last = scores.len().saturating_sub(1);
    let mut edges: Vec<f32> = (1..=AUROC_BINS).filter_map(|n| scores.get(last * n / AUROC_BINS).copied()).collect();
    edges.dedup();
    edges
}

/// Sum over the episodes of a resample.
#[derive(Debug, Default)]
pub(super) struct TermSum {
    terms: EpisodeTerms,
    traces: Vec<TraceScores>,
}

impl TermSum {
    /// Adds an episode.
    pub(super) fn add(&mut self, other: &EpisodeTerms) {
        self.terms.force = self.terms.force + other.force;
        self.terms.contact = self.terms.contact + other.contact;
        self.terms.quiet = self.terms.quiet + other.quiet;
        for ((sum, count), (more, n)) in self.terms.frames.iter_mut().zip(other.frames) {
            *sum += more;
            *count += n;
        }
        self.terms.bins.resize(other.bins.len(), [0; 2]);
        for (sum, more) in self.terms.bins.iter_mut().zip(&other.bins) {
            *sum = [sum[0] + more[0], sum[1] + more[1]];
        }
        self.traces.push(other.trace);
    }

    /// Returns the scores in the order of [`NAMES`].
    pub(super) fn scores(&self) -> [Option<f64>; N_SCORES] {
        let EpisodeTerms { force, contact, quiet, frames, bins, .. } = &self.terms;
        let mean = |(sum, count): (f64, usize)| (count > 0 && contact.unknown == 0).then(|| sum / count as f64);
        let [fp, fr, ff, fi, fa] = frames.map(mean);
        let ContactScores { precision, recall, f1, iou, .. } = contact.scores();
        let t = TraceScores::mean(self.traces.iter());
        [
            force.mae(),
            force.active_mae(),
            t.temporal_pearson,
            fp,
            fr,
            ff,
            fi,
            fa,
            quiet.false_positive_rate(),
            precision,
            recall,
            f1,
            iou,
            binned_auroc(bins),
            t.force_cosine,
            t.rise_f1,
            t.fall_f1,
            t.dft_pearson,
            t.spectral_convergence,
            t.dominant_frequency_error_hz,
        ]
    }
}

/// Returns the AUROC as [`contact::auroc`] does, with all probabilities of a bin tied.
fn binned_auroc(bins: &[[u32; 2]]) -> Option<f64> {
    let (mut negatives, mut positives, mut u) = (0.0, 0.0, 0.0);
    for [bin_negatives, bin_positives] in bins.iter().map(|bin| bin.map(f64::from)) {
        u += bin_positives * (negatives + 0.5 * bin_negatives);
        negatives += bin_negatives;
        positives += bin_positives;
    }
    (positives > 0.0 && negatives > 0.0).then(|| u / (positives * negatives))
}
