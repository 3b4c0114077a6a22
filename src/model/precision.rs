//! Number formats that a network can run in on the CPU.

use std::fmt;
use std::str::FromStr;

use candle_core::{DType, Device};
use egotac_kernels::packed::Format;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// Number format of the weights, and with int8 of the activations too.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Weights and arithmetic in f32.
    #[default]
    F32,
    /// Weights in bf16: half the memory. Arithmetic in f32, or, on a processor with a matrix unit (AMX), products of activations
    /// in bf16 summed in f32, which takes a third of the time.
    Bf16,
    /// Weights in int8 with a scale per output, activations in uint8 with scale and zero point per token; patch
    /// projection, norms, attention and the two heads stay in f32; with a matrix unit the products of the attention are in
    /// bf16.
    Int8,
}

impl Precision {
    /// All precisions.
    pub const ALL: [Precision; 3] = [Precision::F32, Precision::Bf16, Precision::Int8];
    /// Names of the precisions, for options.
    pub const NAMES: [&'static str; 3] = ["f32", "bf16", "int8"];

    /// Name: `f32`, `bf16` or `int8`.
    pub fn name(self) -> &'static str {
        Self::NAMES[self as usize]
    }

    /// Format in which the kernels pack a layer.
    pub fn format(self) -> Format {
        match self {
            Precision::F32 => Format::F32,
            Precision::Bf16 => Format::Bf16,
            Precision::Int8 => Format::Int8,
        }
    }

    /// Type of the tensors that hold the weights on a device. On the CPU they are f32 for every precision: the engine converts them.
    pub fn dtype(self, device: &Device) -> DType {
        if self == Precision::Bf16 && !device.is_cpu() { DType::BF16 } else { DType::F32 }
    }

    /// Precision of the first and the last layers: they cost little, and 8 bits would lose most there.
    pub fn of_small_layers(self) -> Self {
        match self {
            Precision::Int8 => Precision::F32,
            other => other,
        }
    }
}

impl fmt::Display for Precision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Precision {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let found = Self::ALL.into_iter().find(|precision| precision.name() == name);
        found.ok_or_else(|| Error::unknown("precision", name, Self::NAMES))
    }
}
