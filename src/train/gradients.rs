//! Gradients of all variables, and their sum over ranks: in one piece of host memory, or on a device.

use candle_core::backprop::GradStore;

use super::param::{Param, with_host};
use super::ranks::{Communicator, DeviceSums};
use crate::error::Result;

/// Values that are summed over ranks at once, 16 MiB: large enough that the latency of a message does not count, small enough that a
/// communicator's copy does not either.
const BUCKET: usize = 4 << 20;

/// Gradients in the order of [`AdamW::params`](super::optimizer::AdamW::params).
#[derive(Debug, Clone, PartialEq)]
pub struct Gradients {
    /// Those of all variables, one behind the other; 0 where a variable has none.
    values: Vec<f32>,
    /// By variable, the end of its values, and true if it has a gradient.
    parts: Vec<(usize, bool)>,
}

impl Gradients {
    /// Copies gradients to host memory; without `grads`, no variable has one.
    ///
    /// # Errors
    /// If one is not f32, or can't be copied.
    pub fn new(params: &[Param], grads: Option<&GradStore>) -> Result<Self> {
        let mut values = Vec::with_capacity(params.iter().map(|param| param.var.elem_count()).sum());
        let mut parts = Vec::with_capacity(params.len());
        for param in params {
            let grad = grads.and_then(|grads| grads.get(&param.var));
            match grad {
                Some(grad) => with_host(grad, |grad| values.extend_from_slice(grad))?,
                None => values.resize(values.len() + param.var.elem_count(), 0.0),
            }
            parts.push((values.len(), grad.is_some()));
        }
        Ok(Self { values, parts })
    }

    /// Returns the gradient of each variable; None if it has none.
    pub fn by_variable(&self) -> Vec<Option<&[f32]>> {
        let starts = std::iter::once(0).chain(self.parts.iter().map(|(end, _)| *end));
        starts.zip(&self.parts).map(|(start, (end, has))| has.then(|| &self.values[start..*end])).collect()
    }

    /// Replaces the gradients, and `scalars`, by their sums over all ranks; a variable has a gradient if it has one on any of them. Returns the bytes
    /// that this rank gives.
    ///
    /// # Errors
    /// If another rank has failed.
    pub fn sum(&mut self, ranks: &dyn Communicator, scalars: &mut [f64]) -> Result<usize> {
        if ranks.size() == 1 {
            return Ok(0);
        }
        let mut has: Vec<bool> = self.parts.iter().map(|(_, has)| *has).collect();
        let bytes = sum_head(ranks, scalars, &mut has)?;
        self.parts.iter_mut().zip(has).for_each(|((_, part), any)| *part = any);
        self.values.chunks_mut(BUCKET).try_for_each(|bucket| ranks.sum_f32(bucket))?;
        Ok(bytes + size_of_val(&self.values[..]))
    }
}

/// As [`Gradients::sum`], by `sums`, which leaves the gradients on the device of the variables.
///
/// # Errors
/// If another rank has failed, or the device is out of memory.
pub fn sum_on_device(
    params: &[Param],
    grads: &mut GradStore,
    ranks: &dyn Communicator,
    sums: &dyn DeviceSums,
    scalars: &mut [f64],
) -> Result<usize> {
    let mut has: Vec<bool> = params.iter().map(|param| grads.get(&param.var).is_some()).collect();
    let bytes = sum_head(ranks, scalars, &mut has)?;
    let params: Vec<&Param> = params.iter().zip(has).filter_map(|(param, any)| any.then_some(param)).collect();
    let given = params.iter().map(|param| match grads.remove(&param.var) {
        Some(grad) => grad.contiguous(),
        None => param.var.zeros_like(),
    });
    let given = given.collect::<candle_core::Result<Vec<_>>>()?;
    for (param, sum) in params.iter().zip(sums.sum_tensors(&given)?) {
        grads.insert(&param.var, sum);
    }
    Ok(bytes + given.iter().map(|grad| grad.elem_count() * size_of::<f32>()).sum::<usize>())
}

/// Replaces `scalars` by their sums over all ranks, and each flag by true if it is true on any of them. Returns the bytes that this rank gives.
fn sum_head(ranks: &dyn Communicator, scalars: &mut [f64], flags: &mut [bool]) -> Result<usize> {
    let numbers = flags.iter().map(|flag| f64::from(u8::from(*flag)));
    let mut head: Vec<f64> = scalars.iter().copied().chain(numbers).collect();
    ranks.sum_f64(&mut head)?;
    let (sums, numbers) = head.split_at(scalars.len());
    scalars.copy_from_slice(sums);
    flags.iter_mut().zip(numbers).for_each(|(flag, number)| *flag = *number > 0.0);
    Ok(size_of_val(&head[..]))
}
