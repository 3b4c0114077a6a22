//! Operations of a transformer on candle tensors, each in up to three forms.
//!
//! | operation | fused: CPU, f32 | fused: NVIDIA GPU, f32 or bf16 (feature `cuda`) | plain: every other device and type |
//! |---|---|---|---|
//! | [`linear`] | bias, then one matrix product added to it; few rows: one pass over the weights | matrix product, bias in place | matmul, broadcast add |
//! | [`layer_norm`] | one pass per row, statistics in f32 | the same | mean, centre, mean of squares, scale |
//! | [`modulated_norm`] | as [`layer_norm`], then multiply and add | one kernel where nothing learns, else as on the CPU | the same |
//! | [`gelu_linear`] | exact (erf), one pass, and one matrix product | the same | `gelu_erf`, as [`linear`] |
//! | [`self_attention`] | one matrix product, tiles of queries, softmax inside | three batched matrix products, softmax in place | as [`linear`], two matmuls and a softmax |
//! | [`scaled_residual`] | one pass | the same | broadcast multiply, add |
//!
//! Training and inference run the same form. Each fused form has its own backward pass, since candle's fused layer norm and
//! softmax have none. Between any two operations candle keeps a gradient and sums it from zero; the operations are cut so
//! that the widest tensors lie inside one. [`in_bf16`] lets linear layers in f32 on the CPU multiply in bf16.

mod attention;
#[allow(unsafe_code)] // the spare capacity of a vector, written on several threads
mod cpu;
#[cfg(feature = "cuda")]
pub mod cuda;
mod gelu;
mod layer_norm;
mod linear;
#[allow(unsafe_code)] // the entry point of `gemm`, which takes pointers
mod matrix;
pub mod plain;
mod residual;

use candle_core::{D, Result, Tensor};

pub use cpu::with_slices;
pub(crate) use layer_norm::statistics;
pub use matrix::in_bf16;

/// A form of an operation.
enum Form {
    Cpu,
    #[cfg(feature = "cuda")]
    Gpu,
    Plain,
}

/// Returns the form that takes these tensors.
fn form(tensors: &[&Tensor]) -> Form {
    match cpu::takes(tensors) {
        true => Form::Cpu,
        #[cfg(feature = "cuda")]
        false if cuda::takes(tensors) => Form::Gpu,
        false => Form::Plain,
    }
}

/// Computes `x Wᵀ + b`. `x`: `(.., k)`, `weight`: `(n, k)`, `bias`: `(n)`. Returns `(.., n)`.
///
/// # Errors
/// If shapes, types or devices don't fit.
pub fn linear(x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    match form(&[x, weight, bias]) {
        Form::Cpu => linear::linear(x, weight, bias),
        #[cfg(feature = "cuda")]
        Form::Gpu => cuda::linear(x, weight, bias),
        Form::Plain => plain::linear(x, weight, bias),
    }
}

/// Normalises the last dimension to zero mean and unit variance, then applies weight and bias if `affine` has them.
///
/// `x`: `(.., d)`, `affine`: weight and bias, `(d)` each.
///
/// # Errors
/// If shapes, types or devices don't fit.
pub fn layer_norm(x: &Tensor, affine: Option<(&Tensor, &Tensor)>, eps: f64) -> Result<Tensor> {
    match form(&[x]) {
        Form::Cpu => layer_norm::layer_norm(x, affine, eps),
        #[cfg(feature = "cuda")]
        Form::Gpu => cuda::layer_norm(x, affine, eps),
        Form::Plain => plain::layer_norm(x, affine, eps),
    }
}

/// Normalises as [`layer_norm`], then computes (1 + γ) x + β with γ and β of each image, which lie side by side.
///
/// `h`: `(B, K, d)`, `modulation`: `(B, 2 d)`.
///
/// # Errors
/// If shapes, types or devices don't fit.
pub fn modulated_norm(h: &Tensor, modulation: &Tensor, eps: f64) -> Result<Tensor> {
    #[cfg(feature = "cuda")]
    if cuda::takes(&[h, modulation]) && !h.track_op() && !modulation.track_op() {
        return cuda::modulated_norm(h, modulation, eps);
    }
    let (modulation, d) = (modulation.unsqueeze(1)?, h.dim(D::Minus1)?); // (B, 1, 2 d)
    let gamma = (modulation.narrow(2, 0, d)? + 1.0)?;
    let beta = modulation.narrow(2, d, d)?;
    layer_norm(h, None, eps)?.broadcast_mul(&gamma)?.broadcast_add(&beta)
}

/// Computes `(x Φ(x)) Wᵀ + b` with the exact normal distribution function Φ (erf). Shapes as in [`linear`].
///
/// # Errors
/// If shapes, types or devices don't fit.
pub fn gelu_linear(x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    match form(&[x, weight, bias]) {
        Form::Cpu => gelu::gelu_linear(x, weight, bias),
        #[cfg(feature = "cuda")]
        Form::Gpu => cuda::gelu_linear(x, weight, bias),
        Form::Plain => plain::gelu_linear(x, weight, bias),
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
    match form(&[x, weight, bias]) {
        Form::Cpu => attention::self_attention(x, weight, bias, heads),
        #[cfg(feature = "cuda")]
        Form::Gpu => cuda::self_attention(x, weight, bias, heads),
        Form::Plain => plain::self_attention(x, weight, bias, heads),
    }
}

/// Computes `h + λ y`, with λ per channel. `h`, `y`: `(.., d)`, `lambda`: `(d)`.
///
/// # Errors
/// If shapes, types or devices don't fit.
pub fn scaled_residual(h: &Tensor, y: &Tensor, lambda: &Tensor) -> Result<Tensor> {
    match form(&[h, y, lambda]) {
        Form::Cpu => residual::scaled_residual(h, y, lambda),
        #[cfg(feature = "cuda")]
        Form::Gpu => cuda::scaled_residual(h, y, lambda),
        Form::Plain => plain::scaled_residual(h, y, lambda),
    }
}
