//! Statistics of a column as LeRobot keeps them: per element, for each episode and for all.

use serde_json::{Map, Value, json};

/// Names and shares of the quantiles that LeRobot expects.
pub const QUANTILES: [(&str, f64); 5] = [("q01", 0.01), ("q10", 0.10), ("q50", 0.50), ("q90", 0.90), ("q99", 0.99)];
/// Largest number of frames per episode from which quantiles are computed, evenly spaced; bounds the memory.
const SAMPLES: usize = 4096;

/// Statistics of one or several episodes; NaN (unknown) does not count.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Statistics {
    /// Number of frames.
    pub count: u64,
    known: Vec<u64>,
    min: Vec<f64>,
    max: Vec<f64>,
    mean: Vec<f64>,
    /// Sum of squared distances from the mean.
    spread: Vec<f64>,
    /// By quantile, then by element.
    quantiles: Vec<Vec<f64>>,
}

/// Collects the frames of one episode.
#[derive(Debug, Clone)]
pub struct EpisodeStatistics {
    so_far: Statistics,
    samples: Vec<f32>,
    every: u64,
}

impl EpisodeStatistics {
    /// Starts an episode of `frames` frames with `width` elements each.
    pub fn new(width: usize, frames: usize) -> Self {
        let so_far = Statistics {
            known: vec![0; width],
            min: vec![f64::INFINITY; width],
            max: vec![f64::NEG_INFINITY; width],
            mean: vec![0.0; width],
            spread: vec![0.0; width],
            ..Statistics::default()
        };
        Self { so_far, samples: Vec::new(), every: frames.div_ceil(SAMPLES).max(1) as u64 }
    }

    /// Adds one frame.
    pub fn push(&mut self, values: &[f32]) {
        let Statistics { count, known, min, max, mean, spread, .. } = &mut self.so_far;
        if count.is_multiple_of(self.every) {
            self.samples.extend_from_slice(values);
        }
        *count += 1;
        for (element, value) in values.iter().enumerate().filter(|(_, value)| !value.is_nan()) {
            let value = f64::from(*value);
            known[element] += 1;
            min[element] = min[element].min(value);
            max[element] = max[element].max(value);
            // Welford's algorithm: exact even if the spread is small against the mean.
            let from_mean = value - mean[element];
            mean[element] += from_mean / known[element] as f64;
            spread[element] += from_mean * (value - mean[element]);
        }
    }

    /// Returns the statistics of the episode.
    pub fn finish(self) -> Statistics {
        let width = self.so_far.known.len();
        let mut quantiles = vec![vec![0.0; width]; QUANTILES.len()];
        let mut column = Vec::new();
        for element in 0..width {
            column.clear();
            column.extend(self.samples.iter().skip(element).step_by(width).filter(|value| !value.is_nan()));
            column.sort_by(f32::total_cmp);
            for (values, (_, share)) in quantiles.iter_mut().zip(QUANTILES) {
                values[element] = quantile(&column, share);
            }
        }
        Statistics { quantiles, ..self.so_far }
    }
}

impl Statistics {
    /// Adds a further episode. The result is exact except for quantiles, which are averaged over the episodes by their
    /// lengths, as in LeRobot.
    pub fn add(&mut self, other: &Self) {
        if self.count == 0 {
            *self = other.clone();
            return;
        }
        for element in 0..self.known.len() {
            let (a, b) = (self.known[element] as f64, other.known[element] as f64);
            self.min[element] = self.min[element].min(other.min[element]);
            self.max[element] = self.max[element].max(other.max[element]);
            if b > 0.0 {
                let apart = other.mean[element] - self.mean[element];
                self.mean[element] += apart * b / (a + b);
                self.spread[element] += other.spread[element] + apart * apart * a * b / (a + b);
                for (values, others) in self.quantiles.iter_mut().zip(&other.quantiles) {
                    values[element] += (others[element] - values[element]) * b / (a + b);
                }
            }
            self.known[element] += other.known[element];
        }
        self.count += other.count;
    }

