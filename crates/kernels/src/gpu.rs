//! NVIDIA GPUs as candle's devices.

use std::sync::{Mutex, MutexGuard, PoisonError};

use candle_core::{Device, DeviceLocation, Result};

/// Held while a device is opened or work on one is recorded.
static ALONE: Mutex<()> = Mutex::new(());

/// Waits until no device is being opened and no work recorded; none is as long as the guard lives.
pub(crate) fn alone() -> MutexGuard<'static, ()> {
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Opens a GPU by index, for any number of threads.
///
/// candle's own `new_cuda` takes a stream per thread, so that work of one thread does not wait for what another has queued; here
/// all work on the device is queued one behind the other. Freed memory stays with the process.
///
/// # Errors
/// If there is no such GPU, or this build has no feature `cuda`.
pub fn open(index: usize) -> Result<Device> {
    let _alone = alone();
    let device = Device::new_cuda_with_stream(index)?;
    #[cfg(feature = "cuda")]
    cuda::prepare(device.as_cuda_device()?)?;
    Ok(device)
}

/// Opens the same processor again: on a GPU with a stream of its own, so that work there is not queued behind that of `device`.
///
/// # Errors
/// As [`open`].
pub fn another(device: &Device) -> Result<Device> {
    match device.location() {
        DeviceLocation::Cuda { gpu_id } => open(gpu_id),
        _ => Ok(device.clone()),
    }
}

#[cfg(feature = "cuda")]
mod cuda {
    use candle_core::Result;
    use candle_core::cuda_backend::cudarc::driver::{result, sys};
    use candle_core::cuda_backend::{CudaDevice, WrapErr as _};

    /// Does without events, which order several streams, and keeps freed memory.
    pub fn prepare(device: &CudaDevice) -> Result<()> {
        // SAFETY: no tensor exists yet, and all that will use the device's one stream.
        unsafe { device.disable_event_tracking() };
        let stream = device.cuda_stream();
        let mut keep = u64::MAX;
        // SAFETY: the device is open, its pool lives as long, and the attribute is a u64.
        unsafe {
            let pool = result::device::get_default_mem_pool(stream.context().cu_device()).w()?;
            let threshold = sys::CUmemPool_attribute::CU_MEMPOOL_ATTR_RELEASE_THRESHOLD;
            result::mem_pool::set_attribute(pool, threshold, (&raw mut keep).cast()).w()
        }
    }
}
