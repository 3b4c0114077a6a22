//! The network's operations, each in two forms.
//!
//! | operation | fused: CPU, f32 | plain: every other device and type |
//! |---|---|---|
//! | [`linear`] | bias written first, one matrix product onto it; few rows: one pass over the weights | matmul, broadcast add |
//! | [`layer_norm`] | one pass per row, statistics in f32 | mean, centre, mean of squares, scale |
//! | [`gelu_linear`] | exact (erf), one pass, and one matrix product | `gelu_erf`, as [`linear`] |
//! | [`self_attention`] | one matrix product, tiles of queries, softmax inside | as [`linear`], two matmuls and a softmax |
//! | [`scaled_residual`] | one pass | broadcast multiply, add |
//!
//! Training and inference run the same form: each fused one has its own backward, so a gradient never passes through
//! candle's fused layer norm or softmax, which have none. Between any two operations candle sums gradients from zero,
//! on tensors as large as the operations' own, so that the widest ones lie inside of operations.

mod attention;
pub(super) mod cpu;
mod gelu;
mod layer_norm;
mod linear;
mod matrix;
pub mod plain;
mod residual;
pub(super) mod simd;

use candle_core::{Result, Tensor};

pub(super) use layer_norm::statistics;

/// `x Wᵀ + b`. `x`: `(.., k)`, `weight`: `(n, k)`, `bias`: `(n)`. Returns `(.., n)`.
///
/// # Errors
/// If shapes, types or devices don't fit.
pub fn linear(x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    if cpu::takes(&[x, weight, bias]) { linear::linear(x, weight, bias) } else { plain::linear(x, weight, bias) }
}

/// Normalises the last dimension to zero mean and unit variance, then scales and shifts it by `affine`, if there.
///
/// `x`: `(.., d)`, `affine`: weight and bias, `(d)` each.
///
/// # Errors
/// If shapes, types or devices don't fit.
pub fn layer_norm(x: &Tensor, affine: Option<(&Tensor, &Tensor)>, eps: f64) -> Result<Tensor> {
    if cpu::takes(&[x]) { layer_norm::layer_norm(x, affine, eps) } else { plain::layer_norm(x, affine, eps) }
}

/// `(x Φ(x)) Wᵀ + b` with the exact normal distribution function Φ (erf). Shapes as in [`linear`].
///
/// # Errors
/// If shapes, types or devices don't fit.
pub fn gelu_linear(x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    if cpu::takes(&[x, weight, bias]) {
        gelu::gelu_linear(x, weight, bias)
    } else {
        plain::gelu_linear(x, weight, bias)
    }
}

/// Multi-head self-attention: softmax(q kᵀ / √(d / heads)) v for each head, of queries, keys and values side by side,
/// `x Wᵀ + b`.
///
/// `x`: `(B, N, k)`, `weight`: `(3 d, k)`, `bias`: `(3 d)`. Returns `(B, N, d)`.
///
/// # Errors
/// If shapes, types or devices don't fit, or 3 d is not three times a multiple of `heads`.
pub fn self_attention(x: &Tensor, weight: &Tensor, bias: &Tensor, heads: usize) -> Result<Tensor> {
    if cpu::takes(&[x, weight, bias]) {
        attention::self_attention(x, weight, bias, heads)
    } else {
        plain::self_attention(x, weight, bias, heads)
    }
}

/// `h + λ y`, λ per channel. `h`, `y`: `(.., d)`, `lambda`: `(d)`.
///
/// # Errors
/// If shapes, types or devices don't fit.
pub fn scaled_residual(h: &Tensor, y: &Tensor, lambda: &Tensor) -> Result<Tensor> {
    if cpu::takes(&[h, y, lambda]) {
        residual::scaled_residual(h, y, lambda)
    } else {
        plain::scaled_residual(h, y, lambda)
    }
}
