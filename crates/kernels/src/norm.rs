//! Layer norm of rows.

use crate::activations::{Activations, Form};
use crate::ops::statistics;
use crate::rows::Rows;
use crate::{simd, team};

/// Values that one task normalises: 64 KiB, small against a cache and far more work than a task costs.
const VALUES_PER_TASK: usize = 16_384;

/// A layer norm with weight and bias.
#[derive(Debug, Clone)]
pub struct Norm {
    weight: Vec<f32>,
    bias: Vec<f32>,
    eps: f32,
}

impl Norm {
    /// Creates a layer norm from weight and bias, `(d)` each; `eps` is added to the variance.
    pub fn new(weight: Vec<f32>, bias: Vec<f32>, eps: f32) -> Self {
        Self { weight, bias, eps }
    }

    /// Width of a row.
    pub fn d(&self) -> usize {
        self.weight.len()
    }

    /// Normalises the rows of `x` into `out`, whose rows have no gaps.
    pub fn forward(&self, x: Rows, out: &mut [f32]) {
        let d = self.d();
        let rows = (VALUES_PER_TASK / d).max(1);
        team::chunks(&mut out[..x.count * d], rows * d, |block, out| {
            for (i, out) in out.chunks_exact_mut(d).enumerate() {
                let first = (block * rows + i) * x.stride;
                self.row(&x.data[first..first + d], out);
            }
        });
    }

    /// Normalises the rows of `x` into rows of the form in which a layer reads them.
    pub fn apply_into(&self, x: Rows, out: &mut Activations, form: Form) {
        let d = self.d();
        out.fill(form, x.count, d, |row, out| self.row(&x.data[row * x.stride..][..d], out));
    }

    /// Normalises the sum of a row and `shift`.
    pub fn shifted_row(&self, x: &[f32], shift: &[f32], out: &mut [f32]) {
        simd::dispatch(
            #[inline(always)]
            || {
                for ((out, x), shift) in out.iter_mut().zip(x).zip(shift) {
                    *out = x + shift;
                }
                let (mean, inverse) = statistics(out, self.eps);
                for ((out, w), b) in out.iter_mut().zip(&self.weight).zip(&self.bias) {
                    *out = ((*out - mean) * inverse).mul_add(*w, *b);
                }
            },
        );
    }

    /// Normalises one row.
    pub fn row(&self, x: &[f32], out: &mut [f32]) {
        simd::dispatch(
            #[inline(always)]
            || {
                let (mean, inverse) = statistics(x, self.eps);
                for (((out, x), w), b) in out.iter_mut().zip(x).zip(&self.weight).zip(&self.bias) {
                    *out = ((x - mean) * inverse).mul_add(*w, *b);
                }
            },
        );
    }
}

/// Normalises a row, scales it by 1 + γ and shifts it by β: the adaptive layer norm (AdaLN).
pub fn modulated(x: &[f32], gamma: &[f32], beta: &[f32], eps: f32, out: &mut [f32]) {
    simd::dispatch(
        #[inline(always)]
        || {
            let (mean, inverse) = statistics(x, eps);
            for (((out, x), gamma), beta) in out.iter_mut().zip(x).zip(gamma).zip(beta) {
                *out = ((x - mean) * inverse).mul_add(1.0 + gamma, *beta);
            }
        },
    );
}
