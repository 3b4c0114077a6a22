//! Checkpoints: weights in safetensors, with everything a stranger needs to use them in the file's metadata.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Mutex;

use candle_core::{DType, Device, Shape, Tensor};
use candle_nn::var_builder::SimpleBackend;
use candle_nn::{Init, VarBuilder, VarMap};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::Serialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};

use super::{Config, EgoTac, Precision};
use crate::error::{Error, Result};
use crate::file;
use crate::image::{Filter, IMAGENET_MEAN, IMAGENET_STD, Preparation, Resize};
use crate::tactile::Topology;

/// Part of published DINOv2 checkpoints that inference never touches; allowed in a file and ignored.
const MASK_TOKEN: &str = "encoder.embeddings.mask_token";
/// Misfits named in one message.
const MAX_NAMED: usize = 8;

/// What a checkpoint says beside its weights; one key of the file's metadata per field.
#[derive(Debug, Clone, PartialEq)]
pub struct Metadata {
    /// Name of the model, e.g. for messages.
    pub name: String,
    /// What the vertex indices mean.
    pub topology: Topology,
    /// N per unit of the force head's output: 99th percentile of the active training force.
    pub force_scale: f32,
    /// Whether the force head was trained; if not, forces are unknown (NaN).
    pub has_force: bool,
    /// Seconds between observation steps.
    pub frame_dt: f64,
    /// How images become the square input.
    pub resize: Resize,
    /// Resampling filter.
    pub filter: Filter,
    /// Mean per RGB channel, of values in 0..1.
    pub mean: [f32; 3],
    /// Standard deviation per RGB channel, of values in 0..1.
    pub std: [f32; 3],
    /// Data, command, seed and metrics of the training, free text (JSON by our own training).
    pub training: String,
}

impl Metadata {
    /// Of a network on our built-in hand with ImageNet statistics; `force_scale` in N, `frame_dt` in s.
    pub fn new(name: impl Into<String>, force_scale: f32, frame_dt: f64) -> Self {
        Self {
            name: name.into(),
            topology: Topology::default(),
            force_scale,
            has_force: true,
            frame_dt,
            resize: Resize::default(),
            filter: Filter::default(),
            mean: IMAGENET_MEAN,
            std: IMAGENET_STD,
            training: String::new(),
        }
    }

    /// How images become the input of a network of this geometry.
    pub fn preparation(&self, config: &Config) -> Preparation {
        Preparation { side: config.image, resize: self.resize, filter: self.filter, mean: self.mean, std: self.std }
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// Names the first field that is out of range.
    pub fn check(&self) -> Result<()> {
        let positive = |name: &str, value: f64| match value.is_finite() && value > 0.0 {
            true => Ok(()),
            false => Err(Error::value(name, "a finite number > 0", value)),
        };
        positive("force_scale", f64::from(self.force_scale))?;
        positive("frame_dt", self.frame_dt)?;
        self.std.iter().try_for_each(|std| positive("std", f64::from(*std)))?;
        match self.mean.iter().find(|mean| !mean.is_finite()) {
            Some(mean) => Err(Error::value("mean", "finite numbers", mean)),
            None => Ok(()),
        }
    }

    /// As the file's metadata holds it: strings; numbers, flags and lists in JSON.
    pub fn to_map(&self) -> BTreeMap<String, String> {
        let enum_name = |name: String| name.trim_matches('"').to_string();
        BTreeMap::from([
            ("name".into(), self.name.clone()),
            ("topology".into(), self.topology.id().into()),
            ("force_scale".into(), json(&self.force_scale)),
            ("has_force".into(), json(&self.has_force)),
            ("frame_dt".into(), json(&self.frame_dt)),
            ("resize".into(), enum_name(json(&self.resize))),
            ("filter".into(), enum_name(json(&self.filter))),
            ("mean".into(), json(&self.mean)),
            ("std".into(), json(&self.std)),
            ("training".into(), self.training.clone()),
        ])
    }

    fn from_map(path: &Path, map: &BTreeMap<String, String>) -> Result<Self> {
        let text = |key: &str| {
            map.get(key).cloned().ok_or_else(|| Error::Missing {
                name: format!("metadata {key:?}"),
                place: path.display().to_string(),
                present: names(map.keys()),
            })
        };
        fn parse<T: DeserializeOwned>(path: &Path, key: &str, json: &str, expected: &str) -> Result<T> {
            serde_json::from_str(json)
                .map_err(|_| Error::file(path, format!("metadata {key:?}: expected {expected}, got {json:?}")))
        }
        let quoted = |key: &str| Ok::<_, Error>(json(&text(key)?));
        let metadata = Self {
            name: text("name")?,
            topology: Topology::from_id(&text("topology")?)?,
            force_scale: parse(path, "force_scale", &text("force_scale")?, "a number, newtons")?,
            has_force: parse(path, "has_force", &text("has_force")?, "true or false")?,
            frame_dt: parse(path, "frame_dt", &text("frame_dt")?, "a number, seconds")?,
            resize: parse(path, "resize", &quoted("resize")?, "crop, centre, letterbox or squash")?,
            filter: parse(path, "filter", &quoted("filter")?, "triangle or bicubic")?,
            mean: parse(path, "mean", &text("mean")?, "three numbers in brackets")?,
            std: parse(path, "std", &text("std")?, "three numbers in brackets")?,
            training: text("training")?,
        };
        metadata.check().map_err(|error| Error::file(path, error))?;
        Ok(metadata)
    }
}

/// A network ready to run, with what its file says.
#[derive(Debug, Clone)]
pub struct Checkpoint {
    /// The frozen network.
    pub model: EgoTac,
    /// What the file says beside the weights.
    pub metadata: Metadata,
    /// SHA-256 of the file, lower-case hexadecimal, as `sha256sum` prints it.
    pub sha256: String,
}

impl Checkpoint {
    /// Loads a checkpoint that says everything a predictor needs.
    ///
    /// # Errors
    /// If the file can't be read, a key of the metadata is missing or out of range, or a tensor is missing, unexpected,
    /// misshapen, of an unknown type or not finite.
    pub fn load(path: &Path, device: &Device) -> Result<Self> {
        Self::load_as(path, device, Precision::F32)
    }

