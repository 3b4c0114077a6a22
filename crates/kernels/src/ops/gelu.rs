//! Exact GELU and the linear layer behind it, as one operation.

use std::sync::OnceLock;

use candle_core::{Result, Shape, Tensor, bail};
use rayon::prelude::*;

use super::cpu::{self, Operand, Operation};
use super::linear;
use super::matrix::Factors;
use crate::simd;

/// `(x Φ(x)) Wᵀ + b`.
///
/// One operation, since candle keeps a gradient between any two and sums it from zero, and the widest tensors of a network
/// lie on both sides of the GELU.
struct GeluLinear {
    factors: Factors,
    /// x Φ(x), kept for the backward pass.
    activated: OnceLock<Vec<f32>>,
}

/// See [`super::gelu_linear`].
pub fn gelu_linear(x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    cpu::apply(GeluLinear { factors: Factors::current(), activated: OnceLock::new() }, [x, weight, bias])
}

/// Returns x Φ(x) for each x.
fn gelu(x: &[f32]) -> Vec<f32> {
    cpu::zip(
        x,
        x,
        #[inline(always)]
        |x, _| x * simd::normal(x)[0],
    )
}

impl Operation for GeluLinear {
    const NAME: &'static str = "gelu-linear";

    fn forward(&self, operands: [Operand; 3]) -> Result<(Vec<f32>, Shape)> {
        let shape = linear::shape(operands.map(|operand| operand.dims()))?;
        let [x, weight, bias] = operands;
        let activated = gelu(x.values);
        let out = linear::forward(&activated, weight, bias, self.factors);
        // Fails only if the forward pass runs twice, with the same input and so the same values.
        let _ = self.activated.set(activated);
        Ok((out, shape))
    }

    /// With g the gradient before the layer: dx = g ∘ (Φ(x) + x φ(x)).
    fn backward(&self, [x, weight, bias]: [&Tensor; 3], _: &Tensor, grad: &Tensor) -> Result<[Option<Tensor>; 3]> {
        let Some(activated) = self.activated.get() else { bail!("gelu: backward without forward") };
        cpu::with_slice(grad, |grad| {
            let mut dx = linear::input_gradient(grad, weight, x, self.factors)?;
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
            let [dweight, dbias] = linear::parameter_gradients(activated, weight, bias, grad, self.factors)?;
            Ok([Some(cpu::tensor_like(dx, x)?), dweight, dbias])
        })
    }
}
