//! Exact GELU.

use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor};

use super::cpu;
use super::simd;

/// x Φ(x).
struct Gelu;

/// See [`super::gelu`].
pub fn gelu(x: &Tensor) -> Result<Tensor> {
    x.contiguous()?.apply_op1(Gelu)
}

impl CustomOp1 for Gelu {
    fn name(&self) -> &'static str {
        "gelu"
    }

    fn cpu_fwd(&self, x: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let x = cpu::slice(x, layout)?;
        let out = cpu::zip(
            x,
            x,
            #[inline(always)]
            |x, _| x * simd::normal(x)[0],
        );
        Ok((CpuStorage::F32(out), layout.shape().clone()))
    }

    /// Φ(x) + x φ(x).
    fn bwd(&self, x: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let grad = grad.contiguous()?;
        let dx = cpu::with_slice(x, |x| {
            cpu::with_slice(&grad, |grad| {
                Ok(cpu::zip(
                    x,
                    grad,
                    #[inline(always)]
                    |x, grad| {
                        let [distribution, density] = simd::normal(x);
                        grad * x.mul_add(density, distribution)
                    },
                ))
            })
        })?;
        Ok(Some(cpu::tensor_like(dx, x)?))
    }
}
