//! The operations written with candle's own differentiable ones, for any device and floating-point type.

use candle_core::{D, Result, Tensor};

/// See [`super::linear`].
pub fn linear(x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    let mut dims = x.dims().to_vec();
    let (n, k) = weight.dims2()?;
    // One product over all rows: candle runs one per batch entry otherwise.
    let y = x.reshape(((), k))?.matmul(&weight.t()?)?.broadcast_add(bias)?;
    if let Some(last) = dims.last_mut() {
        *last = n;
    }
    y.reshape(dims)
}

/// See [`super::layer_norm`].
pub fn layer_norm(x: &Tensor, affine: Option<(&Tensor, &Tensor)>, eps: f64) -> Result<Tensor> {
    let centred = x.broadcast_sub(&x.mean_keepdim(D::Minus1)?)?;
    let variance = centred.sqr()?.mean_keepdim(D::Minus1)?;
    let normal = centred.broadcast_div(&(variance + eps)?.sqrt()?)?;
    match affine {
        Some((weight, bias)) => normal.broadcast_mul(weight)?.broadcast_add(bias),
        None => Ok(normal),
    }
}

/// See [`super::gelu_linear`].
pub fn gelu_linear(x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    linear(&x.gelu_erf()?, weight, bias)
}

/// See [`super::self_attention`].
pub fn self_attention(x: &Tensor, weight: &Tensor, bias: &Tensor, heads: usize) -> Result<Tensor> {
    let qkv = linear(x, weight, bias)?;
    let (b, n, d3) = qkv.dims3()?;
    let d = d3 / 3;
    let parts = qkv.reshape((b, n, 3, heads, d / heads))?.permute((2, 0, 3, 1, 4))?; // (3, B, heads, N, d / heads)
    let part = |i: usize| parts.get(i)?.contiguous();
    let scores = (part(0)?.matmul(&part(1)?.t()?)? / ((d / heads) as f64).sqrt())?;
    let y = candle_nn::ops::softmax(&scores, D::Minus1)?.matmul(&part(2)?)?; // (B, heads, N, d / heads)
    y.transpose(1, 2)?.reshape((b, n, d))
}

/// See [`super::scaled_residual`].
pub fn scaled_residual(h: &Tensor, y: &Tensor, lambda: &Tensor) -> Result<Tensor> {
    h + y.broadcast_mul(lambda)?
}
