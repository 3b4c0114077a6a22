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
        let (n, k) = weight_layout.shape().dims2()?;
        let mut dims = x_layout.dims().to_vec();
        if dims.last() != Some(&k) || bias_layout.dims() != [n] {
            bail!("linear: x {dims:?}, weight [{n}, {k}], bias {:?}", bias_layout.dims());
        }
        let (x, weight, bias) =
            (cpu::slice(x, x_layout)?, cpu::slice(weight, weight_layout)?, cpu::slice(bias, bias_layout)?);
        let rows = x.len() / k.max(1);
        if let Some(last) = dims.last_mut() {
            *last = n;
        }
        let out = if rows <= FEW_ROWS { few_rows(x, weight, bias) } else { many_rows(x, weight, bias, rows) };
        Ok((CpuStorage::F32(out), Shape::from(dims)))
    }

    fn bwd(
        &self,
        x: &Tensor,
        weight: &Tensor,
        bias: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let (n, k) = weight.dims2()?;
        let rows = x.elem_count() / k.max(1);
        let grad = grad.contiguous()?;
        let product = |rows, cols, lhs: Mat, rhs: Mat| {
            let mut out = vec![0.0; rows * cols];
            multiply(MatMut::new(&mut out, rows, cols, cols), Onto::Nothing, 1.0, lhs, rhs, Threads::All);
            out
        };
        cpu::with_slice(&grad, |grad| {
            let grad_mat = Mat::new(grad, rows, n, n);
            let dx = match x.track_op() {
                true => Some(cpu::with_slice(weight, |weight| {
                    cpu::tensor_like(product(rows, k, grad_mat, Mat::new(weight, n, k, k)), x)
                })?),
                false => None,
            };
            let dweight = match weight.track_op() {
                true => Some(cpu::with_slice(x, |x| {
                    cpu::tensor_like(product(n, k, grad_mat.t(), Mat::new(x, rows, k, k)), weight)
                })?),
                false => None,
            };
            let dbias = match bias.track_op() {
                true => {
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
                    Some(cpu::tensor_like(sum, bias)?)
                }
                false => None,
            };
            Ok((dx, dweight, dbias))
        })
    }
}

/// The bias in every row, and the product added onto it.
fn many_rows(x: &[f32], weight: &[f32], bias: &[f32], rows: usize) -> Vec<f32> {
    let (n, k) = (bias.len(), x.len() / rows);
    let mut out = Vec::with_capacity(rows * n);
    for _ in 0..rows {
        out.extend_from_slice(bias);
    }
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
