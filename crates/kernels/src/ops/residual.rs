//! Residual connection with a scale per channel.

use candle_core::{Result, Shape, Tensor, bail};

use super::cpu::{self, Operand, Operation};
use crate::simd;

/// `h + λ y`.
struct ScaledResidual;

/// See [`super::scaled_residual`].
pub fn scaled_residual(h: &Tensor, y: &Tensor, lambda: &Tensor) -> Result<Tensor> {
    cpu::apply(ScaledResidual, [h, y, lambda])
}

impl Operation for ScaledResidual {
    const NAME: &'static str = "scaled-residual";

    fn forward(&self, [h, y, lambda]: [Operand; 3]) -> Result<(Vec<f32>, Shape)> {
        let d = lambda.layout.shape().dims1()?;
        if d == 0 || h.dims() != y.dims() || h.dims().last() != Some(&d) {
            bail!("scaled residual: h {:?}, y {:?}, lambda [{d}]", h.dims(), y.dims());
        }
        let shape = h.layout.shape().clone();
        let (h, y, lambda) = (h.values, y.values, lambda.values);
        let block = cpu::ROWS * d;
        let out = cpu::filled(h.len(), block, |index, out| {
            let (h, y) = (cpu::block(h, index, block), cpu::block(y, index, block));
            simd::dispatch(
                #[inline(always)]
                || {
                    for ((out, h), y) in out.chunks_exact_mut(d).zip(h.chunks_exact(d)).zip(y.chunks_exact(d)) {
                        for (((out, h), y), lambda) in out.iter_mut().zip(h).zip(y).zip(lambda) {
                            *out = y.mul_add(*lambda, *h);
                        }
                    }
                },
            )
        });
        Ok((out, shape))
    }

    fn backward(&self, [_, y, lambda]: [&Tensor; 3], _: &Tensor, grad: &Tensor) -> Result<[Option<Tensor>; 3]> {
        let d = lambda.dims1()?;
        let (dy, dlambda) = cpu::with_slice(grad, |grad| {
            let dy = cpu::with_slice(lambda, |lambda| {
                Ok(cpu::zip(
                    grad,
                    lambda,
                    #[inline(always)]
                    |g, l| g * l,
                ))
            })?;
            let [dlambda] = cpu::with_slice(y, |y| {
                Ok(cpu::sum_rows(y.len() / d, d, |rows, [sum]| {
                    simd::dispatch(
                        #[inline(always)]
                        || {
                            let range = rows.start * d..rows.end * d;
                            for (y, grad) in y[range.clone()].chunks_exact(d).zip(grad[range].chunks_exact(d)) {
                                for ((sum, y), grad) in sum.iter_mut().zip(y).zip(grad) {
                                    *sum = y.mul_add(*grad, *sum);
                                }
                            }
                        },
                    )
                }))
            })?;
            Ok((cpu::tensor_like(dy, y)?, cpu::tensor_like(dlambda, lambda)?))
        })?;
        Ok([Some(grad.clone()), Some(dy), Some(dlambda)])
    }
}
