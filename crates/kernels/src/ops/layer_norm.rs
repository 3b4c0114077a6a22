//! Layer norm over the last dimension.

use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor, bail};

use super::cpu::{self, Operand, Operation};
use crate::simd;

/// See [`super::layer_norm`].
pub fn layer_norm(x: &Tensor, affine: Option<(&Tensor, &Tensor)>, eps: f64) -> Result<Tensor> {
    let op = LayerNorm { eps: eps as f32 };
    match affine {
        Some((weight, bias)) => cpu::apply(op, [x, weight, bias]),
        None => x.contiguous()?.apply_op1(op),
    }
}

/// Layer norm with weight and bias ([`Operation`]) or without (`CustomOp1`).
struct LayerNorm {
    eps: f32,
}

impl LayerNorm {
    /// Normalises each row of `d` values.
    fn normalise(&self, x: &[f32], d: usize, affine: Option<(&[f32], &[f32])>) -> Vec<f32> {
        cpu::filled(x.len(), cpu::ROWS * d, |index, out| {
            let x = cpu::block(x, index, cpu::ROWS * d);
            simd::dispatch(
                #[inline(always)]
                || {
                    for (out, x) in out.chunks_exact_mut(d).zip(x.chunks_exact(d)) {
                        let (mean, inverse) = statistics(x, self.eps);
                        match affine {
                            Some((weight, bias)) => {
                                for (((out, x), w), b) in out.iter_mut().zip(x).zip(weight).zip(bias) {
                                    *out = ((x - mean) * inverse).mul_add(*w, *b);
                                }
                            }
                            None => {
                                for (out, x) in out.iter_mut().zip(x) {
                                    *out = (x - mean) * inverse;
                                }
                            }
                        }
                    }
                },
            )
        })
    }

    /// Computes the gradient of the input.
    ///
    /// With n the normalised row and g the gradient times the weight: dx = (g - mean(g) - n mean(g n)) / σ.
    fn input_gradient(&self, x: &[f32], weight: Option<&[f32]>, grad: &[f32], d: usize) -> Vec<f32> {
        let block = cpu::ROWS * d;
        cpu::filled(x.len(), block, |index, dx| {
            let (x, grad) = (cpu::block(x, index, block), cpu::block(grad, index, block));
            simd::dispatch(
                #[inline(always)]
                || {
                    let rows = dx.chunks_exact_mut(d).zip(x.chunks_exact(d)).zip(grad.chunks_exact(d));
                    for ((dx, x), grad) in rows {
                        let (mean, inverse) = statistics(x, self.eps);
                        // First dx holds g.
                        match weight {
                            Some(weight) => {
                                for ((g, grad), w) in dx.iter_mut().zip(grad).zip(weight) {
                                    *g = grad * w;
                                }
                            }
                            None => dx.copy_from_slice(grad),
                        }
                        let [g, gn] = simd::sum2(
                            dx,
                            x,
                            #[inline(always)]
                            |g, x| [g, g * ((x - mean) * inverse)],
                        );
                        let (g_mean, gn_mean) = (g / d as f32, gn / d as f32);
                        for (g, x) in dx.iter_mut().zip(x) {
                            *g = (*g - g_mean - (x - mean) * inverse * gn_mean) * inverse;
                        }
                    }
                },
            )
        })
    }

    /// Computes the gradients of weight and bias: the sums over rows of grad n and of grad.
    fn backward_affine(&self, x: &[f32], grad: &[f32], d: usize) -> [Vec<f32>; 2] {
        cpu::sum_rows(x.len() / d, d, |rows, [dweight, dbias]| {
            simd::dispatch(
                #[inline(always)]
                || {
                    let range = rows.start * d..rows.end * d;
                    for (x, grad) in x[range.clone()].chunks_exact(d).zip(grad[range].chunks_exact(d)) {
                        let (mean, inverse) = statistics(x, self.eps);
                        for (((dw, db), x), grad) in dweight.iter_mut().zip(dbias.iter_mut()).zip(x).zip(grad) {
                            *dw += grad * ((x - mean) * inverse);
                            *db += grad;
                        }
                    }
                },
            )
        })
    }
}

/// Returns the mean of a row and one over its standard deviation.
#[inline(always)]
pub fn statistics(row: &[f32], eps: f32) -> (f32, f32) {
    let scale = 1.0 / row.len() as f32;
    let mean = scale
        * simd::sum(
            row,
            #[inline(always)]
            |x| x,
        );
    let variance = scale
        * simd::sum(
            row,
            #[inline(always)]
            |x| (x - mean) * (x - mean),
        );
    (mean, 1.0 / (variance + eps).sqrt())
}

impl CustomOp1 for LayerNorm {
    fn name(&self) -> &'static str {
        "layer-norm"
    }

    fn cpu_fwd(&self, x: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let d = last_dim(layout)?;
        Ok((CpuStorage::F32(self.normalise(cpu::slice(x, layout)?, d, None)), layout.shape().clone()))
    }

    fn bwd(&self, x: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let d = last_dim(x.layout())?;
        let grad = grad.contiguous()?;
        let dx = cpu::with_slice(x, |x| cpu::with_slice(&grad, |grad| Ok(self.input_gradient(x, None, grad, d))))?;
        Ok(Some(cpu::tensor_like(dx, x)?))
    }
}

impl Operation for LayerNorm {
    const NAME: &'static str = "layer-norm-affine";

    fn forward(&self, [x, weight, bias]: [Operand; 3]) -> Result<(Vec<f32>, Shape)> {
        let d = last_dim(x.layout)?;
        if weight.dims() != [d] || bias.dims() != [d] {
            bail!("layer norm: x {:?}, weight {:?}, bias {:?}", x.dims(), weight.dims(), bias.dims());
        }
        let out = self.normalise(x.values, d, Some((weight.values, bias.values)));
        Ok((out, x.layout.shape().clone()))
    }

    fn backward(&self, [x, weight, bias]: [&Tensor; 3], _: &Tensor, grad: &Tensor) -> Result<[Option<Tensor>; 3]> {
        let d = last_dim(x.layout())?;
        cpu::with_slice(x, |values| {
            cpu::with_slice(grad, |grad| {
                let dx = match x.track_op() {
                    true => {
                        Some(cpu::with_slice(weight, |weight| Ok(self.input_gradient(values, Some(weight), grad, d)))?)
                    }
                    false => None,
                };
                let dx = dx.map(|dx| cpu::tensor_like(dx, x)).transpose()?;
                if !weight.track_op() && !bias.track_op() {
                    return Ok([dx, None, None]);
                }
                let [dweight, dbias] = self.backward_affine(values, grad, d);
                Ok([dx, Some(cpu::tensor_like(dweight, weight)?), Some(cpu::tensor_like(dbias, bias)?)])
            })
        })
    }
}

fn last_dim(layout: &Layout) -> Result<usize> {
    match layout.dims().last() {
        Some(d) if *d > 0 => Ok(*d),
        _ => bail!("layer norm: nothing to normalise in {:?}", layout.dims()),
    }
}
