//! Familiarity of a frame: how common its distance from the training images is among images of the same kind.
//!
//! The feature x of a frame is the mean of its patch tokens after the encoder's last norm, dv numbers. With mean m and
//! covariance C of the features of training frames,
//!
//! ```text
//! C' = C + 0.01 · mean(diag C) · I = L Lᵀ
//! d² = (x - m)ᵀ C'⁻¹ (x - m) = |L⁻¹ (x - m)|²        squared Mahalanobis distance
//! familiarity = share of held-out frames of the training's kind at least as far as d²,
//!               beyond the farthest one: 1/256 · (largest / d²)²
//! ```
//!
//! The shares follow from 257 stored quantiles of d² with linear interpolation. The factor L⁻¹, m and the quantiles are
//! optional tensors of a checkpoint (`familiarity.*`). Mean and CLS token of the encoder are known for each frame anyway, so
//! that the feature costs dv² multiplications a frame.

use std::collections::BTreeMap;
use std::path::Path;

use candle_core::{Device, Tensor};
use nalgebra::{DMatrix, DVector};

use crate::error::{Error, Result};
use crate::statistics::percentile;

/// Prefix of the names of the tensors.
pub const PREFIX: &str = "familiarity.";
/// Number of stored quantiles of the squared distance: a step of 1/256, finer than the two percent of frames of the
/// training's kind that may be called unfamiliar.
pub const QUANTILES: usize = 257;
/// Share of the mean variance that is added to each variance, so that directions without variance don't dominate.
const RIDGE: f64 = 0.01;
/// Number of frames to fit, and to hold out, at least. Fewer say nothing about two percent of frames.
pub const MIN_FRAMES: usize = 32;

/// Statistics of the features of training frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Familiarity {
    /// (dv) mean feature.
    mean: Vec<f32>,
    /// (dv, dv) L⁻¹, lower triangular, row by row.
    factor: Vec<f32>,
    /// (257) quantiles of d² of held-out frames at equal steps from 0 to 1, ascending.
    quantiles: Vec<f32>,
}

impl Familiarity {
    /// Fits mean and covariance to the features of training frames, and quantiles to those of held-out frames. Both:
    /// (N, `width`).
    ///
    /// # Errors
    /// If one of them has fewer than 32 frames, or features do not vary at all.
    pub fn fit(width: usize, training: &[f32], held_out: &[f32]) -> Result<Self> {
        for (name, features) in [("training frames", training), ("held-out frames", held_out)] {
            let frames = features.len() / width;
            if frames < MIN_FRAMES {
                return Err(Error::value(name, format!("at least {MIN_FRAMES}, to measure familiarity"), frames));
            }
        }
        let n = (training.len() / width) as f64;
        let mut mean = DVector::<f64>::zeros(width);
        for feature in training.chunks_exact(width) {
            mean.iter_mut().zip(feature).for_each(|(sum, x)| *sum += f64::from(*x) / n);
        }
        let mut covariance = DMatrix::<f64>::zeros(width, width);
        for feature in training.chunks_exact(width) {
            let centred = DVector::from_iterator(width, feature.iter().zip(&mean).map(|(x, m)| f64::from(*x) - m));
            covariance.ger(1.0 / n, &centred, &centred, 1.0);
        }
        let ridge = RIDGE * covariance.trace() / width as f64;
        (0..width).for_each(|i| covariance[(i, i)] += ridge);
        // Rounding alone leaves a tiny variance in equal features.
        let least = f64::EPSILON * (mean.norm_squared() / width as f64);
        let inverse = covariance.cholesky().filter(|_| ridge > least).and_then(|cholesky| {
            let mut inverse = DMatrix::<f64>::identity(width, width);
            cholesky.l().solve_lower_triangular_mut(&mut inverse).then_some(inverse)
        });
        let Some(inverse) = inverse else {
            return Err(Error::value("features of the training frames", "features that differ", "equal ones"));
        };
        let mut fitted = Self {
            mean: mean.iter().map(|x| *x as f32).collect(),
            // nalgebra stores columns: the transpose's columns are the rows.
            factor: inverse.transpose().iter().map(|x| *x as f32).collect(),
            quantiles: vec![0.0; QUANTILES],
        };
        let distances: Vec<f64> =
            held_out.chunks_exact(width).map(|feature| f64::from(fitted.squared_distance(feature))).collect();
        let steps = (QUANTILES - 1) as f64;
        for (i, quantile) in fitted.quantiles.iter_mut().enumerate() {
            *quantile = percentile(distances.iter().copied(), i as f64 / steps) as f32;
        }
        Ok(fitted)
    }

    /// Returns the squared Mahalanobis distance d² of a feature, (dv).
    pub fn squared_distance(&self, feature: &[f32]) -> f32 {
        let width = self.mean.len();
        let centred: Vec<f32> = feature.iter().zip(&self.mean).map(|(x, m)| x - m).collect();
        let mut sum = 0.0;
        for (row, factor) in self.factor.chunks_exact(width).enumerate() {
            let product: f32 = factor[..=row].iter().zip(&centred).map(|(l, x)| l * x).sum();
            sum += product * product;
        }
        sum
    }

