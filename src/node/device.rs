//! Parameter `device`: the processor that runs the network.

use anyhow::Context as _;
use candle_core::Device;

use super::params::{Allowed, Parameter, Parameters};

/// Declares the parameter.
pub(crate) fn parameter() -> Parameter {
    Parameter::fixed("device", "cpu", Allowed::OneOf(&["cpu", "cuda"]), "Device that runs the network.")
}

/// Opens the device that the parameter names.
///
/// # Errors
/// If there is no usable CUDA device.
pub(crate) fn open(parameters: &Parameters) -> anyhow::Result<Device> {
    match parameters.get::<String>("device").as_str() {
        "cuda" => egotac_kernels::gpu::open(0).context("device cuda"),
        _ => Ok(Device::Cpu),
    }
}