    /// As [`Checkpoint::load`], compiled in the wanted precision.
    ///
    /// # Errors
    /// As [`Checkpoint::load`], and if the device has no such precision (int8 is for the CPU).
    pub fn load_as(path: &Path, device: &Device, precision: Precision) -> Result<Self> {
        let bytes = read(path)?;
        let file = File::parse(path, &bytes)?;
        let sha256 = hex(&Sha256::digest(&bytes));
        drop(bytes);
        let metadata = Metadata::from_map(path, &file.metadata)?;
        let config = file.config(path)?;
        let model = file.model(path, &config, device, precision)?.compile(precision)?;
        Ok(Self { model, metadata, sha256 })
    }

    /// Saves the variables of a network in training, whole or not at all. Returns the file's SHA-256.
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
        metadata.check()?;
        check(path, config, tensors)?;
        let mut map = metadata.to_map();
        map.insert("config".into(), config.to_json());
        let bytes = serialize(path, tensors, &map)?;
        file::write(path, &bytes)?;
        Ok(hex(&Sha256::digest(&bytes)))
    }
}

/// Loads the network alone, not yet compiled: for files that say nothing but their weights and perhaps their geometry.
///
/// `config` is used in place of the file's own.
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

/// Loads a checkpoint's network not yet compiled, on the CPU: its attention can be looked at.
///
/// # Errors
/// As [`Checkpoint::load`].
pub fn load_layers(path: &Path) -> Result<(EgoTac, Metadata)> {
    let bytes = read(path)?;
    let file = File::parse(path, &bytes)?;
    let metadata = Metadata::from_map(path, &file.metadata)?;
    let config = file.config(path)?;
    Ok((file.model(path, &config, &Device::Cpu, Precision::F32)?, metadata))
}

/// Sets the variables of a network in training to a file's weights, all or none. Returns what the file says of itself
/// beside its weights, if it does.
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

/// Saves tensors under their names, without metadata, whole or not at all; f32.
///
/// # Errors
/// If a value is not finite or the file can't be written.
pub fn save_tensors(path: &Path, tensors: &BTreeMap<String, Tensor>) -> Result<()> {
    file::write(path, &serialize(path, tensors, &BTreeMap::new())?)
}

/// Parameters of a network of this geometry.
///
/// # Errors
/// If the configuration does not pass its check.
pub fn parameter_count(config: &Config) -> Result<usize> {
    let loader = Loader::new(BTreeMap::new());
    EgoTac::new(config, loader.var_builder(&Device::Cpu))?;
    loader.0.asked.lock().map(|asked| asked.count).map_err(|_| Error::value("loader", "an intact one", "a dead one"))
}

/// A file's tensors as f32 on the CPU, by name: safetensors, or a PyTorch archive, which is read without executing what
/// it asks for.
///
/// # Errors
/// If the file can't be read, is neither, or a tensor is of an unknown type or not finite.
pub fn read_tensors(path: &Path) -> Result<BTreeMap<String, Tensor>> {
    let bytes = read(path)?;
    if !bytes.starts_with(b"PK\x03\x04") {
        return Ok(File::parse(path, &bytes)?.tensors);
    }
    drop(bytes);
    let invalid = |error| Error::file(path, format!("not a PyTorch file of tensors: {error}"));
    // Some programs save the tensors themselves, others a dictionary that has them under one of these names.
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

/// A parsed file.
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

    /// The engine of the CPU takes f32, whatever it makes of it.
    fn model(self, path: &Path, config: &Config, device: &Device, precision: Precision) -> Result<EgoTac> {
        let dtype = if precision == Precision::Bf16 && !device.is_cpu() { DType::BF16 } else { DType::F32 };
        let loader = Loader::new(self.tensors);
        let model = EgoTac::new(config, loader.var_builder_of(dtype, device))?;
        loader.finish(path)?;
        Ok(model)
    }
}

/// Hands out tensors to constructors and writes down every misfit, so that one message can name them all.
#[derive(Clone)]
struct Loader(std::sync::Arc<LoaderState>);

