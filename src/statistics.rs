//! Percentiles of measured values.

/// Computes percentile `q` (0 to 1) by linear interpolation between the closest ranks, as `numpy.percentile` does by
/// default.
///
/// Returns NaN if there are no values. NaN among the values counts as the largest.
pub fn percentile(values: impl IntoIterator<Item = f64>, q: f64) -> f64 {
    let mut sorted: Vec<f64> = values.into_iter().collect();
    sorted.sort_by(f64::total_cmp);
    let rank = q.clamp(0.0, 1.0) * sorted.len().saturating_sub(1) as f64;
    let (below, above) = (rank.floor() as usize, rank.ceil() as usize);
    match (sorted.get(below), sorted.get(above)) {
        (Some(low), Some(high)) => low + (high - low) * rank.fract(),
        _ => f64::NAN,
    }
}

/// Computes the median: percentile 0.5, so the mean of the two middle values of an even count.
pub fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    percentile(values, 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_equal_numpys() {
        // numpy.percentile([3, 1, 4, 1, 5, 9, 2, 6], [0, 25, 50, 90, 95, 99, 100])
        let values = [3.0, 1.0, 4.0, 1.0, 5.0, 9.0, 2.0, 6.0];
        let expected = [(0.0, 1.0), (0.25, 1.75), (0.5, 3.5), (0.9, 6.9), (0.95, 7.95), (0.99, 8.79), (1.0, 9.0)];
        for (q, expected) in expected {
            assert!((percentile(values, q) - expected).abs() < 1e-12, "{q}");
        }
        assert_eq!(median(values), 3.5);
    }

    #[test]
    fn one_value_is_every_percentile_and_none_is_nan() {
        assert_eq!([0.0, 0.37, 1.0].map(|q| percentile([2.0], q)), [2.0; 3]);
        assert!(percentile([], 0.5).is_nan() && median([]).is_nan());
    }
}
