//! Linear layer with bias.

use candle_core::{CpuStorage, CustomOp3, Layout, Result, Shape, Tensor, bail};
use rayon::prelude::*;

use super::cpu;
use super::matrix::{Mat, MatMut, Onto, Threads, multiply};
use super::simd;

/// Up to this many rows, reading the weights once per row beats packing them for a matrix product.
const FEW_ROWS: usize = 2;
/// Weights that one task reads for few rows.
const WEIGHTS_PER_TASK: usize = 32_768;

/// `x Wᵀ + b`. `x`: `(.., k)`, `weight`: `(n, k)`, `bias`: `(n)`.
struct Linear;

/// See [`super::linear`].
pub fn linear(x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    x.contiguous()?.apply_op3(&weight.contiguous()?, &bias.contiguous()?, Linear)
}

impl CustomOp3 for Linear {
    fn name(&self) -> &'static str {
        "linear"
    }

    fn cpu_fwd(
        &self,
        x: &CpuStorage,
        x_layout: &Layout,
        weight: &CpuStorage,
        weight_layout: &Layout,
        bias: &CpuStorage,
        bias_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let shape = shape(x_layout, weight_layout, bias_layout)?;
        let (x, weight, bias) =
            (cpu::slice(x, x_layout)?, cpu::slice(weight, weight_layout)?, cpu::slice(bias, bias_layout)?);
        Ok((CpuStorage::F32(forward(x, weight, bias, weight_layout.dims()[1])), shape))
    }

    fn bwd(
        &self,
        x: &Tensor,
        weight: &Tensor,
        bias: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let grad = grad.contiguous()?;
        cpu::with_slice(&grad, |grad| {
            let dx = match x.track_op() {
                true => Some(cpu::with_slice(weight, |weight| cpu::tensor_like(input_gradient(grad, weight, x)?, x))?),
                false => None,
            };
            let [dweight, dbias] = cpu::with_slice(x, |x| parameter_gradients(x, weight, bias, grad))?;
            Ok((dx, dweight, dbias))
        })
    }
}

/// Shape of what [`super::linear`] gives.
///
/// # Errors
/// If those of its arguments don't fit.
pub fn shape(x: &Layout, weight: &Layout, bias: &Layout) -> Result<Shape> {
    let (n, k) = weight.shape().dims2()?;
    let mut dims = x.dims().to_vec();
    match dims.last_mut() {
        Some(last) if *last == k && bias.dims() == [n] => *last = n,
        _ => bail!("linear: x {dims:?}, weight [{n}, {k}], bias {:?}", bias.dims()),
    }
    Ok(Shape::from(dims))
}

/// What [`super::linear`] gives, of rows of `k` values.
pub fn forward(x: &[f32], weight: &[f32], bias: &[f32], k: usize) -> Vec<f32> {
    let rows = x.len() / k.max(1);
    if rows <= FEW_ROWS { few_rows(x, weight, bias) } else { many_rows(x, weight, bias, rows) }
}

/// Gradient of the input: that of the output times the weights `(n, k)`.
pub fn input_gradient(grad: &[f32], weight: &[f32], x: &Tensor) -> Result<Vec<f32>> {
    let k = x.layout().shape().dims().last().copied().unwrap_or(1).max(1);
    let (rows, n) = (x.elem_count() / k, weight.len() / k);
    Ok(product(rows, k, Mat::new(grad, rows, n, n), Mat::new(weight, n, k, k)))
}

/// Gradients of weight and bias, where they are wanted.
pub fn parameter_gradients(x: &[f32], weight: &Tensor, bias: &Tensor, grad: &[f32]) -> Result<[Option<Tensor>; 2]> {
    let (n, k) = weight.dims2()?;
    let rows = x.len() / k.max(1);
    let dweight = weight
        .track_op()
        .then(|| cpu::tensor_like(product(n, k, Mat::new(grad, rows, n, n).t(), Mat::new(x, rows, k, k)), weight));
    let dbias = bias.track_op().then(|| {
        let [sum] = cpu::sum_rows(rows, n, |rows, [sum]| {
            simd::dispatch(
                #[inline(always)]
                || {
                    for row in grad[rows.start * n..rows.end * n].chunks_exact(n) {
                        cpu::add(sum, row);
                    }
                },
            )
        });
        cpu::tensor_like(sum, bias)
    });
    Ok([dweight.transpose()?, dbias.transpose()?])
}

/// A matrix product on all threads.
fn product(rows: usize, cols: usize, lhs: Mat, rhs: Mat) -> Vec<f32> {
    let mut out = cpu::filled(rows * cols, cpu::CHUNK, |_, _| {});
    multiply(MatMut::new(&mut out, rows, cols, cols), Onto::Nothing, 1.0, lhs, rhs, Threads::All);
    out
}

/// The bias in every row, and the product added onto it.
fn many_rows(x: &[f32], weight: &[f32], bias: &[f32], rows: usize) -> Vec<f32> {
    let (n, k) = (bias.len(), x.len() / rows);
    let mut out = cpu::filled(rows * n, cpu::ROWS * n, |_, out| {
        out.chunks_exact_mut(n).for_each(|row| row.copy_from_slice(bias));
    });
    let (lhs, rhs) = (Mat::new(x, rows, k, k), Mat::new(weight, n, k, k).t());
    multiply(MatMut::new(&mut out, rows, n, n), Onto::Existing, 1.0, lhs, rhs, Threads::All);
    out
}

/// One scalar product per output.
fn few_rows(x: &[f32], weight: &[f32], bias: &[f32]) -> Vec<f32> {
    let n = bias.len();
    let k = weight.len() / n.max(1);
    let mut out = vec![0.0; x.len() / k.max(1) * n];
    let outputs = (WEIGHTS_PER_TASK / k.max(1)).max(1);
    for (x, out) in x.chunks_exact(k.max(1)).zip(out.chunks_exact_mut(n.max(1))) {
        let tasks = out.par_chunks_mut(outputs).zip(weight.par_chunks(outputs * k)).zip(bias.par_chunks(outputs));
        tasks.for_each(|((out, weight), bias)| {
            simd::dispatch(
                #[inline(always)]
                || {
                    for ((out, row), bias) in out.iter_mut().zip(weight.chunks_exact(k)).zip(bias) {
                        *out = simd::dot(x, row) + bias;
                    }
                },
            )
        });
    }
    out
}
