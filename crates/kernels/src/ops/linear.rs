//! Linear layer with bias.

use candle_core::{Result, Shape, Tensor, bail};
use rayon::prelude::*;

use super::cpu::{self, Operand, Operation};
use super::matrix::{Factors, Mat, product};
use crate::simd;

/// Largest number of rows for which reading the weights once per row is faster than packing them for a matrix product.
const FEW_ROWS: usize = 2;
/// Weights that one task reads for few rows: 128 KiB, far more work than a task costs.
const WEIGHTS_PER_TASK: usize = 32_768;

/// `x Wᵀ + b`. `x`: `(.., k)`, `weight`: `(n, k)`, `bias`: `(n)`.
struct Linear {
    factors: Factors,
}

/// See [`super::linear`].
pub fn linear(x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    cpu::apply(Linear { factors: Factors::current() }, [x, weight, bias])
}

impl Operation for Linear {
    const NAME: &'static str = "linear";

    fn forward(&self, operands: [Operand; 3]) -> Result<(Vec<f32>, Shape)> {
        let shape = shape(operands.map(|operand| operand.dims()))?;
        let [x, weight, bias] = operands;
        Ok((forward(x.values, weight, bias, self.factors), shape))
    }

    fn backward(&self, [x, weight, bias]: [&Tensor; 3], _: &Tensor, grad: &Tensor) -> Result<[Option<Tensor>; 3]> {
        cpu::with_slice(grad, |grad| {
            let dx = match x.track_op() {
                true => Some(cpu::tensor_like(input_gradient(grad, weight, x, self.factors)?, x)?),
                false => None,
            };
            let [dweight, dbias] = cpu::with_slice(x, |x| parameter_gradients(x, weight, bias, grad, self.factors))?;
            Ok([dx, dweight, dbias])
        })
    }
}

/// Returns the shape of the result of [`super::linear`], from those of x, weight and bias.
///
/// # Errors
/// If they don't fit each other.
pub fn shape([x, weight, bias]: [&[usize]; 3]) -> Result<Shape> {
    match (x, weight) {
        ([before @ .., last], [n, k]) if last == k && bias == [*n] => Ok(Shape::from([before, &[*n]].concat())),
        _ => bail!("linear: x {x:?}, weight {weight:?}, bias {bias:?}"),
    }
}

/// Applies the layer to rows of as many values as a row of the weight has.
pub fn forward(x: &[f32], weight: Operand, bias: Operand, factors: Factors) -> Vec<f32> {
    let (n, k) = (bias.values.len(), weight.dims()[1]);
    let rows = x.len() / k.max(1);
    match rows <= FEW_ROWS {
        true => few_rows(x, weight.values, bias.values),
        false => product(Mat::new(x, rows, k, k), Mat::new(weight.values, n, k, k).t(), Some(bias.values), factors),
    }
}

/// Returns the gradient of the input: that of the output times the weights `(n, k)`.
pub fn input_gradient(grad: &[f32], weight: &Tensor, x: &Tensor, factors: Factors) -> Result<Vec<f32>> {
    let (n, k) = weight.dims2()?;
    let rows = x.elem_count() / k.max(1);
    cpu::with_slice(weight, |weight| Ok(product(Mat::new(grad, rows, n, n), Mat::new(weight, n, k, k), None, factors)))
}

/// Returns the gradients of weight and bias; `None` for one that is not a variable.
pub fn parameter_gradients(
    x: &[f32],
    weight: &Tensor,
    bias: &Tensor,
    grad: &[f32],
    factors: Factors,
) -> Result<[Option<Tensor>; 2]> {
    let (n, k) = weight.dims2()?;
    let rows = x.len() / k.max(1);
    let dweight = weight.track_op().then(|| {
        let (grad, x) = (Mat::new(grad, rows, n, n), Mat::new(x, rows, k, k));
        cpu::tensor_like(product(grad.t(), x, None, factors), weight)
    });
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

/// Computes one scalar product per output.
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
