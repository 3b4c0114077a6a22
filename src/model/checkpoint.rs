//! Checkpoints: weights in safetensors, with geometry and preparation of images in the file's metadata.

use std::collections::BTreeMap;
use std::path::Path;

use candle_core::{DType, Device, Tensor};
use candle_nn::var_builder::SimpleBackend as _;
use candle_nn::{Init, VarMap};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};

use super::loader::Loader;
use super::metadata::{Metadata, json, names};
use super::{Config, EgoTac, Precision};
use crate::error::{Error, Result};
use crate::file;

/// Prefix of the names of the encoder's tensors.
pub const ENCODER: &str = "encoder.";
/// Tensor of published DINOv2 checkpoints that only their own training uses; allowed in a file and ignored.
const MASK_TOKEN: &str = "encoder.embeddings.mask_token";

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
    /// SHA-256 of the file, lower-case hexadecimal, as `sha256sum` prints it.
    pub sha256: String,
}

impl Checkpoint {
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
        let bytes = read(path)?;
        let file = File::parse(path, &bytes)?;
        let sha256 = file::sha256(&bytes);
        drop(bytes);
        let metadata = Metadata::from_map(path, &file.metadata)?;
        let config = file.config(path)?;
        let model = file.model(path, &config, device, precision)?.compile(precision)?;
        Ok(Self { model, metadata, sha256 })
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
    let bytes = read(path)?;
    let file = File::parse(path, &bytes)?;
    let config = match config {
        Some(config) => config.clone(),
        None => file.config(path)?,
    };
    file.model(path, &config, device, Precision::F32)
}

/// Loads the network of a checkpoint in its trainable form, on the CPU: only that form has attention weights to show.
///
/// # Errors
/// As [`Checkpoint::load`].
pub fn load_uncompiled(path: &Path) -> Result<(EgoTac, Metadata)> {
    let bytes = read(path)?;
    let file = File::parse(path, &bytes)?;
    let metadata = Metadata::from_map(path, &file.metadata)?;
    let config = file.config(path)?;
    Ok((file.model(path, &config, &Device::Cpu, Precision::F32)?, metadata))
}

/// Reads the geometry of a checkpoint.
///
/// # Errors
/// If the file can't be read or has no geometry.
pub fn geometry(path: &Path) -> Result<Config> {
    File::parse(path, &read(path)?)?.config(path)
}

/// Reads geometry, metadata and tensors of a checkpoint. The tensors are f32 on the CPU, and exactly those of the geometry.
///
/// # Errors
/// As [`Checkpoint::load`].
pub fn load_tensors(path: &Path) -> Result<(Config, Metadata, BTreeMap<String, Tensor>)> {
    let bytes = read(path)?;
    let file = File::parse(path, &bytes)?;
    let (config, metadata) = (file.config(path)?, Metadata::from_map(path, &file.metadata)?);
    check(path, &config, &file.tensors)?;
    Ok((config, metadata, file.tensors))
}

/// Sets the variables of a network in training to the weights of a file, all or none. Returns the metadata of the file, if
/// it has any.
///
/// # Errors
/// If the file can't be read, or its tensors are not exactly the variables, by name and shape.
pub fn load_variables(path: &Path, vars: &VarMap) -> Result<Option<Metadata>> {
    let bytes = read(path)?;
    let file = File::parse(path, &bytes)?;
    let metadata = match file.metadata.contains_key("topology") {
        true => Some(Metadata::from_map(path, &file.metadata)?),
        false => None,
    };
    let loader = Loader::new(file.tensors);
    let vars = lock(vars)?;
    let mut pairs = Vec::new();
    for (name, var) in vars.iter() {
        let tensor = loader.get(var.shape().clone(), name, Init::Const(0.0), var.dtype(), var.device())?;
        pairs.push((var, tensor));
    }
    loader.finish(path)?;
    for (var, tensor) in pairs {
        var.set(&tensor)?;
    }
    Ok(metadata)
}

