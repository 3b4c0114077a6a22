//! Operations of a transformer on candle tensors, each in two forms.
//!
//! | operation | fused: CPU, f32 | plain: every other device and type |
//! |---|---|---|
//! | [`linear`] | bias, then one matrix product added to it; few rows: one pass over the weights | matmul, broadcast add |
//! | [`layer_norm`] | one pass per row, statistics in f32 | mean, centre, mean of squares, scale |
//! | [`gelu_linear`] | exact (erf), one pass, and one matrix product | `gelu_erf`, as [`linear`] |
//! | [`self_attention`] | one matrix product, tiles of queries, softmax inside | as [`linear`], two matmuls and a softmax |
//! | [`scaled_residual`] | one pass | broadcast multiply, add |
//!
//! Training and inference run the same form. Each fused form has its own backward pass, since candle's fused layer norm and
//! softmax have none. Between any two operations candle keeps a gradient and sums it from zero; the operations are cut so
//! that the widest tensors lie inside one.

mod attention;
#[allow(unsafe_code)] // the spare capacity of a vector, written on several threads
mod cpu;
mod gelu;
mod layer_norm;
mod linear;
#[allow(unsafe_code)] // the entry point of `gemm`, which takes pointers
mod matrix;
pub mod plain;
mod residual;

use candle_core::{Result, Tensor};

pub use cpu::with_slices;
pub(crate) use layer_norm::statistics;

/// Computes `x Wᵀ + b`. `x`: `(.., k)`, `weight`: `(n, k)`, `bias`: `(n)`. Returns `(.., n)`.
///
/// # Errors
/// If shapes, types or devices don't fit.
pub fn linear(x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    if cpu::takes(&[x, weight, bias]) { linear::linear(x, weight, bias) } else { plain::linear(x, weight, bias) }
}

/// Normalises the last dimension to zero mean and unit variance, then applies weight and bias if `affine` has them.
///
/// `x`: `(.., d)`, `affine`: weight and bias, `(d)` each.
///
/// # Errors
/// If shapes, types or devices don't fit.
pub fn layer_norm(x: &Tensor, affine: Option<(&Tensor, &Tensor)>, eps: f64) -> Result<Tensor> {
    if cpu::takes(&[x]) { layer_norm::layer_norm(x, affine, eps) } else { plain::layer_norm(x, affine, eps) }
}

/// Computes `(x Φ(x)) Wᵀ + b` with the exact normal distribution function Φ (erf). Shapes as in [`linear`].
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

/// Computes multi-head self-attention: softmax(q kᵀ / √(d / heads)) v for each head, where `x Wᵀ + b` holds queries, keys
/// and values side by side.
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

/// Computes `h + λ y`, with λ per channel. `h`, `y`: `(.., d)`, `lambda`: `(d)`.
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
