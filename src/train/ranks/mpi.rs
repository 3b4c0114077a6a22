//! Ranks that are processes of an MPI launcher.

#[cfg(feature = "nccl")]
use std::cell::OnceCell;
use std::fmt::Display;

#[cfg(feature = "nccl")]
use candle_core::{Device, Tensor};
use mpi::Threading;
use mpi::collective::SystemOperation;
use mpi::environment::Universe;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator as _, CommunicatorCollectives, Equivalence, Root};

use super::Communicator;
#[cfg(feature = "nccl")]
use super::{DeviceSums, nccl::Nccl};
use crate::error::{Error, Result};
use crate::text::tell;

/// Largest number of values of one message: MPI counts in 32 bits, and the copy of a message stays small.
const MOST_VALUES: usize = 1 << 24;

/// All processes of an MPI launcher.
pub struct Mpi {
    world: SimpleCommunicator,
    /// Group of the ranks' GPUs, joined at the first sum.
    #[cfg(feature = "nccl")]
    gpus: OnceCell<Nccl>,
    /// Finalises MPI when it is dropped.
    _universe: Universe,
}

impl Mpi {
    /// Initialises MPI; only the calling thread may use the result.
    ///
    /// # Errors
    /// If MPI is initialised already, or allows no threads beside the calling one.
    pub fn new() -> Result<Self> {
        let (universe, threading) = mpi::initialize_with_threading(Threading::Funneled)
            .ok_or_else(|| Error::value("MPI", "one initialisation per process", "a second one"))?;
        match threading >= Threading::Funneled {
            true => Ok(Self {
                world: universe.world(),
                #[cfg(feature = "nccl")]
                gpus: OnceCell::new(),
                _universe: universe,
            }),
            false => Err(Error::value("MPI", "threads beside the one that calls it (MPI_THREAD_FUNNELED)", "none")),
        }
    }

    fn sum<T: Equivalence + Copy>(&self, values: &mut [T]) {
        let mut sums = values[..values.len().min(MOST_VALUES)].to_vec();
        for part in values.chunks_mut(MOST_VALUES) {
            let sums = &mut sums[..part.len()];
            self.world.all_reduce_into(&*part, sums, SystemOperation::sum());
            part.copy_from_slice(sums);
        }
    }
}

impl Communicator for Mpi {
    fn rank(&self) -> usize {
        self.world.rank() as usize
    }

    fn size(&self) -> usize {
        self.world.size() as usize
    }

    // An MPI call that fails ends all processes (MPI_ERRORS_ARE_FATAL, the default), so none of these returns an error.
    fn sum_f32(&self, values: &mut [f32]) -> Result<()> {
        self.sum(values);
        Ok(())
    }

    fn sum_f64(&self, values: &mut [f64]) -> Result<()> {
        self.sum(values);
        Ok(())
    }

    fn broadcast(&self, values: &mut [f32]) -> Result<()> {
        let root = self.world.process_at_rank(0);
        values.chunks_mut(MOST_VALUES).for_each(|part| root.broadcast_into(part));
        Ok(())
    }

    fn barrier(&self) -> Result<()> {
        self.world.barrier();
        Ok(())
    }

    #[cfg(feature = "nccl")]
    fn sums_on(&self, device: &Device) -> Option<&dyn DeviceSums> {
        device.is_cuda().then_some(self)
    }

    fn abort(&self, error: &dyn Display) {
        tell(format_args!("egotac: rank {} of {}: {error}", self.rank(), self.size()));
        self.world.abort(1);
    }
}

#[cfg(feature = "nccl")]
impl DeviceSums for Mpi {
    fn sum_tensors(&self, tensors: &[Tensor]) -> Result<Vec<Tensor>> {
        let Some(first) = tensors.first() else { return Ok(Vec::new()) };
        let gpus = match self.gpus.get() {
            Some(gpus) => gpus,
            None => {
                let mut id = if self.is_root() { Nccl::new_id()? } else { [0; 128] };
                self.world.process_at_rank(0).broadcast_into(&mut id[..]);
                let joined = Nccl::join(id, self.rank(), self.size(), first.device())?;
                self.gpus.get_or_init(|| joined)
            }
        };
        gpus.sum_tensors(tensors)
    }
}

impl Drop for Mpi {
    fn drop(&mut self) {
        // The other ranks would wait for this one forever.
        if std::thread::panicking() {
            self.world.abort(101);
        }
    }
}