/// Sets the encoder's variables of a network in training to those of a file, all or none; other tensors are ignored.
///
/// # Errors
/// If the file can't be read, or a tensor of the encoder is missing or of another shape.
pub fn load_encoder(path: &Path, vars: &VarMap) -> Result<()> {
    let mut tensors = read_tensors(path)?;
    let vars = lock(vars)?;
    let mut pairs = Vec::new();
    for (name, var) in vars.iter().filter(|(name, _)| name.starts_with(ENCODER)) {
        match tensors.remove(name) {
            Some(tensor) if tensor.dims() == var.dims() => pairs.push((var, tensor)),
            found => {
                let found = found.map_or("none".into(), |tensor| format!("{:?}", tensor.dims()));
                return Err(Error::file(path, format!("{name}: expected {:?}, found {found}", var.dims())));
            }
        }
    }
    for (var, tensor) in pairs {
        var.set(&tensor.to_dtype(var.dtype())?.to_device(var.device())?)?;
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
    let loader = Loader::new(BTreeMap::new());
    EgoTac::new(config, loader.var_builder(&Device::Cpu))?;
    Ok(loader.count())
}

/// Reads the tensors of a file as f32 on the CPU, by name: safetensors, or a PyTorch archive, whose code is not executed.
///
/// # Errors
/// If the file can't be read, is of neither format, or a tensor is of an unknown type or not finite.
pub fn read_tensors(path: &Path) -> Result<BTreeMap<String, Tensor>> {
    let bytes = read(path)?;
    if !bytes.starts_with(b"PK\x03\x04") {
        return Ok(File::parse(path, &bytes)?.tensors);
    }
    drop(bytes);
    let invalid = |error| Error::file(path, format!("not a PyTorch file of tensors: {error}"));
    // Some programs save the tensors at the top level, others in a dictionary under one of these names.
    let mut tensors = candle_core::pickle::read_all(path).map_err(invalid)?;
    for key in ["state_dict", "model", "model_state_dict"] {
        if tensors.is_empty() {
            tensors = candle_core::pickle::read_all_with_key(path, Some(key)).unwrap_or_default();
        }
    }
    if tensors.is_empty() {
        return Err(Error::file(
            path,
            "has no tensors, neither at the top nor under state_dict, model, model_state_dict",
        ));
    }
    let checked = |(name, tensor): (String, Tensor)| {
        let tensor = tensor.to_dtype(DType::F32)?.contiguous()?;
        let bad = tensor.flatten_all()?.to_vec1::<f32>()?.into_iter().find(|value| !value.is_finite());
        match bad {
            Some(bad) => Err(Error::file(path, format!("{name}: expected finite numbers, found {bad}"))),
            None => Ok((name, tensor)),
        }
    };
    tensors.into_iter().map(checked).collect()
}

/// A parsed safetensors file.
struct File {
    metadata: BTreeMap<String, String>,
    tensors: BTreeMap<String, Tensor>,
}

impl File {
    fn parse(path: &Path, bytes: &[u8]) -> Result<Self> {
        let invalid = |error| Error::file(path, format!("not a safetensors file: {error}"));
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(invalid)?;
        let metadata = header.metadata().clone().unwrap_or_default().into_iter().collect();
        let views = SafeTensors::deserialize(bytes).map_err(invalid)?;
        let tensors = views
            .iter()
            .filter(|(name, _)| *name != MASK_TOKEN)
            .map(|(name, view)| Ok((name.to_string(), tensor(path, name, &view)?)))
            .collect::<Result<_>>()?;
        Ok(Self { metadata, tensors })
    }

    fn config(&self, path: &Path) -> Result<Config> {
        let json = self.metadata.get("config").ok_or_else(|| Error::Missing {
            name: "metadata \"config\"".into(),
            place: path.display().to_string(),
            present: names(self.metadata.keys()),
        })?;
        Config::from_json(json).map_err(|error| Error::file(path, error))
    }

    /// Builds the network. On the CPU its tensors are f32 for every precision: the engine converts them when it compiles.
    fn model(self, path: &Path, config: &Config, device: &Device, precision: Precision) -> Result<EgoTac> {
        let dtype = if precision == Precision::Bf16 && !device.is_cpu() { DType::BF16 } else { DType::F32 };
        let loader = Loader::new(self.tensors);
        let model = EgoTac::new(config, loader.var_builder_of(dtype, device))?;
        loader.finish(path)?;
        Ok(model)
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
    if let Some(bad) = values.iter().find(|value| !value.is_finite()) {
        return Err(Error::file(path, format!("{name}: expected finite numbers, found {bad}")));
    }
    Ok(Tensor::from_vec(values, view.shape(), &Device::Cpu)?)
}

/// Checks that tensors are exactly those of a geometry.
///
/// # Errors
/// Names tensors that are missing, unexpected or of a wrong shape, and `path` as their file.
pub(super) fn check(path: &Path, config: &Config, tensors: &BTreeMap<String, Tensor>) -> Result<()> {
    let loader = Loader::new(tensors.clone());
    EgoTac::new(config, loader.var_builder(&Device::Cpu))?;
    loader.finish(path)
}

/// Returns the variables by name, as f32 on the CPU.
pub(super) fn variables(vars: &VarMap) -> Result<BTreeMap<String, Tensor>> {
    lock(vars)?
        .iter()
        .map(|(name, var)| Ok((name.clone(), var.as_tensor().to_device(&Device::Cpu)?.to_dtype(DType::F32)?)))
        .collect()
}

fn lock(vars: &VarMap) -> Result<std::sync::MutexGuard<'_, std::collections::HashMap<String, candle_core::Var>>> {
    vars.data().lock().map_err(|_| Error::value("variables", "a map in working order", "one whose thread panicked"))
}

/// Returns the bytes of a safetensors file. The metadata is written here, since the library writes it in random order.
fn serialize(
    path: &Path,
    tensors: &BTreeMap<String, Tensor>,
    map: &BTreeMap<String, String>,
    stored: Stored,
) -> Result<Vec<u8>> {
    let (dtype, max) = match stored {
        Stored::F32 => (Dtype::F32, f32::MAX),
        Stored::F16 => (Dtype::F16, half::f16::MAX.to_f32()),
    };
    let mut data = Vec::new();
    for (name, tensor) in tensors {
        let values = tensor.flatten_all()?.to_vec1::<f32>()?;
        if let Some(bad) = values.iter().find(|value| !value.is_finite()) {
            return Err(Error::file(path, format!("not saved, {name}: expected finite numbers, found {bad}")));
        }
        if let Some(bad) = values.iter().find(|value| value.abs() > max) {
            return Err(Error::file(path, format!("not saved, {name}: expected at most {max}, found {bad}")));
        }
        let bytes: Vec<u8> = match stored {
            Stored::F32 => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
            Stored::F16 => values.iter().flat_map(|value| half::f16::from_f32(*value).to_le_bytes()).collect(),
        };
        data.push((name.as_str(), tensor.dims().to_vec(), bytes));
    }
    let invalid = |error| Error::file(path, format!("not saved: {error}"));
    let views = data
        .iter()
        .map(|(name, dims, bytes)| Ok((*name, TensorView::new(dtype, dims.clone(), bytes)?)))
        .collect::<std::result::Result<Vec<_>, safetensors::SafeTensorError>>()
        .map_err(invalid)?;
    let plain = safetensors::serialize(views, None).map_err(invalid)?;
    // Layout: header length (8 bytes, little endian), header (JSON, padded with spaces to 8 bytes), data.
    let (length, rest) = plain.split_at(8);
    let length = length.iter().rev().fold(0, |sum, byte| sum << 8 | usize::from(*byte));
    let (header, data) = rest.split_at(length);
    let mut header = [br#"{"__metadata__":"#, json(map).as_bytes(), b",", &header[1..]].concat();
    header.resize(header.len().next_multiple_of(8), b' ');
    Ok([&(header.len() as u64).to_le_bytes(), header.as_slice(), data].concat())
}

fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(Error::io(path))
}
