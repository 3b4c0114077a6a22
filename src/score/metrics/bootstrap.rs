//! Bootstrap confidence intervals over episodes.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Resamples per interval.
pub const RESAMPLES: usize = 1000;
/// Confidence level of the intervals.
pub const CONFIDENCE: f64 = 0.95;

/// Returns the 95 % interval of each statistic by a percentile bootstrap: each resample draws as many episodes as there
/// are, with replacement. Whole episodes are drawn because the frames of one episode depend on each other.
///
/// `sum` adds up a resample; `statistics` returns the same number of values for each. An interval is None for fewer than
/// two episodes, or if the statistic is undefined in more than half of the resamples. The same seed gives the same bits.
pub fn intervals<T, S>(
    episodes: &[T],
    seed: u64,
    sum: impl Fn(&mut dyn Iterator<Item = &T>) -> S,
    statistics: impl Fn(&S) -> Vec<Option<f64>>,
) -> Vec<Option<[f64; 2]>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let count = statistics(&sum(&mut std::iter::empty())).len();
    if episodes.len() < 2 {
        return vec![None; count];
    }
    let mut values = vec![Vec::with_capacity(RESAMPLES); count];
    for _ in 0..RESAMPLES {
        let drawn: Vec<usize> = (0..episodes.len()).map(|_| rng.random_range(0..episodes.len())).collect();
        let total = sum(&mut drawn.iter().map(|index| &episodes[*index]));
        for (all, value) in values.iter_mut().zip(statistics(&total)) {
            all.extend(value);
        }
    }
    values.into_iter().map(percentiles).collect()
}

/// Returns the 2.5th and 97.5th percentile of the resampled values.
fn percentiles(mut values: Vec<f64>) -> Option<[f64; 2]> {
    if 2 * values.len() < RESAMPLES {
        return None;
    }
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values[(share * (values.len() - 1) as f64).round() as usize];
    Some([at(0.5 - CONFIDENCE / 2.0), at(0.5 + CONFIDENCE / 2.0)])
}

#[cfg(test)]
mod tests {
    use rand_distr::{Distribution, Normal};

    use super::*;

    fn mean_interval(values: &[f64], seed: u64) -> Option<[f64; 2]> {
        let sum = |drawn: &mut dyn Iterator<Item = &f64>| drawn.fold((0.0, 0), |(s, n), x| (s + x, n + 1));
        intervals(values, seed, sum, |(s, n)| vec![(*n > 0).then(|| s / f64::from(*n))])[0]
    }

    #[test]
    fn intervals_of_a_mean_cover_it_in_95_percent_of_cases() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let normal = Normal::new(3.0, 2.0).unwrap();
        let covered = (0..400).filter(|seed| {
            let values: Vec<f64> = (0..40).map(|_| normal.sample(&mut rng)).collect();
            let [low, high] = mean_interval(&values, *seed).unwrap();
            // Half width of the interval of a normal distribution.
            assert!(((high - low) / 2.0 - 1.96 * 2.0 / 40f64.sqrt()).abs() < 0.4);
            low <= 3.0 && 3.0 <= high
        });
        let covered = covered.count();
        assert!((365..=395).contains(&covered), "{covered} of 400");
    }

    #[test]
    fn the_same_seed_gives_the_same_interval_and_one_episode_none() {
        let values = [1.0, 4.0, 2.0, 8.0];
        assert_eq!(mean_interval(&values, 7), mean_interval(&values, 7));
        assert_eq!(mean_interval(&values[..1], 7), None);
        assert_eq!(mean_interval(&[2.5; 6], 7), Some([2.5, 2.5]));
    }

    #[test]
    fn a_statistic_that_is_mostly_undefined_has_no_interval() {
        // Defined only if the one marked episode is drawn at least twice out of twenty: 26 %.
        let sum = |drawn: &mut dyn Iterator<Item = &bool>| drawn.filter(|marked| **marked).count();
        let episodes: Vec<bool> = (0..20).map(|index| index == 0).collect();
        let rarely = |marked: &usize| vec![(*marked >= 2).then_some(1.0), Some(0.5)];
        assert_eq!(intervals(&episodes, 0, sum, rarely), [None, Some([0.5, 0.5])]);
    }
}
