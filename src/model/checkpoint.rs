//! Checkpoints: weights in safetensors, with geometry and preparation of images in the file's metadata.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use candle_core::{DType, Device, Tensor, Var};
use candle_nn::VarMap;
use safetensors::{Dtype, tensor::TensorView};

use super::familiarity::Familiarity;
use super::finite::check_finite_in;
use super::metadata::Metadata;
use super::presence::Presence;
use super::shapes::{self, Shapes};
use super::spread::Spread;
use super::weights::{self, WeightsFile};
use super::{Config, EgoTac, Precision};
use crate::error::{Error, Result};
use crate::file;

pub use super::weights::read_tensors;

/// Prefix of the names of the encoder's tensors.
pub const ENCODER: &str = "encoder.";

/// Number format of the weights in a file. Loading converts them to f32.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stored {
    /// 4 bytes per weight.
    F32,
    /// 2 bytes per weight: 11 significant bits, at most 65504.
    F16,
}

/// A compiled network and the metadata of its file.
#[derive(Debug, Clone)]
pub struct Checkpoint {
    /// The compiled network.
    pub model: EgoTac,
    /// Metadata of the file.
    pub metadata: Metadata,
    /// Statistics of the encoder's features; None in a checkpoint that has none.
    pub familiarity: Option<Familiarity>,
    /// Weights that estimate presence and keypoints of the hands; None in a checkpoint that has none.
    pub presence: Option<Presence>,
    /// Intervals of the forces; None in a checkpoint that has none.
    pub spread: Option<Spread>,
    /// SHA-256 of the file, lower-case hexadecimal, as `sha256sum` prints it.
    pub sha256: String,
}

impl Checkpoint {
    /// Creates a checkpoint without optional parts that no file holds.
    pub fn new(model: EgoTac, metadata: Metadata) -> Self {
        Self { model, metadata, familiarity: None, presence: None, spread: None, sha256: String::new() }
    }

    /// Loads a checkpoint for inference in f32.
    ///
    /// # Errors
    /// If the file can't be read, a key of the metadata is missing or out of range, or a tensor is missing, unexpected, of a
    /// wrong shape, of an unknown type or not finite.
    pub fn load(path: &Path, device: &Device) -> Result<Self> {
        Self::load_as(path, device, Precision::F32)
    }

    /// As [`Checkpoint::load`], in another precision.
    ///
    /// # Errors
    /// As [`Checkpoint::load`], and if the device does not support the precision (int8 needs the CPU).
    pub fn load_as(path: &Path, device: &Device, precision: Precision) -> Result<Self> {
        let bytes = weights::read(path)?;
        weights::refuse_pytorch(path, &bytes)?;
        let file = WeightsFile::parse(path, &bytes)?;
        let metadata = Metadata::from_map(path, file.metadata())?;
        let model = file.model(&file.config()?, device, precision)?;
        let optional = file.optional_tensors()?;
        let familiarity = Familiarity::from_tensors(path, &optional)?;
        let presence = Presence::from_tensors(&optional)?;
        let spread = Spread::from_tensors(path, &optional)?;
        drop(file);
        let sha256 = file::sha256(&bytes);
        // Compiling lays the weights out anew: the bytes of the file need not lie in memory too.
        drop(bytes);
        Ok(Self { model: model.compile(precision)?, metadata, familiarity, presence, spread, sha256 })
    }

    /// Saves the variables of a network in training in an atomic write. Returns the SHA-256 of the file.
    ///
    /// Equal weights and metadata give equal bytes.
    ///
    /// # Errors
    /// If `metadata` is out of range, the variables are not those of `config`, one of them is not finite, or the file
    /// can't be written.
    pub fn save(path: &Path, config: &Config, metadata: &Metadata, vars: &VarMap) -> Result<String> {
        Self::save_tensors(path, config, metadata, &variables(vars)?)
    }

    /// As [`Checkpoint::save`], from f32 tensors on the CPU by name.
    ///
    /// # Errors
    /// As [`Checkpoint::save`].
    pub fn save_tensors(
        path: &Path,
        config: &Config,
        metadata: &Metadata,
        tensors: &BTreeMap<String, Tensor>,
    ) -> Result<String> {
        Self::save_as(path, config, metadata, tensors, Stored::F32)
    }

