//! Predicted spread of forces: the interval that holds nine of ten true forces, given the predicted one.
//!
//! On frames with truth, predictions are sorted by size and cut into bins of equal count. A bin's centre is its median
//! prediction, its interval is the shortest one that holds nine of ten truths. Between centres the bounds are
//! interpolated linearly; beyond the last one they grow in proportion to the prediction. One table is for the force of a
//! vertex, one for the total force of a hand. They are optional tensors of a checkpoint (`spread.*`).
//!
//! Most predictions are almost zero, and so are their truths: below [`LEAST_N`] all predictions share one bin, whose interval
//! may be the point 0 and hold more than nine of ten truths.

use std::collections::BTreeMap;
use std::path::Path;

use candle_core::{Device, Tensor};

use crate::error::{Error, Result};
use crate::statistics::percentile;

/// Prefix of the names of the tensors.
pub const PREFIX: &str = "spread.";
/// Probability that the interval holds the truth.
pub const LEVEL: f64 = 0.9;
/// Predicted force below which all predictions share one bin, N: a fifth of the force that counts as contact.
pub const LEAST_N: f32 = 0.01;
/// Number of bins of a table.
const BINS: usize = 24;
/// Predictions of a bin, at least, so that three of them lie beyond its interval.
const MIN_OF_BIN: usize = 30;
/// Predictions of at least [`LEAST_N`] that a table is fitted to, at least: three bins.
pub const MIN_PREDICTIONS: usize = 3 * MIN_OF_BIN;

/// Intervals of the force of a vertex and of the total force of a hand, given the prediction.
#[derive(Debug, Clone, PartialEq)]
pub struct Spread {
    /// Of the force of a vertex.
    pub vertex: Intervals,
    /// Of the total force of a hand.
    pub total: Intervals,
}

/// Interval of the true force by the predicted force.
#[derive(Debug, Clone, PartialEq)]
pub struct Intervals {
    /// (24) centres of the bins, N, ascending.
    predicted: Vec<f32>,
    /// (24) lower bounds of the truths, N.
    low: Vec<f32>,
    /// (24) upper bounds of the truths, N.
    high: Vec<f32>,
}

impl Intervals {
    /// Fits the table to pairs of predicted and true force, N.
    ///
    /// # Errors
    /// If fewer than 90 predictions are at least 0.01 N.
    pub fn fit(name: &str, mut pairs: Vec<[f32; 2]>) -> Result<Self> {
        pairs.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let (near_zero, above) = pairs.split_at(pairs.partition_point(|pair| pair[0] < LEAST_N));
        if above.len() < MIN_PREDICTIONS {
            let expected = format!("at least {MIN_PREDICTIONS} predictions of {LEAST_N} N or more");
            return Err(Error::value(format!("{name}, to measure the spread"), expected, above.len()));
        }
        let row = |bin: &[[f32; 2]]| -> [f32; 3] {
            let [low, high] = shortest(bin.iter().map(|pair| pair[1]).collect());
            [percentile(bin.iter().map(|pair| f64::from(pair[0])), 0.5) as f32, low, high]
        };
        let bins = (above.len() / MIN_OF_BIN).min(BINS - 1);
        let bounds = (0..=bins).map(|i| i * above.len() / bins);
        let mut rows: Vec<[f32; 3]> =
            bounds.clone().zip(bounds.skip(1)).map(|(start, end)| row(&above[start..end])).collect();
        // Equal predictions in two bins would leave no place to interpolate at.
        for i in 1..bins {
            rows[i][0] = rows[i][0].max(rows[i - 1][0] * (1.0 + 1e-5));
        }
        let first = match near_zero {
            [] => [0.0; 3],
            bin => [0.0, row(bin)[1], row(bin)[2]],
        };
        let all: Vec<[f32; 3]> = std::iter::once(first).chain(refined(&rows)).collect();
        let [predicted, low, high] = [0, 1, 2].map(|column| all.iter().map(|row| row[column]).collect());
        Ok(Self { predicted, low, high })
    }