    /// Returns the familiarity of a frame with this feature, (dv): 0 to 1, falling with the distance.
    pub fn of(&self, feature: &[f32]) -> f32 {
        self.at(self.squared_distance(feature))
    }

    /// Returns the familiarity at a squared distance: 1 up to the nearest held-out frame.
    pub fn at(&self, squared_distance: f32) -> f32 {
        let steps = (QUANTILES - 1) as f32;
        let tail = 1.0 / steps;
        let (nearest, farthest) = (self.quantiles[0], self.quantiles[QUANTILES - 1]);
        if squared_distance.is_nan() || squared_distance > farthest {
            // NaN comes from an overflow: infinitely far.
            let ratio = farthest / squared_distance;
            return if ratio.is_nan() { 0.0 } else { tail * ratio * ratio };
        }
        if squared_distance <= nearest {
            return 1.0;
        }
        let above = self.quantiles.partition_point(|quantile| *quantile < squared_distance).min(QUANTILES - 1);
        let (low, high) = (self.quantiles[above - 1], self.quantiles[above]);
        let place = (above - 1) as f32 + (squared_distance - low) / (high - low);
        1.0 - (1.0 - tail) * place / steps
    }

    /// Returns the tensors by name, f32 on the CPU.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn tensors(&self) -> Result<BTreeMap<String, Tensor>> {
        let width = self.mean.len();
        let tensor = |values: &[f32], shape: &[usize]| Tensor::from_slice(values, shape, &Device::Cpu);
        Ok(BTreeMap::from([
            (format!("{PREFIX}mean"), tensor(&self.mean, &[width])?),
            (format!("{PREFIX}factor"), tensor(&self.factor, &[width, width])?),
            (format!("{PREFIX}quantiles"), tensor(&self.quantiles, &[QUANTILES])?),
        ]))
    }

    /// Returns names and shapes of the tensors for features of `width` numbers.
    pub(super) fn shapes(width: usize) -> BTreeMap<String, Vec<usize>> {
        let named = [("mean", vec![width]), ("factor", vec![width, width]), ("quantiles", vec![QUANTILES])];
        named.into_iter().map(|(name, shape)| (format!("{PREFIX}{name}"), shape)).collect()
    }

    /// Takes the statistics from the tensors of a checkpoint, whose shapes are checked; None if it has none.
    ///
    /// # Errors
    /// If the quantiles are negative or fall, or the farthest one is 0.
    pub(super) fn from_tensors(path: &Path, tensors: &BTreeMap<String, Tensor>) -> Result<Option<Self>> {
        let values = |name: &str| -> Result<Option<Vec<f32>>> {
            let tensor = tensors.get(&format!("{PREFIX}{name}"));
            tensor.map(|tensor| Ok(tensor.flatten_all()?.to_vec1::<f32>()?)).transpose()
        };
        let (Some(mean), Some(factor), Some(quantiles)) = (values("mean")?, values("factor")?, values("quantiles")?)
        else {
            return Ok(None);
        };
        let ascending = quantiles.is_sorted() && quantiles.first().is_some_and(|first| *first >= 0.0);
        if !ascending || quantiles.last().is_none_or(|last| *last <= 0.0) {
            let message = format!("{PREFIX}quantiles: expected numbers from 0 on that never fall and end above 0");
            return Err(Error::file(path, message));
        }
        Ok(Some(Self { mean, factor, quantiles }))
    }
}

