//! Layer norm of rows.

use super::packed::Rows;
use super::team;
use crate::model::attention::EPS;
use crate::model::ops::{simd, statistics};

/// Values that one task normalises.
const TASK: usize = 16_384;

/// Weight and bias of a layer norm.
#[derive(Debug, Clone)]
pub struct Norm {
    weight: Vec<f32>,
    bias: Vec<f32>,
}

impl Norm {
    /// `(d)` each.
    pub fn new(weight: Vec<f32>, bias: Vec<f32>) -> Self {
        Self { weight, bias }
    }

    /// Width.
    pub fn d(&self) -> usize {
        self.weight.len()
    }

    /// Normalises rows of `x`; rows of `out` lie close.
    pub fn forward(&self, x: Rows, out: &mut [f32]) {
        let d = self.d();
        let rows = (TASK / d).max(1);
        team::chunks(&mut out[..x.count * d], rows * d, |block, out| {
            for (i, out) in out.chunks_exact_mut(d).enumerate() {
                let first = (block * rows + i) * x.stride;
                self.row(&x.data[first..first + d], out);
            }
        });
    }

    /// Normalises the sum of a row and a shift.
    pub fn sum(&self, x: &[f32], shift: &[f32], out: &mut [f32]) {
        simd::dispatch(
            #[inline(always)]
            || {
                for ((out, x), shift) in out.iter_mut().zip(x).zip(shift) {
                    *out = x + shift;
                }
                let (mean, inverse) = statistics(out, EPS as f32);
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
                let (mean, inverse) = statistics(x, EPS as f32);
                for (((out, x), w), b) in out.iter_mut().zip(x).zip(&self.weight).zip(&self.bias) {
                    *out = ((x - mean) * inverse).mul_add(*w, *b);
                }
            },
        );
    }
}

/// Normalises a row without weight and bias of its own, then scales it by 1 + γ and shifts it by β.
pub fn modulated(x: &[f32], gamma: &[f32], beta: &[f32], out: &mut [f32]) {
    simd::dispatch(
        #[inline(always)]
        || {
            let (mean, inverse) = statistics(x, EPS as f32);
            for (((out, x), gamma), beta) in out.iter_mut().zip(x).zip(gamma).zip(beta) {
                *out = ((x - mean) * inverse).mul_add(1.0 + gamma, *beta);
            }
        },
    );
}