    /// As [`Checkpoint::save_tensors`], in another number format.
    ///
    /// # Errors
    /// As [`Checkpoint::save`], and if a value is beyond the range of f16.
    pub fn save_as(
        path: &Path,
        config: &Config,
        metadata: &Metadata,
        tensors: &BTreeMap<String, Tensor>,
        stored: Stored,
    ) -> Result<String> {
        metadata.check()?;
        config.check()?;
        check(path, config, tensors)?;
        let mut map = metadata.to_map();
        map.insert("config".into(), config.to_json());
        let bytes = serialize(path, tensors, &map, stored)?;
        file::write(path, &bytes)?;
        Ok(file::sha256(&bytes))
    }
}

/// Loads a network in its trainable form from a file without metadata, or with its geometry alone.
///
/// `config` replaces the geometry of the file.
///
/// # Errors
/// If the file can't be read, neither the caller nor the file gives a configuration, or a tensor does not fit.
pub fn load_model(path: &Path, config: Option<&Config>, device: &Device) -> Result<EgoTac> {
    let bytes = weights::read(path)?;
    let file = WeightsFile::parse(path, &bytes)?;
    let config = match config {
        Some(config) => config.clone(),
        None => file.config()?,
    };
    file.model(&config, device, Precision::F32)
}

/// Loads the network of a checkpoint in its trainable form, on the CPU: only that form has attention weights to show.
///
/// # Errors
/// As [`Checkpoint::load`].
pub fn load_uncompiled(path: &Path) -> Result<(EgoTac, Metadata)> {
    let bytes = weights::read(path)?;
    let file = WeightsFile::parse(path, &bytes)?;
    let metadata = Metadata::from_map(path, file.metadata())?;
    Ok((file.model(&file.config()?, &Device::Cpu, Precision::F32)?, metadata))
}

/// Reads the geometry of a checkpoint.
///
/// # Errors
/// If the file can't be read or has no geometry.
pub fn geometry(path: &Path) -> Result<Config> {
    WeightsFile::parse(path, &weights::read(path)?)?.config()
}

/// Returns the number format of the weights in a file.
///
/// # Errors
/// If the file can't be read.
pub fn stored(path: &Path) -> Result<Stored> {
    let bytes = weights::read(path)?;
    Ok(if WeightsFile::parse(path, &bytes)?.is_half() { Stored::F16 } else { Stored::F32 })
}

/// Reads geometry, metadata and tensors of a checkpoint. The tensors are f32 on the CPU, and exactly those of the geometry
/// and of the optional parts that the file has.
///
/// # Errors
/// As [`Checkpoint::load`].
pub fn load_tensors(path: &Path) -> Result<(Config, Metadata, BTreeMap<String, Tensor>)> {
    let bytes = weights::read(path)?;
    let file = WeightsFile::parse(path, &bytes)?;
    let (config, metadata) = (file.config()?, Metadata::from_map(path, file.metadata())?);
    file.check(&config)?;
    Ok((config, metadata, file.tensors()?))
}

/// Sets the variables of a network in training to the weights of a file, all or none. Returns the metadata of the file, if
/// it has any.
///
/// # Errors
/// If the file can't be read, or its tensors are not exactly the variables, by name and shape.
pub fn load_variables(path: &Path, vars: &VarMap) -> Result<Option<Metadata>> {
    let bytes = weights::read(path)?;
    let file = WeightsFile::parse(path, &bytes)?;
    let metadata = match file.metadata().contains_key("topology") {
        true => Some(Metadata::from_map(path, file.metadata())?),
        false => None,
    };
    let vars = lock(vars)?;
    let expected = vars.iter().map(|(name, var)| (name.clone(), var.dims().to_vec())).collect();
    let mut found = file.shapes();
    // Statistics of the encoder that was: training makes another one of it.
    found.retain(|name, _| !shapes::is_optional(name));
    shapes::check(path, &expected, &found)?;
    set(&vars, file.tensors()?)?;
    Ok(metadata)
}

