//! The network's operations, each in two forms.
//!
//! | operation | fused: CPU, f32 | plain: every other device and type |
//! |---|---|---|
//! | [`linear`] | bias written first, one matrix product onto it; few rows: one pass over the weights | matmul, broadcast add |
//! | [`layer_norm`] | one pass per row, statistics in f32 | mean, centre, mean of squares, scale |
//! | [`gelu`] | exact (erf), one pass | `gelu_erf` |
//! | [`self_attention`] | tiles of queries, softmax inside, from the packed projection | two matmuls and a softmax |
//! | [`scaled_residual`] | one pass | broadcast multiply, add |
//!
//! Training and inference run the same form: each fused one has its own backward, so a gradient never passes through
//! candle's fused layer norm or softmax, which have none.

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

/// `x Φ(x)` with the exact normal distribution function Φ (erf), element by element.
///
/// # Errors
/// If the type is not a floating-point one.
pub fn gelu(x: &Tensor) -> Result<Tensor> {
    if cpu::takes(&[x]) { gelu::gelu(x) } else { plain::gelu(x) }
}

/// Multi-head self-attention from packed projections: softmax(q kᵀ / √(d / heads)) v for each head.
///
/// `qkv`: `(B, N, 3 d)`, queries, keys and values side by side. Returns `(B, N, d)`.
///
/// # Errors
/// If the last dimension is not three times a multiple of `heads`.
pub fn self_attention(qkv: &Tensor, heads: usize) -> Result<Tensor> {
    if cpu::takes(&[qkv]) { attention::self_attention(qkv, heads) } else { plain::self_attention(qkv, heads) }
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
