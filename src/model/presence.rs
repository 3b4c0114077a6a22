//! Presence and keypoints of both hands in one image, from the encoder's tokens.
//!
//! With the patch tokens t_p, p = 1 .. P - 1, and the CLS token c, dv numbers each:
//!
//! ```text
//! h_p          = max(0, W t_p + b)                              32 features of a patch
//! presence_s   = σ(u_s · [max_p h_p, mean_p h_p] + v_s)         of hand s
//! l_kp, l_k0   = w_k · t_p + b_k,  n_k · c + m_k                logits of keypoint k: in patch p, nowhere in the image
//! q_k          = softmax(l_k)
//! place_k      = centre of the patch p* with the largest q_kp + (o_k · t_p* + r_k) sides of a patch
//! confidence_k = presence_s · sum of q_kp over p* and its eight neighbours
//! ```
//!
//! The weights are optional tensors of a checkpoint (`presence.*`), fitted to tokens of a network whose other weights stay as
//! they are. The product of all patches with W and w costs 74 dv multiplications per patch.

use std::collections::BTreeMap;

use candle_core::{Device, Tensor};
use egotac_kernels::activations::Activations;
use egotac_kernels::packed::{Format, Packed, Then};
use egotac_kernels::rows::Rows;
use egotac_kernels::{simd, team};

use super::heads::probability;
use crate::error::{Error, Result};
use crate::hand::N_KEYPOINTS;
use crate::image::Preparation;

/// Prefix of the names of the tensors.
pub const PREFIX: &str = "presence.";
/// Features of a patch that presence is computed from.
pub const FEATURES: usize = 32;
/// Keypoints of both hands, the left hand's first.
pub const N_POINTS: usize = 2 * N_KEYPOINTS;
/// Outputs of the product of the patches: features, then keypoints.
const PATCH_OUTPUTS: usize = FEATURES + N_POINTS;

/// Estimate of one hand in an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandEstimate {
    /// Probability that the hand is in the image, 0 to 1.
    pub presence: f32,
    /// Wrist, then thumb, index, middle, ring and little finger, each from base to tip.
    pub keypoints: [Keypoint; N_KEYPOINTS],
}

/// Estimate of a keypoint in an image.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Keypoint {
    /// Position as shares of the sides of the network's square input, x to the right, y down.
    pub place: [f32; 2],
    /// Confidence that the keypoint is in the image, within a patch of this place, 0 to 1.
    pub confidence: f32,
}

impl Keypoint {
    /// Returns the position in an image of this size that was prepared by `preparation`, pixels.
    pub fn pixel(&self, preparation: &Preparation, width: usize, height: usize) -> [f64; 2] {
        preparation.pixel(self.place.map(f64::from), width, height)
    }
}

/// Weight and bias of a linear layer: `(n, dv)` row by row, and `(n)`.
#[derive(Debug, Clone, PartialEq)]
struct Layer {
    weight: Vec<f32>,
    bias: Vec<f32>,
}

/// Weights that estimate presence and keypoints.
#[derive(Debug, Clone)]
pub struct Presence {
    width: usize,
    /// Features and keypoints of a patch: (74, dv).
    patch: Packed,
    /// Presence: (2, 64).
    hand: Layer,
    /// Logits that a keypoint is nowhere: (42, dv).
    nowhere: Layer,
    /// Offsets of x and y of each keypoint: (84, dv).
    offset: Layer,
}

/// Layers by name, with number of outputs.
const LAYERS: [(&str, usize); 5] =
    [("features", FEATURES), ("hand", 2), ("keypoints", N_POINTS), ("nowhere", N_POINTS), ("offset", 2 * N_POINTS)];

impl Presence {
    /// Returns names and shapes of the tensors for tokens of `width` numbers.
    pub fn shapes(width: usize) -> BTreeMap<String, Vec<usize>> {
        let of = |(name, n): (&str, usize)| {
            let inputs = if name == "hand" { 2 * FEATURES } else { width };
            [(format!("{PREFIX}{name}.weight"), vec![n, inputs]), (format!("{PREFIX}{name}.bias"), vec![n])]
        };
        LAYERS.into_iter().flat_map(of).collect()
    }

    /// Takes the weights from tensors by name; None if one is missing.
    ///
    /// # Errors
    /// If a tensor has another shape than in [`Presence::shapes`].
    pub fn from_weights(tensors: &BTreeMap<String, Tensor>) -> Result<Option<Self>> {
        if let Some(weight) = tensors.get(&format!("{PREFIX}features.weight")) {
            let expected = Self::shapes(weight.dims().last().copied().unwrap_or(0));
            for (name, shape) in expected {
                if let Some(tensor) = tensors.get(&name).filter(|tensor| tensor.dims() != shape) {
                    return Err(Error::shape(&name, format!("{shape:?}"), tensor.dims()));
                }
            }
        }
        Self::from_tensors(tensors)
    }

