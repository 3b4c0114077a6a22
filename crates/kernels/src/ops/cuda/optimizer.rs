//! The optimiser's arithmetic where the weights are.

use candle_core::{Result, Tensor, bail};

use super::gpu::{self, AdamStep, Gpu, Weight, tensor_pointer};

/// A variable that takes a step: tensors of one shape, contiguous f32 on one GPU.
#[derive(Debug)]
pub struct Stepping<'a> {
    /// Weights, changed in place.
    pub weight: &'a Tensor,
    /// Gradient.
    pub grad: Tensor,
    /// First moment, second moment and average of the weights, changed in place.
    pub state: &'a [Tensor; 3],
    /// Learning rate.
    pub rate: f32,
    /// Factor of the weights: one less the decay.
    pub shrink: f32,
}

/// Sums the squares of all gradients, always in the same order.
///
/// # Errors
/// If the tensors are not contiguous f32 of one length on a GPU.
pub fn squares(variables: &[Stepping]) -> Result<f64> {
    let Some(first) = variables.first() else { return Ok(0.0) };
    Gpu::<f32>::new(&gpu::device(first.weight)?).squares(&weights(variables)?)
}

/// Takes one step of AdamW on all variables.
///
/// # Errors
/// As [`squares`].
pub fn adamw(variables: &[Stepping], step: AdamStep) -> Result<()> {
    let Some(first) = variables.first() else { return Ok(()) };
    Gpu::<f32>::new(&gpu::device(first.weight)?).adamw(&weights(variables)?, step)
}

fn weights(variables: &[Stepping]) -> Result<Vec<Weight>> {
    let weight = |variable: &Stepping| {
        let Stepping { weight, grad, state: [moment1, moment2, average], rate, shrink } = variable;
        let (tensors, count) = ([*weight, grad, moment1, moment2, average], weight.elem_count());
        if tensors.iter().any(|tensor| tensor.elem_count() != count) {
            bail!("a step: expected {count} values each, got {:?}", tensors.map(Tensor::elem_count));
        }
        let mut arrays = [0; 5];
        for (array, tensor) in arrays.iter_mut().zip(tensors) {
            *array = tensor_pointer::<f32>(tensor)?;
        }
        Ok(Weight { arrays, count, rate: *rate, shrink: *shrink })
    };
    variables.iter().map(weight).collect()
}
