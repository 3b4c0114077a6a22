//! Gradients of all variables in one piece of host memory, and their sum over ranks.

use candle_core::backprop::GradStore;

use super::param::{Param, with_host};
use super::ranks::Communicator;
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
        let flags = self.parts.iter().map(|(_, has)| f64::from(u8::from(*has)));
        let mut head: Vec<f64> = scalars.iter().copied().chain(flags).collect();
        ranks.sum_f64(&mut head)?;
        let (sums, flags) = head.split_at(scalars.len());
        scalars.copy_from_slice(sums);
        self.parts.iter_mut().zip(flags).for_each(|((_, has), flag)| *has = *flag > 0.0);
        self.values.chunks_mut(BUCKET).try_for_each(|bucket| ranks.sum_f32(bucket))?;
        Ok(size_of_val(&head[..]) + size_of_val(&self.values[..]))
    }
}