/// Returns the feature of each frame, (N, dv): the mean of its patch tokens. `tokens`: (N, P, dv), CLS first.
pub(crate) fn features(tokens: &[f32], n_tokens: usize, width: usize) -> Vec<f32> {
    let mut features = Vec::with_capacity(tokens.len() / n_tokens);
    for frame in tokens.chunks_exact(n_tokens * width) {
        let start = features.len();
        features.resize(start + width, 0.0f32);
        let feature = &mut features[start..];
        for patch in frame.chunks_exact(width).skip(1) {
            feature.iter_mut().zip(patch).for_each(|(sum, x)| *sum += x);
        }
        feature.iter_mut().for_each(|sum| *sum /= (n_tokens - 1) as f32);
    }
    features
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;

    const WIDTH: usize = 6;

    /// Correlated Gaussian features, (n, 6).
    fn gaussian(n: usize, seed: u64) -> Vec<f32> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut out = Vec::new();
        for _ in 0..n {
            let common: f32 = random.sample(StandardNormal);
            out.extend((0..WIDTH).map(|i| {
                let own: f32 = random.sample(StandardNormal);
                1.0 + i as f32 * 0.5 + common + (0.5 + 0.2 * i as f32) * own
            }));
        }
        out
    }

    #[test]
    fn the_distance_is_that_of_the_inverted_covariance() {
        let training = gaussian(500, 1);
        let fitted = Familiarity::fit(WIDTH, &training, &gaussian(100, 2)).unwrap();
        // Another route: covariance from sums of products, a general inverse, the quadratic form.
        let data = DMatrix::from_row_iterator(500, WIDTH, training.iter().map(|x| f64::from(*x)));
        let mean = data.row_mean();
        let second = data.transpose() * &data / 500.0;
        let covariance = second - mean.transpose() * &mean;
        let ridge = 0.01 * covariance.trace() / WIDTH as f64;
        let inverse = (covariance + ridge * DMatrix::identity(WIDTH, WIDTH)).try_inverse().unwrap();
        for feature in gaussian(20, 3).chunks_exact(WIDTH) {
            let x = DVector::from_iterator(WIDTH, feature.iter().map(|x| f64::from(*x))) - mean.transpose();
            let expected = (x.transpose() * &inverse * &x)[0];
            let got = f64::from(fitted.squared_distance(feature));
            assert!((got - expected).abs() <= 1e-4 * expected, "{got}, expected {expected}");
        }
    }

    #[test]
    fn familiarity_is_the_share_of_held_out_frames_at_least_as_far() {
        let held_out = gaussian(2000, 5);
        let fitted = Familiarity::fit(WIDTH, &gaussian(2000, 4), &held_out).unwrap();
        let mut distances: Vec<f32> = held_out.chunks_exact(WIDTH).map(|x| fitted.squared_distance(x)).collect();
        distances.sort_by(f32::total_cmp);
        for rank in [1, 200, 1000, 1700, 1990] {
            let share = (2000 - rank) as f32 / 2000.0;
            let got = fitted.at(distances[rank]);
            assert!((got - share).abs() < 0.006, "rank {rank}: {got}, expected {share}");
        }
        assert_eq!(fitted.at(0.0), 1.0);
    }

    #[test]
    fn familiarity_falls_without_end_and_stays_within_0_to_1() {
        let fitted = Familiarity::fit(WIDTH, &gaussian(300, 6), &gaussian(300, 7)).unwrap();
        let mut before = f32::INFINITY;
        for i in 0..4000 {
            let now = fitted.at(1e-3 * 1.006f32.powi(i));
            assert!((0.0..=1.0).contains(&now) && now <= before, "{now} after {before}");
            before = now;
        }
        let largest = fitted.quantiles[QUANTILES - 1];
        assert!(fitted.at(2.0 * largest) < fitted.at(largest) && fitted.at(4.0 * largest) > 0.0);
        assert_eq!([f32::INFINITY, f32::NAN].map(|far| fitted.at(far)), [0.0, 0.0]);
    }

    #[test]
    fn equal_held_out_frames_give_a_step() {
        let one = gaussian(1, 8);
        let fitted = Familiarity::fit(WIDTH, &gaussian(300, 6), &one.repeat(MIN_FRAMES)).unwrap();
        let there = fitted.squared_distance(&one);
        assert_eq!((fitted.at(there), fitted.at(0.5 * there)), (1.0, 1.0));
        assert!(fitted.at(1.01 * there) < 1.0 / 256.0);
    }

    #[test]
    fn too_few_or_equal_frames_are_refused() {
        let some = gaussian(40, 9);
        let error = Familiarity::fit(WIDTH, &some, &gaussian(31, 1)).unwrap_err().to_string();
        assert!(error.contains("held-out frames: expected at least 32") && error.contains("got 31"), "{error}");
        let error = Familiarity::fit(WIDTH, &[0.5; 40 * WIDTH], &some).unwrap_err().to_string();
        assert!(error.contains("features of the training frames"), "{error}");
    }

    #[test]
    fn tensors_of_a_fit_give_the_same_statistics() {
        let fitted = Familiarity::fit(WIDTH, &gaussian(300, 6), &gaussian(300, 7)).unwrap();
        let tensors = fitted.tensors().unwrap();
        assert_eq!(super::super::shapes::of_tensors(&tensors), Familiarity::shapes(WIDTH));
        assert_eq!(Familiarity::from_tensors(Path::new("a"), &tensors).unwrap(), Some(fitted.clone()));
        assert_eq!(Familiarity::from_tensors(Path::new("a"), &BTreeMap::new()).unwrap(), None);
        let fallen = Familiarity { quantiles: fitted.quantiles.iter().rev().copied().collect(), ..fitted };
        let error = Familiarity::from_tensors(Path::new("a"), &fallen.tensors().unwrap()).unwrap_err().to_string();
        assert!(error.contains("familiarity.quantiles"), "{error}");
    }

    #[test]
    fn the_feature_is_the_mean_of_the_patch_tokens_without_cls() {
        let tokens: Vec<f32> =
            vec![9.0, 9.0, 1.0, 2.0, 3.0, 6.0, /* second frame */ 0.0, 0.0, -1.0, 1.0, 1.0, 1.0];
        assert_eq!(features(&tokens, 3, 2), [2.0, 4.0, 0.0, 1.0]);
    }
}
