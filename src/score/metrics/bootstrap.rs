//! Confidence intervals by drawing episodes anew.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Drawings.
pub const DRAWINGS: usize = 1000;
/// Share of the drawings that an interval holds.
pub const LEVEL: f64 = 0.95;

/// The interval that holds 95 % of each statistic when as many episodes as there are get drawn from them with
/// replacement (percentile bootstrap); frames of one episode depend on each other and stay together.
///
/// `sum` adds up a drawing; `statistics` gives the same number of values for each. An interval is None for fewer than two
/// episodes, or where more than half of the drawings leave the statistic undefined. The same seed gives the same bits.
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
    let mut values = vec![Vec::with_capacity(DRAWINGS); count];
    for _ in 0..DRAWINGS {
        let drawn: Vec<usize> = (0..episodes.len()).map(|_| rng.random_range(0..episodes.len())).collect();
        let total = sum(&mut drawn.iter().map(|index| &episodes[*index]));
        for (all, value) in values.iter_mut().zip(statistics(&total)) {
            all.extend(value);
        }
    }
    values.into_iter().map(middle).collect()
}

/// What lies between the outer 2.5 % on each side.
fn middle(mut values: Vec<f64>) -> Option<[f64; 2]> {
    if 2 * values.len() < DRAWINGS {
        return None;
    }
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values[(share * (values.len() - 1) as f64).round() as usize];
    Some([at(0.5 - LEVEL / 2.0), at(0.5 + LEVEL / 2.0)])
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
    fn intervals_of_a_mean_cover_it_nineteen_times_in_twenty() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let normal = Normal::new(3.0, 2.0).unwrap();
        let covered = (0..400).filter(|seed| {
            let values: Vec<f64> = (0..40).map(|_| normal.sample(&mut rng)).collect();
            let [low, high] = mean_interval(&values, *seed).unwrap();
            // The normal interval has this half width.
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
