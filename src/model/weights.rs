//! Files of network weights as f32 tensors by name: safetensors, or archives of PyTorch.

use std::collections::BTreeMap;
use std::path::Path;

use candle_core::{Device, Tensor};
use candle_nn::VarBuilder;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};

use super::finite::check_finite_in;
use super::metadata::names;
use super::shapes::{self, Shapes};
use super::{Config, EgoTac, Precision, pytorch};
use crate::error::{Error, Result};
use crate::file::{input, limits};

/// Tensor of published DINOv2 checkpoints that only their own training uses; allowed in a file and ignored.
const MASK_TOKEN: &str = "encoder.embeddings.mask_token";
/// Largest header of a safetensors file, bytes. The largest network has a header of 0.5 MB.
const MAX_HEADER: u64 = 16 << 20;
/// Number of tensors of a file, at most. The largest network has 3500.
const MAX_TENSORS: usize = 1 << 16;

/// Reads a file of weights whole.
///
/// # Errors
/// If it is not a regular file, or larger than its limit.
pub(super) fn read(path: &Path) -> Result<Vec<u8>> {
    input::read(path, limits::WEIGHTS)
}

/// Reads the tensors of a file as f32 on the CPU, by name: safetensors, or a PyTorch archive, whose code is not executed.
///
/// # Errors
/// If the file can't be read, is of neither format, or a tensor is of an unknown type or not finite.
pub fn read_tensors(path: &Path) -> Result<BTreeMap<String, Tensor>> {
    let bytes = read(path)?;
    match bytes.starts_with(b"PK\x03\x04") {
        true => pytorch::tensors(path, &bytes),
        false => WeightsFile::parse(path, &bytes)?.tensors(),
    }
}

/// Refuses a PyTorch file where a checkpoint of egotac is expected.
///
/// # Errors
/// If the bytes are a PyTorch file's; says how to import it.
pub(super) fn refuse_pytorch(path: &Path, bytes: &[u8]) -> Result<()> {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    // Zip archives, and the bare pickles of before PyTorch 1.6.
    let is_pickle = bytes.starts_with(b"\x80") && ["pth", "pt", "ckpt", "bin"].contains(&extension.as_str());
    if !bytes.starts_with(b"PK\x03\x04") && !is_pickle {
        return Ok(());
    }
    let message = format!(
        "is a PyTorch file, expected a checkpoint of egotac (safetensors); import it with `egotac model import --checkpoint {} \
         --mapping TABLE.yaml --out NAME.safetensors`",
        path.display()
    );
    Err(Error::file(path, message))
}

/// A parsed safetensors file. Its tensors lie in the bytes until [`WeightsFile::tensors`] converts them.
pub(super) struct WeightsFile<'a> {
    path: &'a Path,
    metadata: BTreeMap<String, String>,
    tensors: BTreeMap<String, TensorView<'a>>,
}

impl<'a> WeightsFile<'a> {
    /// Parses the header; the library checks names, types, shapes and places against each other and the size of the file.
    ///
    /// # Errors
    /// If it is not a safetensors file, or its header is larger than that of any network.
    pub fn parse(path: &'a Path, bytes: &'a [u8]) -> Result<Self> {
        let invalid = |error| Error::file(path, format!("not a safetensors file: {error}"));
        if let Some(length) = bytes.first_chunk().map(|length| u64::from_le_bytes(*length))
            && length > MAX_HEADER
        {
            let message =
                format!("not a safetensors file: expected a header of at most {MAX_HEADER} bytes, got {length}");
            return Err(Error::file(path, message));
        }
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(invalid)?;
        let metadata = header.metadata().clone().unwrap_or_default().into_iter().collect();
        let views = SafeTensors::deserialize(bytes).map_err(invalid)?;
        if views.len() > MAX_TENSORS {
            return Err(Error::file(path, format!("expected at most {MAX_TENSORS} tensors, got {}", views.len())));
        }
        let tensors: BTreeMap<String, TensorView> = views.tensors().into_iter().collect();
        // The library takes [2^40, 2^40, 0] for empty; strides would overflow.
        let overflows =
            |shape: &[usize]| shape.iter().try_fold(1usize, |n, size| n.checked_mul((*size).max(1))).is_none();
        if let Some((name, view)) = tensors.iter().find(|(_, view)| overflows(view.shape())) {
            return Err(Error::file(path, format!("{name}: expected a smaller shape, found {:?}", view.shape())));
        }
        Ok(Self { path, metadata, tensors: tensors.into_iter().filter(|(name, _)| name != MASK_TOKEN).collect() })
    }

