//! A variable in training.

use candle_core::{CpuStorage, Storage, Tensor, Var};

use crate::error::Result;

/// A variable with its optimiser state.
#[derive(Debug)]
pub struct Param {
    /// Name in the checkpoint.
    pub name: String,
    /// The variable.
    pub var: Var,
    /// First moment of the gradient.
    pub moment1: Vec<f32>,
    /// Second moment of the gradient.
    pub moment2: Vec<f32>,
    /// Moving average of the weights.
    pub average: Vec<f32>,
}

/// Calls `use_values` with the values of a tensor, which are copied only if they don't lie in host memory one behind the other.
///
/// # Errors
/// If the tensor is not f32, or can't be copied.
pub(super) fn with_host<T>(tensor: &Tensor, use_values: impl FnOnce(&[f32]) -> T) -> Result<T> {
    if let (Storage::Cpu(CpuStorage::F32(values)), layout) = (&*tensor.storage_and_layout().0, tensor.layout())
        && let Some((start, end)) = layout.contiguous_offsets()
    {
        return Ok(use_values(&values[start..end]));
    }
    Ok(use_values(&tensor.flatten_all()?.to_vec1::<f32>()?))
}
