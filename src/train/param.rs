//! A variable in training.

use std::borrow::Cow;

use candle_core::{CpuStorage, Storage, Tensor, Var};

use crate::error::{Error, Result};

/// A variable with its optimiser state.
#[derive(Debug)]
pub struct Param {
    /// Name in the checkpoint.
    pub name: String,
    /// The variable.
    pub var: Var,
    /// State of the optimiser.
    pub(super) state: State,
}

/// First and second moment of a variable's gradient, and moving average of its weights.
#[derive(Debug)]
pub(super) enum State {
    /// In host memory.
    Host([Vec<f32>; 3]),
    /// On the GPU of the variable, as tensors of its shape.
    #[cfg(feature = "cuda")]
    Gpu([Tensor; 3]),
}

impl State {
    /// Returns the state in host memory; None if it is on a GPU.
    pub(super) fn host(&mut self) -> Option<&mut [Vec<f32>; 3]> {
        match self {
            Self::Host(values) => Some(values),
            #[cfg(feature = "cuda")]
            Self::Gpu(_) => None,
        }
    }
}

impl Param {
    /// Takes a variable, with moments of zero and its weights as their average.
    ///
    /// # Errors
    /// If it is not f32, or can't be read.
    pub(super) fn new(name: String, var: Var) -> Result<Self> {
        #[cfg(feature = "cuda")]
        if var.device().is_cuda() {
            let state = [var.zeros_like()?, var.zeros_like()?, var.copy()?];
            return Ok(Self { name, var, state: State::Gpu(state) });
        }
        let average = with_host(var.as_tensor(), <[f32]>::to_vec)?;
        let zeros = vec![0.0; average.len()];
        Ok(Self { name, var, state: State::Host([zeros.clone(), zeros, average]) })
    }

    /// Returns first moment, second moment and average.
    ///
    /// # Errors
    /// If they can't be copied from the device.
    pub fn state(&self) -> Result<[Cow<'_, [f32]>; 3]> {
        match &self.state {
            State::Host(values) => Ok(values.each_ref().map(|values| Cow::Borrowed(&values[..]))),
            #[cfg(feature = "cuda")]
            State::Gpu(tensors) => {
                let host = |tensor: &Tensor| -> Result<Cow<[f32]>> { Ok(Cow::Owned(tensor.flatten_all()?.to_vec1()?)) };
                let [moment1, moment2, average] = tensors;
                Ok([host(moment1)?, host(moment2)?, host(average)?])
            }
        }
    }

    /// Replaces first moment, second moment and average.
    ///
    /// # Errors
    /// If they have another length than the variable.
    pub fn set_state(&mut self, values: [Vec<f32>; 3]) -> Result<()> {
        let count = self.var.elem_count();
        if let Some(other) = values.iter().find(|values| values.len() != count) {
            return Err(Error::value(&self.name, format!("a state of {count} values"), other.len()));
        }
        match &mut self.state {
            State::Host(state) => *state = values,
            #[cfg(feature = "cuda")]
            State::Gpu(tensors) => {
                for (tensor, values) in tensors.iter_mut().zip(values) {
                    *tensor = Tensor::from_vec(values, self.var.shape(), self.var.device())?;
                }
            }
        }
        Ok(())
    }
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
