//! Sums of tensors on the GPUs of several ranks, by NCCL.

use std::ffi::c_char;
use std::fmt::Display;

use candle_core::cuda_backend::CudaStorage;
use candle_core::cuda_backend::cudarc::nccl::result::NcclError;
use candle_core::cuda_backend::cudarc::nccl::{Comm, Id, ReduceOp, group_end, group_start};
use candle_core::op::BackpropOp;
use candle_core::{CudaDevice, Device, Storage, Tensor};

use crate::error::{Error, Result};

/// Name by which the ranks of one group find each other.
pub type GroupId = [c_char; 128];

/// This rank's part of a group of ranks, each with a GPU of its own.
pub struct Nccl {
    group: Comm,
    device: CudaDevice,
}

impl Nccl {
    /// Creates the name of a new group. One rank creates it and gives it to all.
    ///
    /// # Errors
    /// If NCCL finds no network interface.
    pub fn new_id() -> Result<GroupId> {
        Ok(*Id::new().map_err(failed)?.internal())
    }

    /// Joins a group of `size` ranks; returns once all have joined.
    ///
    /// # Errors
    /// If `device` is not a GPU, or is that of another rank, or a rank can't be reached.
    pub fn join(id: GroupId, rank: usize, size: usize, device: &Device) -> Result<Self> {
        let device = device.as_cuda_device()?.clone();
        bind(&device)?;
        let group = Comm::from_rank(device.cuda_stream(), rank, size, Id::uninit(id)).map_err(failed)?;
        Ok(Self { group, device })
    }

    /// Returns the sum of each tensor over the ranks, see [`DeviceSums`](super::DeviceSums). The sums are queued in the order of the
    /// device's stream; the call does not wait for them.
    ///
    /// # Errors
    /// If a tensor is not a contiguous one in f32 on the GPU of this rank, the GPU is out of memory, or a rank can't be reached.
    pub fn sum_tensors(&self, tensors: &[Tensor]) -> Result<Vec<Tensor>> {
        bind(&self.device)?;
        // A group of messages is sent together. It is closed also after an error, because later calls would belong to it.
        group_start().map_err(failed)?;
        let sums = tensors.iter().map(|tensor| self.sum(tensor)).collect::<Result<Vec<_>>>();
        group_end().map_err(failed)?;
        sums
    }

    /// Queues the sum of one tensor.
    fn sum(&self, tensor: &Tensor) -> Result<Tensor> {
        let (storage, layout) = tensor.storage_and_layout();
        let (Storage::Cuda(storage), Some((start, end))) = (&*storage, layout.contiguous_offsets()) else {
            let found = format!("{:?} on {:?}", layout, tensor.device().location());
            return Err(Error::value("NCCL", "contiguous tensors on a GPU", found));
        };
        let values = storage.as_cuda_slice::<f32>()?.slice(start..end);
        let mut sum = self.device.alloc_zeros::<f32>(end - start)?;
        self.group.all_reduce(&values, &mut sum, &ReduceOp::Sum).map_err(failed)?;
        let storage = Storage::Cuda(CudaStorage::wrap_cuda_slice(sum, self.device.clone()));
        Ok(Tensor::from_storage(storage, tensor.shape(), BackpropOp::none(), false))
    }
}

/// Makes `device` the one that NCCL uses on this thread.
fn bind(device: &CudaDevice) -> Result<()> {
    device.cuda_stream().context().bind_to_thread().map_err(|error| refused(format!("{error:?}")))
}

fn failed(NcclError(status): NcclError) -> Error {
    refused(format!("{status:?} (NCCL_DEBUG=INFO tells more)"))
}

fn refused(found: impl Display) -> Error {
    Error::value("NCCL", "a GPU of its own for each rank, and a network between them", found)
}