    /// Returns all numbers as words: counts, and the bits of floats.
    pub fn words(&self) -> Vec<u64> {
        let Self { count, known, min, max, mean, spread, quantiles } = self;
        let mut words = vec![*count, known.len() as u64];
        words.extend(known);
        let floats = [min, max, mean, spread].into_iter().chain(quantiles).flatten();
        words.extend(floats.map(|value| value.to_bits()));
        words
    }

    /// Returns the statistics of the next words; None at their end.
    pub fn from_words(words: &mut impl Iterator<Item = u64>) -> Option<Self> {
        let (count, width) = (words.next()?, words.next()? as usize);
        let known: Vec<u64> = words.by_ref().take(width).collect();
        let mut floats = || words.by_ref().take(width).map(f64::from_bits).collect::<Vec<_>>();
        let [min, max, mean, spread] = std::array::from_fn(|_| floats());
        let quantiles = QUANTILES.iter().map(|_| floats()).collect();
        Some(Self { count, known, min, max, mean, spread, quantiles })
    }

    /// Returns the statistics by name, as the columns `stats/FEATURE/NAME` hold them. Elements that are never known are 0,
    /// so that normalisation in policies meets no NaN.
    pub fn lists(&self) -> Vec<(&'static str, Vec<f64>)> {
        let known = |values: &[f64]| -> Vec<f64> {
            values.iter().zip(&self.known).map(|(value, known)| if *known > 0 { *value } else { 0.0 }).collect()
        };
        let std: Vec<f64> = self
            .spread
            .iter()
            .zip(&self.known)
            .map(|(spread, known)| (spread / (*known).max(1) as f64).sqrt())
            .collect();
        let mut lists = vec![
            ("min", known(&self.min)),
            ("max", known(&self.max)),
            ("mean", known(&self.mean)),
            ("std", known(&std)),
        ];
        lists.extend(QUANTILES.iter().zip(&self.quantiles).map(|((name, _), values)| (*name, known(values))));
        lists
    }

    /// Returns the statistics as `meta/stats.json` holds them.
    pub fn json(&self) -> Value {
        let mut map: Map<String, Value> =
            self.lists().into_iter().map(|(name, values)| (name.into(), json!(values))).collect();
        map.insert("count".into(), json!([self.count]));
        Value::Object(map)
    }
}

/// Returns the quantile of sorted values, interpolated linearly as in numpy; 0 without values.
fn quantile(sorted: &[f32], share: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return 0.0 };
    let place = share * last as f64;
    let (low, high) = (place.floor() as usize, place.ceil() as usize);
    let (a, b) = (f64::from(sorted[low]), f64::from(sorted[high]));
    a + (b - a) * (place - low as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn added_episodes_give_the_statistics_of_the_whole() {
        // Values with known statistics: 0..100 in one episode, 100..300 in the other.
        let part = |range: std::ops::Range<u32>| {
            let mut episode = EpisodeStatistics::new(2, range.len());
            range.for_each(|i| episode.push(&[i as f32, if i % 2 == 0 { f32::NAN } else { 5.0 }]));
            episode.finish()
        };
        let mut all = part(0..100);
        all.add(&part(100..300));
        let whole = part(0..300);
        let (all, whole) = (all.lists(), whole.lists());
        for ((name, sum), (_, direct)) in all.iter().zip(&whole).take(4) {
            assert!(sum.iter().zip(direct).all(|(a, b)| (a - b).abs() < 1e-9), "{name}: {sum:?} {direct:?}");
        }
        assert_eq!(whole[2].1, [149.5, 5.0]);
        // n consecutive numbers have the variance (n² - 1) / 12.
        assert!((whole[3].1[0] - (89_999.0f64 / 12.0).sqrt()).abs() < 1e-9);
        assert!((whole[4].1[0] - 2.99).abs() < 1e-9 && (whole[8].1[0] - 296.01).abs() < 1e-9);
        assert!((all[6].1[0] - (49.5 + 2.0 * 199.5) / 3.0).abs() < 1e-9);
    }

    #[test]
    fn statistics_of_unknown_values_are_zero() {
        let mut episode = EpisodeStatistics::new(1, 3);
        (0..3).for_each(|_| episode.push(&[f32::NAN]));
        assert!(episode.finish().lists().iter().all(|(_, values)| *values == [0.0]));
    }
}
