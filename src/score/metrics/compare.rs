//! Comparison of two predictions of the same truth, with confidence intervals of the differences.

use serde::Serialize;

use super::bootstrap;
use super::episode_terms::{EpisodeTerms, NAMES, TermSum, episode_terms};
use super::evaluate::{EvalOptions, evaluate};
use super::summary::Metrics;
use crate::error::{Error, Result};
use crate::tactile::TactileSequence;

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
    let values = report.values().into_iter().zip(other_report.values());
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

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::super::episode_terms::intervals;
    use super::*;
    use crate::tactile::N_FIELD;

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
        assert_eq!((exact.score("frame_mean.f1"), exact.score("f1")), (exact.frame_mean.f1, None));
        let own = intervals(&good, &target, &options, 1).unwrap();
        let [low, high] = own["frame_mean.f1"];
        let value = exact.frame_mean.f1.unwrap();
        assert!(low <= value && value <= high, "{value} outside of {low}..{high}");
        assert_eq!(of("pooled.f1").value, exact.pooled.f1);
        assert_eq!(comparison.other, evaluate(&bad, &target, &options).unwrap());
        assert_eq!(comparison, compare(&good, &bad, &target, &options, 1).unwrap());
    }

    #[test]
    fn terms_of_all_episodes_add_up_to_the_scores_of_the_whole() {
        let (target, [pred, _], options) = fields([0.8, 0.0]);
        let mut sum = TermSum::default();
        episode_terms(&pred, &target, &options).iter().for_each(|terms| sum.add(terms));
        let whole = evaluate(&pred, &target, &options).unwrap().values();
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
