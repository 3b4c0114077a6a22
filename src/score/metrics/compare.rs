//! Comparison of two predictions of the same truth, with confidence intervals of the differences.

use serde::Serialize;

use super::bootstrap;
use super::contact::{self, Confusion, ContactScores};
use super::evaluate::{EvalOptions, Mask, evaluate, score_frames, score_traces};
use super::force::ForceErrors;
use super::summary::Metrics;
use super::trace::TraceScores;
use crate::error::{Error, Result};
use crate::tactile::{N_FIELD, TactileSequence};

/// Bins of equal population that predicted probabilities are sorted into for the AUROC of a resample; 4096 of them keep
/// it exact to 1 in 10 000.
const AUROC_BINS: usize = 4096;

/// Scores of two predictions and their paired difference.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// Scores of the other prediction.
    pub other: Metrics,
    /// One entry per score, in the order of the table.
    pub differences: Vec<Difference>,
    /// Episodes that were resampled; intervals need at least two.
    pub episodes: usize,
    /// Resamples.
    #[serde(rename = "drawings")]
    pub resamples: usize,
    /// Seed of the resamples.
    pub seed: u64,
}

/// One score of both predictions.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    /// Name of the score in the JSON report, e.g. `pooled.f1`.
    pub name: &'static str,
    /// Score of the first prediction.
    pub value: Option<f64>,
    /// Score of the other prediction.
    pub other: Option<f64>,
    /// First minus other.
    pub difference: Option<f64>,
    /// 95 % interval of the difference, over resamples that draw the same episodes for both.
    pub interval: Option<[f64; 2]>,
}

