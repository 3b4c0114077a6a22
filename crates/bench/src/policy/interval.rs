//! 95 % intervals of success rates: Wilson's score interval, and a bootstrap over trainings and trials.

use egotac::statistics::percentile;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// 97.5th percentile of the standard normal distribution.
const Z: f64 = 1.959_963_984_540_054;
/// Resamples of a bootstrap.
const RESAMPLES: usize = 2000;

/// Returns Wilson's 95 % score interval of `successes` of `n` independent trials; `None` without trials.
pub fn wilson(successes: usize, n: usize) -> Option<[f64; 2]> {
    if n == 0 {
        return None;
    }
    let (n, p) = (n as f64, successes as f64 / n as f64);
    let centre = (p + Z * Z / (2.0 * n)) / (1.0 + Z * Z / n);
    let half = Z / (1.0 + Z * Z / n) * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
    Some([(centre - half).max(0.0), (centre + half).min(1.0)])
}

/// Returns the 95 % interval of the mean of `values` (one row per training, one column per trial): trainings and trials are
/// drawn anew with replacement, the trials the same for all trainings, as all trainings are tried on the same.
///
/// `None` without values, or if rows differ in length.
pub fn bootstrap(values: &[Vec<f64>], seed: u64) -> Option<[f64; 2]> {
    let trials = values.first()?.len();
    if trials == 0 || values.iter().any(|row| row.len() != trials) {
        return None;
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let means: Vec<f64> = (0..RESAMPLES)
        .map(|_| {
            let rows: Vec<usize> = (0..values.len()).map(|_| rng.random_range(0..values.len())).collect();
            let columns: Vec<usize> = (0..trials).map(|_| rng.random_range(0..trials)).collect();
            let sum: f64 = rows.iter().map(|row| columns.iter().map(|column| values[*row][*column]).sum::<f64>()).sum();
            sum / (values.len() * trials) as f64
        })
        .collect();
    Some([0.025, 0.975].map(|q| percentile(means.iter().copied(), q)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilsons_intervals_equal_those_of_statsmodels() {
        // statsmodels.stats.proportion.proportion_confint(count, n, method="wilson"), also by the formula in closed form.
        let close = |got: Option<[f64; 2]>, expected: [f64; 2]| {
            let got = got.unwrap();
            assert!(got.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{got:?} {expected:?}");
        };
        close(wilson(0, 10), [0.0, Z * Z / (10.0 + Z * Z)]);
        close(wilson(10, 10), [10.0 / (10.0 + Z * Z), 1.0]);
        close(wilson(50, 100), [0.403_831_53, 0.596_168_47]);
        assert_eq!(wilson(0, 0), None);
    }

    #[test]
    fn a_bootstrap_over_trials_alone_has_the_width_of_the_binomial_distribution() {
        let trials: Vec<f64> = (0..200).map(|i| f64::from(i % 4 == 0)).collect();
        let [low, high] = bootstrap(std::slice::from_ref(&trials), 1).unwrap();
        let expected = 2.0 * Z * (0.25 * 0.75 / 200.0f64).sqrt();
        assert!(((high - low) - expected).abs() < 0.15 * expected, "{low} {high}");
        assert!(low < 0.25 && 0.25 < high);
        // Trainings that differ widen it.
        let all = [trials, vec![1.0; 200], vec![0.0; 200]];
        let [low, high] = bootstrap(&all, 1).unwrap();
        assert!(high - low > 0.5, "{low} {high}");
        assert_eq!(bootstrap(&[vec![1.0; 5], vec![1.0; 4]], 1), None);
    }
}