    /// Returns the lower and upper bound at a predicted force, N; NaN where it is unknown.
    pub fn at(&self, predicted: f32) -> [f32; 2] {
        if predicted.is_nan() {
            return [f32::NAN; 2];
        }
        if predicted < LEAST_N {
            return [self.low[0], self.high[0]];
        }
        let above = self.predicted.partition_point(|centre| *centre < predicted);
        if above == BINS {
            let factor = predicted / self.predicted[BINS - 1];
            return [factor * self.low[BINS - 1], factor * self.high[BINS - 1]];
        }
        // From the bin of small predictions on, the first bin above it holds.
        let before = above.max(2) - 1;
        let (from, to) = (self.predicted[before], self.predicted[before + 1]);
        let share = ((predicted - from) / (to - from)).clamp(0.0, 1.0);
        let between = |values: &[f32]| values[before] + share * (values[before + 1] - values[before]);
        [between(&self.low), between(&self.high)]
    }

    /// Returns the table, (3, 24): centres, lower, upper bounds.
    fn tensor(&self) -> Result<Tensor> {
        let values = [&self.predicted[..], &self.low, &self.high].concat();
        Ok(Tensor::from_vec(values, (3, BINS), &Device::Cpu)?)
    }

    fn from_tensor(path: &Path, name: &str, tensor: &Tensor) -> Result<Self> {
        let values = tensor.flatten_all()?.to_vec1::<f32>()?;
        let [predicted, low, high] = [0, 1, 2].map(|row| values[row * BINS..(row + 1) * BINS].to_vec());
        let ascending = predicted.is_sorted_by(|a, b| a < b) && predicted[0] >= 0.0;
        let ordered = low.iter().zip(&high).all(|(low, high)| (0.0..=*high).contains(low));
        match ascending && ordered {
            true => Ok(Self { predicted, low, high }),
            false => {
                let expected = "expected predictions that rise from 0 on, and bounds 0 <= low <= high";
                Err(Error::file(path, format!("{PREFIX}{name}: {expected}")))
            }
        }
    }
}

/// Returns the shortest interval that holds nine of ten of these values and of one more: where more than a tenth are 0, it begins
/// at 0.
fn shortest(mut values: Vec<f32>) -> [f32; 2] {
    values.sort_by(f32::total_cmp);
    let n = values.len();
    let held = ((LEVEL * (n + 1) as f64).ceil() as usize).clamp(1, n);
    let width = |start: &usize| values[start + held - 1] - values[*start];
    let start = (0..=n - held).min_by(|a, b| width(a).total_cmp(&width(b))).unwrap_or(0);
    [values[start], values[start + held - 1]]
}

/// Returns 23 rows of centre, low and high: those given, or as many between the first and the last of fewer.
fn refined(rows: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let last = rows.len() - 1;
    let at = |i: usize| {
        let place = i as f32 / (BINS - 2) as f32 * last as f32;
        let before = (place as usize).min(last.saturating_sub(1));
        let share = place - before as f32;
        std::array::from_fn(|column| {
            rows[before][column] + share * (rows[(before + 1).min(last)][column] - rows[before][column])
        })
    };
    if rows.len() == BINS - 1 { rows.to_vec() } else { (0..BINS - 1).map(at).collect() }
}

impl Spread {
    /// Returns the tensors by name, f32 on the CPU.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn tensors(&self) -> Result<BTreeMap<String, Tensor>> {
        let named = [("vertex", &self.vertex), ("total", &self.total)];
        named.into_iter().map(|(name, table)| Ok((format!("{PREFIX}{name}"), table.tensor()?))).collect()
    }

    /// Returns names and shapes of the tensors.
    pub(super) fn shapes() -> BTreeMap<String, Vec<usize>> {
        ["vertex", "total"].into_iter().map(|name| (format!("{PREFIX}{name}"), vec![3, BINS])).collect()
    }

    /// Takes the tables from the tensors of a checkpoint, whose shapes are checked; None if it has none.
    ///
    /// # Errors
    /// If the predictions of a table do not rise, or a lower bound is negative or above its upper one.
    pub(super) fn from_tensors(path: &Path, tensors: &BTreeMap<String, Tensor>) -> Result<Option<Self>> {
        let table = |name: &str| -> Result<Option<Intervals>> {
            let tensor = tensors.get(&format!("{PREFIX}{name}"));
            tensor.map(|tensor| Intervals::from_tensor(path, name, tensor)).transpose()
        };
        Ok(table("vertex")?.zip(table("total")?).map(|(vertex, total)| Self { vertex, total }))
    }
}