    /// Metadata of the file.
    pub fn metadata(&self) -> &BTreeMap<String, String> {
        &self.metadata
    }

    /// Returns the shapes of the tensors.
    pub fn shapes(&self) -> Shapes {
        self.tensors.iter().map(|(name, view)| (name.clone(), view.shape().to_vec())).collect()
    }

    /// Converts all tensors to f32 on the CPU.
    ///
    /// # Errors
    /// If a tensor is of an unknown type or not finite.
    pub fn tensors(&self) -> Result<BTreeMap<String, Tensor>> {
        self.tensors.iter().map(|(name, view)| Ok((name.clone(), tensor(self.path, name, view)?))).collect()
    }

    /// Returns the geometry of the file's metadata.
    ///
    /// # Errors
    /// If there is none, or it is out of range.
    pub fn config(&self) -> Result<Config> {
        let json = self.metadata.get("config").ok_or_else(|| Error::Missing {
            name: "metadata \"config\"".into(),
            place: self.path.display().to_string(),
            present: names(self.metadata.keys()),
        })?;
        Config::from_json(json).map_err(|error| Error::file(self.path, error))
    }

    /// Checks that the tensors are those of a checkpoint of this geometry.
    ///
    /// # Errors
    /// Names the tensors that are missing, unexpected or of another shape.
    pub fn check(&self, config: &Config) -> Result<()> {
        let found = self.shapes();
        shapes::check(self.path, &shapes::of_checkpoint(config, &found), &found)
    }

    /// Converts the optional tensors to f32 on the CPU.
    ///
    /// # Errors
    /// As [`WeightsFile::tensors`].
    pub fn optional_tensors(&self) -> Result<BTreeMap<String, Tensor>> {
        let optional = self.tensors.iter().filter(|(name, _)| shapes::is_optional(name));
        optional.map(|(name, view)| Ok((name.clone(), tensor(self.path, name, view)?))).collect()
    }

    /// True if all tensors of the network are f16.
    pub fn is_half(&self) -> bool {
        let mut network = self.tensors.iter().filter(|(name, _)| !shapes::is_optional(name));
        network.all(|(_, view)| view.dtype() == Dtype::F16)
    }

    /// Builds the network of a geometry, after a comparison of all shapes. On the CPU its tensors are f32 for every
    /// precision: the engine converts them when it compiles.
    ///
    /// # Errors
    /// If the tensors are not exactly those of the geometry, or one is not finite.
    pub fn model(&self, config: &Config, device: &Device, precision: Precision) -> Result<EgoTac> {
        config.check()?;
        self.check(config)?;
        let tensors = self.tensors()?.into_iter().collect();
        EgoTac::new(config, VarBuilder::from_tensors(tensors, precision.dtype(device), device))
    }
}

/// A file's tensor as f32.
fn tensor(path: &Path, name: &str, view: &TensorView) -> Result<Tensor> {
    let bytes = view.data();
    let values: Vec<f32> = match view.dtype() {
        Dtype::F32 => bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect(),
        Dtype::F16 => bytes.as_chunks().0.iter().map(|b| half::f16::from_le_bytes(*b).to_f32()).collect(),
        Dtype::BF16 => bytes.as_chunks().0.iter().map(|b| half::bf16::from_le_bytes(*b).to_f32()).collect(),
        other => return Err(Error::file(path, format!("{name}: expected type F32, F16 or BF16, found {other:?}"))),
    };
    check_finite_in(path, name, &values)?;
    Ok(Tensor::from_vec(values, view.shape(), &Device::Cpu)?)
}
