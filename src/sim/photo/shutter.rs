//! Rolling shutter: rows of a picture are read one after the other, so that each shows another instant.

/// Returns the weight of each exposure in a row of the picture; they sum to 1.
///
/// The exposures were taken `ages` before the frame's instant, largest first, the last at 0. The last row is read at the
/// frame's instant, the first one `readout` before; each is open for `open` before it is read. All in the same unit of time.
pub(crate) fn row_weights(ages: &[f64], readout: f64, open: f64, row: u32, rows: u32) -> Vec<f64> {
    /// Instants within the time that a row is open.
    const INSTANTS: usize = 8;
    let read = readout * (1.0 - (f64::from(row) + 0.5) / f64::from(rows));
    let mut weights = vec![0.0; ages.len()];
    for k in 0..INSTANTS {
        let age = read + open * (k as f64 + 0.5) / INSTANTS as f64;
        // Between two exposures, each weighs the more the nearer it is.
        let after = ages.iter().position(|other| *other <= age).unwrap_or(ages.len().saturating_sub(1));
        let before = after.saturating_sub(1);
        let span = ages[before] - ages[after];
        let part = if span > 0.0 { ((age - ages[after]) / span).clamp(0.0, 1.0) } else { 0.0 };
        weights[after] += (1.0 - part) / INSTANTS as f64;
        weights[before] += part / INSTANTS as f64;
    }
    weights
}

/// Mixes exposures row by row into one picture; all have `row_length` bytes per row.
pub(crate) fn mix_rows(exposures: &[Vec<u8>], ages: &[f64], readout: f64, open: f64, row_length: usize) -> Vec<f64> {
    let length = exposures.first().map_or(0, Vec::len);
    let rows = (length / row_length.max(1)) as u32;
    let mut mixed = Vec::with_capacity(length);
    for row in 0..rows {
        let weights = row_weights(ages, readout, open, row, rows);
        let start = row as usize * row_length;
        mixed.extend((start..start + row_length).map(|at| {
            exposures.iter().zip(&weights).map(|(exposure, weight)| weight * f64::from(exposure[at])).sum::<f64>()
        }));
    }
    mixed
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_age_of_a_row_is_the_middle_of_the_time_in_which_it_is_open() {
        let ages = [12.0, 8.0, 4.0, 0.0];
        for row in 0..20 {
            let weights = row_weights(&ages, 9.0, 3.0, row, 20);
            let sum: f64 = weights.iter().sum();
            let mean: f64 = weights.iter().zip(ages).map(|(weight, age)| weight * age).sum();
            let expected = 9.0 * (1.0 - (f64::from(row) + 0.5) / 20.0) + 1.5;
            assert!((sum - 1.0).abs() < 1e-12 && (mean - expected).abs() < 1e-9, "row {row}: {mean}, {expected}");
            assert!(weights.iter().all(|weight| *weight >= 0.0));
        }
        // Without a history there is only the exposure at the instant.
        assert_eq!(row_weights(&[0.0], 9.0, 3.0, 0, 20), [1.0]);
    }

    #[test]
    fn a_bar_that_moves_to_the_right_leans_to_the_left_above() {
        // One pixel per unit of time: the bar is at 40 at the frame's instant, at 40 - age before.
        let (width, rows) = (64, 32);
        let ages = [16.0, 8.0, 0.0];
        let shot = |age: f64| -> Vec<u8> {
            let bar = |x: usize| (255.0 - 16.0 * (x as f64 - (40.0 - age)).abs()).clamp(0.0, 255.0) as u8;
            (0..rows).flat_map(|_| (0..width).map(bar)).collect()
        };
        let exposures: Vec<Vec<u8>> = ages.iter().map(|age| shot(*age)).collect();
        let mixed = mix_rows(&exposures, &ages, 16.0, 0.0, width);
        let centre = |row: usize| {
            let values = &mixed[row * width..(row + 1) * width];
            values.iter().enumerate().map(|(x, value)| x as f64 * value).sum::<f64>() / values.iter().sum::<f64>()
        };
        for row in 1..rows {
            assert!(centre(row) > centre(row - 1), "row {row}");
        }
        assert!((centre(rows - 1) - centre(0) - 15.5).abs() < 0.6, "{}", centre(rows - 1) - centre(0));
    }
}