/// Sets the encoder's variables of a network in training to those of a file, all or none; other tensors are ignored.
///
/// # Errors
/// If the file can't be read, or a tensor of the encoder is missing or of another shape.
pub fn load_encoder(path: &Path, vars: &VarMap) -> Result<()> {
    let mut tensors = read_tensors(path)?;
    let vars = lock(vars)?;
    let encoder = vars.iter().filter(|(name, _)| name.starts_with(ENCODER));
    let expected: Shapes = encoder.map(|(name, var)| (name.clone(), var.dims().to_vec())).collect();
    tensors.retain(|name, _| expected.contains_key(name));
    shapes::check(path, &expected, &shapes::of_tensors(&tensors))?;
    set(&vars, tensors)
}

/// Sets the variables of these names.
fn set(vars: &HashMap<String, Var>, tensors: BTreeMap<String, Tensor>) -> Result<()> {
    for (name, tensor) in tensors {
        if let Some(var) = vars.get(&name) {
            var.set(&tensor.to_dtype(var.dtype())?.to_device(var.device())?)?;
        }
    }
    Ok(())
}

/// Saves tensors under their names, without metadata, as f32 in an atomic write.
///
/// # Errors
/// If a value is not finite or the file can't be written.
pub fn save_tensors(path: &Path, tensors: &BTreeMap<String, Tensor>) -> Result<()> {
    file::write(path, &serialize(path, tensors, &BTreeMap::new(), Stored::F32)?)
}

/// Returns the number of parameters of a network of this geometry.
///
/// # Errors
/// If the configuration does not pass its check.
pub fn parameter_count(config: &Config) -> Result<usize> {
    config.check()?;
    Ok(shapes::count(&shapes::of_network(config)) as usize)
}

/// Checks that tensors are exactly those of a geometry, and of optional parts.
///
/// # Errors
/// Names tensors that are missing, unexpected or of a wrong shape, and `path` as their file.
pub(super) fn check(path: &Path, config: &Config, tensors: &BTreeMap<String, Tensor>) -> Result<()> {
    let found = shapes::of_tensors(tensors);
    shapes::check(path, &shapes::of_checkpoint(config, &found), &found)
}

/// Returns the variables by name, as f32 on the CPU.
pub(crate) fn variables(vars: &VarMap) -> Result<BTreeMap<String, Tensor>> {
    lock(vars)?
        .iter()
        .map(|(name, var)| Ok((name.clone(), var.as_tensor().to_device(&Device::Cpu)?.to_dtype(DType::F32)?)))
        .collect()
}

fn lock(vars: &VarMap) -> Result<std::sync::MutexGuard<'_, HashMap<String, Var>>> {
    vars.data().lock().map_err(|_| Error::value("variables", "a map in working order", "one whose thread panicked"))
}

/// Returns the bytes of a safetensors file. Optional tensors stay f32: they are small, and have quantiles beyond f16.
fn serialize(
    path: &Path,
    tensors: &BTreeMap<String, Tensor>,
    map: &BTreeMap<String, String>,
    stored: Stored,
) -> Result<Vec<u8>> {
    let mut data = Vec::new();
    for (name, tensor) in tensors {
        let stored = if shapes::is_optional(name) { Stored::F32 } else { stored };
        let (dtype, max) = match stored {
            Stored::F32 => (Dtype::F32, f32::MAX),
            Stored::F16 => (Dtype::F16, half::f16::MAX.to_f32()),
        };
        let values = tensor.flatten_all()?.to_vec1::<f32>()?;
        check_finite_in(path, &format!("not saved, {name}"), &values)?;
        if let Some(bad) = values.iter().find(|value| value.abs() > max) {
            return Err(Error::file(path, format!("not saved, {name}: expected at most {max}, found {bad}")));
        }
        let bytes: Vec<u8> = match stored {
            Stored::F32 => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
            Stored::F16 => values.iter().flat_map(|value| half::f16::from_f32(*value).to_le_bytes()).collect(),
        };
        data.push((name.as_str(), dtype, tensor.dims().to_vec(), bytes));
    }
    let invalid = |error| Error::file(path, format!("not saved: {error}"));
    let views = data
        .iter()
        .map(|(name, dtype, dims, bytes)| Ok((*name, TensorView::new(*dtype, dims.clone(), bytes)?)))
        .collect::<std::result::Result<Vec<_>, safetensors::SafeTensorError>>()
        .map_err(invalid)?;
    file::tensors::to_bytes(path, views, map)
}
