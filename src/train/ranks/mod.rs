//! Ranks: the processes that train one network together, each on its part of every batch.
//!
//! [`Communicator`] is all that training needs of them. [`Single`] is one process, [`threads`] are ranks in one process for
//! tests, and feature `mpi` adds processes of an MPI launcher on one or several machines. Gradients are summed in host memory
//! unless the communicator offers [`DeviceSums`]: with features `mpi` and `nccl`, those on GPUs are summed by NCCL.

mod launcher;
#[cfg(feature = "mpi")]
mod mpi;
#[cfg(feature = "nccl")]
pub mod nccl;
pub mod threads;

use std::fmt::Display;

use candle_core::{Device, Tensor};

use crate::error::Result;

pub use launcher::launched;

/// Messages among the ranks of a training. All ranks must make the same calls in the same order, with buffers of equal length.
pub trait Communicator {
    /// Returns the number of this rank, from 0.
    fn rank(&self) -> usize;

    /// Returns the number of ranks.
    fn size(&self) -> usize;

    /// Replaces the values by their sums over all ranks; every rank gets the same bits.
    ///
    /// # Errors
    /// If another rank has failed or ended.
    fn sum_f32(&self, values: &mut [f32]) -> Result<()>;

    /// As [`Communicator::sum_f32`], in f64.
    ///
    /// # Errors
    /// If another rank has failed or ended.
    fn sum_f64(&self, values: &mut [f64]) -> Result<()>;

    /// Replaces the values by those of rank 0.
    ///
    /// # Errors
    /// If another rank has failed or ended.
    fn broadcast(&self, values: &mut [f32]) -> Result<()>;

    /// Waits until all ranks have come here.
    ///
    /// # Errors
    /// If another rank has failed or ended.
    fn barrier(&self) -> Result<()>;

    /// Ends all ranks because of an error on this one. Processes end at once; in one process, the pending and later calls of the other
    /// ranks fail.
    fn abort(&self, error: &dyn Display);

    /// Returns what sums tensors on `device` without copies to host memory; None if the ranks sum in host memory only. Either all ranks
    /// must get one or none.
    fn sums_on(&self, _device: &Device) -> Option<&dyn DeviceSums> {
        None
    }

    /// Returns true on rank 0, which alone writes files.
    fn is_root(&self) -> bool {
        self.rank() == 0
    }
}

/// Sums over all ranks of tensors on a device.
pub trait DeviceSums {
    /// Returns the sum of each tensor over all ranks, in a tensor of its own; every rank gets the same bits. The tensors are contiguous,
    /// in f32, all on one device, and of the same number and shapes on all ranks.
    ///
    /// # Errors
    /// If another rank has failed or ended, or the device is out of memory.
    fn sum_tensors(&self, tensors: &[Tensor]) -> Result<Vec<Tensor>>;
}

/// The only rank of a training.
#[derive(Debug, Clone, Copy, Default)]
pub struct Single;

impl Communicator for Single {
    fn rank(&self) -> usize {
        0
    }

    fn size(&self) -> usize {
        1
    }

    fn sum_f32(&self, _: &mut [f32]) -> Result<()> {
        Ok(())
    }

    fn sum_f64(&self, _: &mut [f64]) -> Result<()> {
        Ok(())
    }

    fn broadcast(&self, _: &mut [f32]) -> Result<()> {
        Ok(())
    }

    fn barrier(&self) -> Result<()> {
        Ok(())
    }

    fn abort(&self, _: &dyn Display) {}
}
