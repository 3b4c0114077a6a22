//! Exact GELU, and the linear layer behind it.

use std::sync::OnceLock;

use candle_core::{CpuStorage, CustomOp3, Layout, Result, Shape, Tensor, bail};
use rayon::prelude::*;

use super::cpu;
use super::linear;
use super::simd;

/// `(x Φ(x)) Wᵀ + b`. As one operation, since candle keeps and sums a gradient between any two, and the widest
/// tensors of a network lie on both sides of the GELU.
#[derive(Default)]
struct GeluLinear {
    /// x Φ(x), for the backward pass.
    activated: OnceLock<Vec<f32>>,
}

/// See [`super::gelu_linear`].
pub fn gelu_linear(x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    x.contiguous()?.apply_op3(&weight.contiguous()?, &bias.contiguous()?, GeluLinear::default())
}

/// x Φ(x), element by element.
fn gelu(x: &[f32]) -> Vec<f32> {
    cpu::zip(
        x,
        x,
        #[inline(always)]
        |x, _| x * simd::normal(x)[0],
    )
}

impl CustomOp3 for GeluLinear {
    fn name(&self) -> &'static str {
        "gelu-linear"
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
        let shape = linear::shape(x_layout, weight_layout, bias_layout)?;
        let (weight, bias) = (cpu::slice(weight, weight_layout)?, cpu::slice(bias, bias_layout)?);
        let activated = gelu(cpu::slice(x, x_layout)?);
        let out = linear::forward(&activated, weight, bias, weight_layout.dims()[1]);
        // Only ever run once; were it run again, it would be with the same input.
        let _ = self.activated.set(activated);
        Ok((CpuStorage::F32(out), shape))
    }

    /// With g the gradient before the layer: dx = g ∘ (Φ(x) + x φ(x)).
    fn bwd(
        &self,
        x: &Tensor,
        weight: &Tensor,
        bias: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let Some(activated) = self.activated.get() else { bail!("gelu: backward without forward") };
        let grad = grad.contiguous()?;
        cpu::with_slice(&grad, |grad| {
            let mut dx = cpu::with_slice(weight, |weight| linear::input_gradient(grad, weight, x))?;
            cpu::with_slice(x, |x| {
                dx.par_chunks_mut(cpu::CHUNK).zip(x.par_chunks(cpu::CHUNK)).for_each(|(dx, x)| {
                    simd::dispatch(
                        #[inline(always)]
                        || {
                            for (dx, x) in dx.iter_mut().zip(x) {
                                let [distribution, density] = simd::normal(*x);
                                *dx *= x.mul_add(density, distribution);
                            }
                        },
                    )
                });
                Ok(())
            })?;
            let [dweight, dbias] = linear::parameter_gradients(activated, weight, bias, grad)?;
            Ok((Some(cpu::tensor_like(dx, x)?), dweight, dbias))
        })
    }
}
