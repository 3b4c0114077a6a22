//! Residual connection with a scale per channel.

use candle_core::{CpuStorage, CustomOp3, Layout, Result, Shape, Tensor, bail};

use super::cpu;
use super::simd;

/// `h + λ y`.
struct ScaledResidual;

/// See [`super::scaled_residual`].
pub fn scaled_residual(h: &Tensor, y: &Tensor, lambda: &Tensor) -> Result<Tensor> {
    h.contiguous()?.apply_op3(&y.contiguous()?, &lambda.contiguous()?, ScaledResidual)
}

impl CustomOp3 for ScaledResidual {
    fn name(&self) -> &'static str {
        "scaled-residual"
    }

    fn cpu_fwd(
        &self,
        h: &CpuStorage,
        h_layout: &Layout,
        y: &CpuStorage,
        y_layout: &Layout,
        lambda: &CpuStorage,
        lambda_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let d = lambda_layout.shape().dims1()?;
        if d == 0 || h_layout.dims() != y_layout.dims() || h_layout.dims().last() != Some(&d) {
            bail!("scaled residual: h {:?}, y {:?}, lambda [{d}]", h_layout.dims(), y_layout.dims());
        }
        let (h, y, lambda) = (cpu::slice(h, h_layout)?, cpu::slice(y, y_layout)?, cpu::slice(lambda, lambda_layout)?);
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
        Ok((CpuStorage::F32(out), h_layout.shape().clone()))
    }

    fn bwd(
        &self,
        _: &Tensor,
        y: &Tensor,
        lambda: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let d = lambda.dims1()?;
        let grad = grad.contiguous()?;
        let (dy, dlambda) = cpu::with_slice(&grad, |grad| {
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
        Ok((Some(grad), Some(dy), Some(dlambda)))
    }
}