    /// Takes the weights from the tensors of a checkpoint, whose shapes are checked; None if it has none.
    ///
    /// # Errors
    /// If memory runs out.
    pub(super) fn from_tensors(tensors: &BTreeMap<String, Tensor>) -> Result<Option<Self>> {
        let values = |name: &str| -> Result<Option<Vec<f32>>> {
            let tensor = tensors.get(&format!("{PREFIX}{name}"));
            tensor.map(|tensor| Ok(tensor.to_device(&Device::Cpu)?.flatten_all()?.to_vec1::<f32>()?)).transpose()
        };
        let layer = |name: &str| -> Result<Option<Layer>> {
            let pair = values(&format!("{name}.weight"))?.zip(values(&format!("{name}.bias"))?);
            Ok(pair.map(|(weight, bias)| Layer { weight, bias }))
        };
        let [Some(features), Some(hand), Some(keypoints), Some(nowhere), Some(offset)] =
            [layer("features")?, layer("hand")?, layer("keypoints")?, layer("nowhere")?, layer("offset")?]
        else {
            return Ok(None);
        };
        let width = features.weight.len() / FEATURES;
        let patch = Packed::new(
            &[features.weight, keypoints.weight].concat(),
            [features.bias, keypoints.bias].concat(),
            Format::F32,
        );
        Ok(Some(Self { width, patch, hand, nowhere, offset }))
    }

    /// Estimates the left and the right hand of a frame. `tokens`: (P, dv), CLS first; the patches form a square.
    pub fn of(&self, tokens: &[f32]) -> [HandEstimate; 2] {
        let (cls, patches) = tokens.split_at(self.width);
        let n_patches = patches.len() / self.width;
        let mut outputs = vec![0.0; n_patches * PATCH_OUTPUTS];
        team::lead(|| {
            let rows = Rows::new(patches, self.width);
            self.patch.forward(rows, &mut outputs, PATCH_OUTPUTS, Then::Store, &mut Activations::default());
        });
        let pooled = pool(&outputs, n_patches);
        let presence = [0, 1].map(|hand| probability(self.hand.output(hand, &pooled)));
        let shares = Shares::new(&outputs, |keypoint| self.nowhere.output(keypoint, cls));
        let grid = n_patches.isqrt();
        let keypoint = |hand: usize, index: usize| {
            let point = hand * N_KEYPOINTS + index;
            let best = shares.best[point];
            let token = &patches[best * self.width..(best + 1) * self.width];
            let place = std::array::from_fn(|axis| {
                let cell = if axis == 0 { best % grid } else { best / grid };
                (cell as f32 + 0.5 + self.offset.output(2 * point + axis, token)) / grid as f32
            });
            let near = |cell: usize, at: usize| cell.abs_diff(at) <= 1;
            let beside = |patch: &usize| near(patch % grid, best % grid) && near(patch / grid, best / grid);
            let share: f32 = (0..n_patches).filter(beside).map(|patch| shares.of(&outputs, patch, point)).sum();
            Keypoint { place, confidence: presence[hand] * share.min(1.0) }
        };
        [0, 1].map(|hand| HandEstimate {
            presence: presence[hand],
            keypoints: std::array::from_fn(|index| keypoint(hand, index)),
        })
    }
}

impl Layer {
    /// Returns one output for an input, (k).
    fn output(&self, index: usize, x: &[f32]) -> f32 {
        let row = &self.weight[index * x.len()..(index + 1) * x.len()];
        simd::dispatch(
            #[inline(always)]
            || simd::dot(row, x),
        ) + self.bias[index]
    }
}

/// Returns the largest and the mean value of each feature over the patches, (64), of features that are at least 0.
fn pool(outputs: &[f32], n_patches: usize) -> [f32; 2 * FEATURES] {
    let mut pooled = [0.0; 2 * FEATURES];
    let (largest, mean) = pooled.split_at_mut(FEATURES);
    for row in outputs.chunks_exact(PATCH_OUTPUTS) {
        for ((largest, mean), value) in largest.iter_mut().zip(mean.iter_mut()).zip(&row[..FEATURES]) {
            *largest = f32::max(*largest, *value);
            *mean += value.max(0.0);
        }
    }
    mean.iter_mut().for_each(|mean| *mean /= n_patches as f32);
    pooled
}

/// Softmax of each keypoint over the patches and `nowhere`.
struct Shares {
    /// Patch with the largest logit.
    best: [usize; N_POINTS],
    /// Largest logit, that of `nowhere` included.
    largest: [f32; N_POINTS],
    /// Sum of the exponentials of logits less the largest one.
    sum: [f32; N_POINTS],
}

impl Shares {
    /// Computes the sums. `outputs`: (P - 1, 74).
    fn new(outputs: &[f32], nowhere: impl Fn(usize) -> f32) -> Self {
        let nowhere: [f32; N_POINTS] = std::array::from_fn(nowhere);
        let rows = || outputs.chunks_exact(PATCH_OUTPUTS).map(|row| &row[FEATURES..]);
        let (mut best, mut found) = ([0; N_POINTS], [f32::NEG_INFINITY; N_POINTS]);
        for (patch, row) in rows().enumerate() {
            for ((best, found), logit) in best.iter_mut().zip(&mut found).zip(row) {
                if logit > found {
                    (*best, *found) = (patch, *logit);
                }
            }
        }
        let largest: [f32; N_POINTS] = std::array::from_fn(|point| found[point].max(nowhere[point]));
        let mut sum = [0.0; N_POINTS];
        simd::dispatch(
            #[inline(always)]
            || {
                for row in rows().chain(std::iter::once(&nowhere[..])) {
                    for ((sum, logit), largest) in sum.iter_mut().zip(row).zip(&largest) {
                        *sum += simd::exp(logit - largest);
                    }
                }
            },
        );
        Self { best, largest, sum }
    }

    /// Returns the share of a patch.
    fn of(&self, outputs: &[f32], patch: usize, point: usize) -> f32 {
        (outputs[patch * PATCH_OUTPUTS + FEATURES + point] - self.largest[point]).exp() / self.sum[point]
    }
}