/// Names of the compared scores, as in the JSON report.
const NAMES: [&str; 19] = [
    "mae",
    "active_mae",
    "temporal_pearson",
    "frame_mean.precision",
    "frame_mean.recall",
    "frame_mean.f1",
    "frame_mean.iou",
    "frame_mean.auroc",
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

/// Scores `pred` and `other` against `target`, with a paired bootstrap over episodes: each resample draws the same
/// episodes for both.
///
/// # Errors
/// As [`evaluate`], for either prediction.
pub fn compare(
    pred: &TactileSequence,
    other: &TactileSequence,
    target: &TactileSequence,
    options: &EvalOptions,
    seed: u64,
) -> Result<Comparison> {
    let report = evaluate(pred, target, options)?;
    let other_report = evaluate(other, target, options)
        .map_err(|error| Error::value("the other prediction", "a fitting one", error))?;
    let n_episodes = target.episodes().len();
    let [mine, theirs] = [pred, other].map(|sequence| episode_terms(sequence, target, options));
    let pairs: Vec<(EpisodeTerms, EpisodeTerms)> = mine.into_iter().zip(theirs).collect();
    let sum = |drawn: &mut dyn Iterator<Item = &(EpisodeTerms, EpisodeTerms)>| {
        let mut sums = [TermSum::default(), TermSum::default()];
        for (mine, theirs) in drawn {
            sums[0].add(mine);
            sums[1].add(theirs);
        }
        sums
    };
    let statistics = |[mine, theirs]: &[TermSum; 2]| {
        mine.scores().iter().zip(theirs.scores()).map(|(a, b)| Some((*a)? - b?)).collect::<Vec<_>>()
    };
    let intervals = bootstrap::intervals(&pairs, seed, sum, statistics);
    let values = values(&report).into_iter().zip(values(&other_report));
    let differences = NAMES.into_iter().zip(values).zip(intervals).map(|((name, (value, other)), interval)| {
        let difference = value.zip(other).map(|(a, b)| a - b);
        Difference { name, value, other, difference, interval: interval.filter(|_| difference.is_some()) }
    });
    Ok(Comparison {
        differences: differences.collect(),
        other: other_report,
        episodes: n_episodes,
        resamples: bootstrap::RESAMPLES,
        seed,
    })
}

/// Returns the scores in the order of [`NAMES`].
fn values(report: &Metrics) -> [Option<f64>; 19] {
    let Metrics { frame_mean: f, pooled: p, .. } = report;
    [
        report.mae,
        report.active_mae,
        report.temporal_pearson,
        f.precision,
        f.recall,
        f.f1,
        f.iou,
        f.auroc,
        p.precision,
        p.recall,
        p.f1,
        p.iou,
        p.auroc,
        report.force_cosine,
        report.rise_f1,
        report.fall_f1,
        report.dft_pearson,
        report.spectral_convergence,
        report.dominant_frequency_error_hz,
    ]
}

/// Contribution of one episode to the scores of one prediction.
#[derive(Debug, Clone, Default)]
struct EpisodeTerms {
    force: ForceErrors,
    contact: Confusion,
    /// Sums and counts over the frames that have positives: precision, recall, F1, IoU, AUROC.
    frames: [(f64, usize); 5],
    trace: TraceScores,
    /// Negatives and positives by bin of their probability; empty if a probability is unknown.
    bins: Vec<[u32; 2]>,
}

fn episode_terms(pred: &TactileSequence, target: &TactileSequence, options: &EvalOptions) -> Vec<EpisodeTerms> {
    let mask = Mask::of(target);
    let frames = score_frames(pred, target, &mask);
    let traces = score_traces(&frames, target, options);
    let edges = edges(contact::pairs(&pred.contact, &target.contact, &mask.contact));
    let of = |(episode, trace): (std::ops::Range<usize>, TraceScores)| {
        let mut terms = EpisodeTerms { trace, bins: vec![[0; 2]; edges.len()], ..EpisodeTerms::default() };
        for frame in &frames[episode.clone()] {
            terms.force = terms.force + frame.force;
            terms.contact = terms.contact + frame.contact;
            if frame.contact.positives() > 0 {
                let ContactScores { precision, recall, f1, iou, .. } = frame.contact.scores();
                for ((sum, count), score) in terms.frames.iter_mut().zip([precision, recall, f1, iou, frame.auroc]) {
                    *sum += score.unwrap_or(0.0);
                    *count += usize::from(score.is_some());
                }
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
struct TermSum {
    terms: EpisodeTerms,
    traces: Vec<TraceScores>,
}

impl TermSum {
    fn add(&mut self, other: &EpisodeTerms) {
        self.terms.force = self.terms.force + other.force;
        self.terms.contact = self.terms.contact + other.contact;
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
    fn scores(&self) -> [Option<f64>; 19] {
        let EpisodeTerms { force, contact, frames, bins, .. } = &self.terms;
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

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const EPISODES: usize = 12;
    const FRAMES: usize = 6;

    /// Returns truth, and predictions with noise of the given sizes.
    fn fields(noises: [f64; 2]) -> (TactileSequence, [TactileSequence; 2], EvalOptions) {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let n = EPISODES * FRAMES * N_FIELD;
        let force: Vec<f32> = (0..n)
            .map(|i| if i % 29 == 0 { 0.3 * (1.0 + (i / N_FIELD % FRAMES) as f32) * rng.random::<f32>() } else { 0.0 })
            .collect();
        let mut target = TactileSequence::from_force(None, force);
        target.episode_ends = (1..=EPISODES).map(|e| e * FRAMES).collect();
        let predictions = noises.map(|noise| TactileSequence {
            force: target.force.iter().map(|f| (f + (noise * rng.random::<f64>()) as f32).max(0.0)).collect(),
            contact: target
                .contact
                .iter()
                .map(|c| (0.25 + 0.5 * f64::from(*c) + noise * (rng.random::<f64>() - 0.5)).clamp(0.0, 1.0) as f32)
                .collect(),
            ..TactileSequence::default()
        });
        (target, predictions, EvalOptions { fps: Some(25.0), calibration: None })
    }

    #[test]
    fn the_better_of_two_predictions_has_an_interval_beyond_zero() {
        let (target, [good, bad], options) = fields([0.3, 1.2]);
        let comparison = compare(&good, &bad, &target, &options, 1).unwrap();
        let of = |name: &str| comparison.differences.iter().find(|d| d.name == name).unwrap().clone();
        for name in ["mae", "pooled.f1", "pooled.auroc", "frame_mean.f1"] {
            let Difference { difference, interval, .. } = of(name);
            let ([low, high], difference) = (interval.unwrap(), difference.unwrap());
            assert!(low <= difference && difference <= high, "{name}: {difference} outside of {low}..{high}");
            let better = if name == "mae" { high < 0.0 } else { low > 0.0 };
            assert!(better, "{name}: {low}..{high}");
        }
        let exact = evaluate(&good, &target, &options).unwrap();
        assert_eq!(of("pooled.f1").value, exact.pooled.f1);
        assert_eq!(comparison.other, evaluate(&bad, &target, &options).unwrap());
        assert_eq!(comparison, compare(&good, &bad, &target, &options, 1).unwrap());
    }

    #[test]
    fn terms_of_all_episodes_add_up_to_the_scores_of_the_whole() {
        let (target, [pred, _], options) = fields([0.8, 0.0]);
        let mut sum = TermSum::default();
        episode_terms(&pred, &target, &options).iter().for_each(|terms| sum.add(terms));
        let whole = values(&evaluate(&pred, &target, &options).unwrap());
        for ((name, got), expected) in NAMES.iter().zip(sum.scores()).zip(whole) {
            let tolerance = if name.ends_with("pooled.auroc") { 1e-4 } else { 1e-12 };
            match (got, expected) {
                (Some(got), Some(expected)) => assert!((got - expected).abs() < tolerance, "{name}: {got} {expected}"),
                other => assert_eq!(other, (None, None), "{name}"),
            }
        }
    }

    #[test]
    fn a_prediction_against_itself_differs_by_zero_and_one_episode_has_no_interval() {
        let (mut target, [pred, _], options) = fields([0.8, 0.0]);
        let same = compare(&pred, &pred, &target, &options, 1).unwrap();
        for Difference { name, difference, interval, .. } in same.differences {
            assert!(difference.is_none() || (difference, interval) == (Some(0.0), Some([0.0, 0.0])), "{name}");
        }
        target.episode_ends.clear();
        let one = compare(&pred, &pred, &target, &options, 1).unwrap();
        assert!(one.differences.iter().all(|difference| difference.interval.is_none()));
    }
}