struct LoaderState {
    tensors: BTreeMap<String, Tensor>,
    asked: Mutex<Asked>,
}

#[derive(Default)]
struct Asked {
    names: BTreeSet<String>,
    count: usize,
    misfits: Vec<String>,
}

impl Loader {
    fn new(tensors: BTreeMap<String, Tensor>) -> Self {
        Self(std::sync::Arc::new(LoaderState { tensors, asked: Mutex::default() }))
    }

    fn var_builder(&self, device: &Device) -> VarBuilder<'static> {
        self.var_builder_of(DType::F32, device)
    }

    fn var_builder_of(&self, dtype: DType, device: &Device) -> VarBuilder<'static> {
        VarBuilder::from_backend(Box::new(self.clone()), dtype, device.clone())
    }

    /// Says what did not fit, once everything has been asked for.
    fn finish(&self, path: &Path) -> Result<()> {
        let Ok(asked) = self.0.asked.lock() else { return Err(Error::file(path, "a thread died while loading")) };
        let unexpected = self.0.tensors.iter().filter(|(name, _)| !asked.names.contains(*name));
        let unexpected = unexpected.map(|(name, t)| format!("{name}: expected no such tensor, found {:?}", t.dims()));
        let misfits: Vec<String> = asked.misfits.iter().cloned().chain(unexpected).collect();
        if misfits.is_empty() {
            return Ok(());
        }
        let more = match misfits.len() {
            n if n > MAX_NAMED => format!("; and {} more", n - MAX_NAMED),
            _ => String::new(),
        };
        let named = misfits[..misfits.len().min(MAX_NAMED)].join("; ");
        Err(Error::file(path, format!("{} of the network's tensors do not fit: {named}{more}", misfits.len())))
    }
}

impl SimpleBackend for Loader {
    fn get(&self, shape: Shape, name: &str, _: Init, dtype: DType, device: &Device) -> candle_core::Result<Tensor> {
        let Ok(mut asked) = self.0.asked.lock() else { candle_core::bail!("a thread died while loading") };
        asked.names.insert(name.to_string());
        asked.count += shape.elem_count();
        let found = match self.0.tensors.get(name) {
            Some(tensor) if tensor.shape() == &shape => return tensor.to_device(device)?.to_dtype(dtype),
            Some(tensor) => format!("found {:?}", tensor.dims()),
            None => "found none".into(),
        };
        asked.misfits.push(format!("{name}: expected {:?}, {found}", shape.dims()));
        // Goes on with zeros; `finish` turns the misfits into the error.
        Tensor::zeros(shape, dtype, device)
    }

    fn get_unchecked(&self, name: &str, _: DType, _: &Device) -> candle_core::Result<Tensor> {
        candle_core::bail!("tensor {name} was asked for without a shape")
    }

    fn contains_tensor(&self, name: &str) -> bool {
        self.0.tensors.contains_key(name)
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
/// Names what is missing, unexpected or misshapen, and `path` as their home.
pub(super) fn check(path: &Path, config: &Config, tensors: &BTreeMap<String, Tensor>) -> Result<()> {
    let loader = Loader::new(tensors.clone());
    EgoTac::new(config, loader.var_builder(&Device::Cpu))?;
    loader.finish(path)
}

/// The variables by name, on the CPU.
pub(super) fn variables(vars: &VarMap) -> Result<BTreeMap<String, Tensor>> {
    lock(vars)?
        .iter()
        .map(|(name, var)| Ok((name.clone(), var.as_tensor().to_device(&Device::Cpu)?.to_dtype(DType::F32)?)))
        .collect()
}

fn lock(vars: &VarMap) -> Result<std::sync::MutexGuard<'_, std::collections::HashMap<String, candle_core::Var>>> {
    vars.data().lock().map_err(|_| Error::value("variables", "an intact map", "one that a thread died in"))
}

/// The bytes of a safetensors file; the library would write the metadata in random order.
fn serialize(path: &Path, tensors: &BTreeMap<String, Tensor>, map: &BTreeMap<String, String>) -> Result<Vec<u8>> {
    let mut data = Vec::new();
    for (name, tensor) in tensors {
        let values = tensor.flatten_all()?.to_vec1::<f32>()?;
        if let Some(bad) = values.iter().find(|value| !value.is_finite()) {
            return Err(Error::file(path, format!("not saved, {name}: expected finite numbers, found {bad}")));
        }
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        data.push((name.as_str(), tensor.dims().to_vec(), bytes));
    }
    let invalid = |error| Error::file(path, format!("not saved: {error}"));
    let views = data
        .iter()
        .map(|(name, dims, bytes)| Ok((*name, TensorView::new(Dtype::F32, dims.clone(), bytes)?)))
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

/// JSON of a plain value, which has no way to fail.
fn json<T: Serialize + ?Sized>(value: &T) -> String {
    serde_json::to_string(value).unwrap_or_default()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn names<'a>(names: impl Iterator<Item = &'a String>) -> String {
    let names: Vec<&str> = names.map(String::as_str).collect();
    if names.is_empty() { "nothing".into() } else { names.join(", ") }
}
