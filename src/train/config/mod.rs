//! Configuration of a training run, one YAML file.

mod check;
mod sections;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_yaml::Value;

use super::source::TrainingSource;
use crate::error::{Error, Result};
use crate::file::{input, limits};
use crate::model::{self, Precision};
use crate::text::parse_yaml;

pub(super) use check::MAX_BATCH;
pub use sections::{AugmentConfig, BatchConfig, LossWeights, OptimizerConfig, SamplingConfig};

/// Configuration of a run as written in YAML; unknown keys are refused. Paths are relative to the current folder.
///
/// Training relies on the ranges that [`Config::read`] and [`Config::check`] check.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Name that the checkpoint carries.
    pub name: String,
    /// Training data: stores, or folders of `*.zarr`.
    pub data: Vec<TrainingSource>,
    /// Mixing of the sources.
    #[serde(default)]
    pub sampling: SamplingConfig,
    /// Held-out stores for validation; may be empty.
    #[serde(default)]
    pub validation: Vec<PathBuf>,
    /// Left MANO file: labels of all stores are carried over to MANO's vertices, and the checkpoint is of that topology. Not
    /// without `mano_right`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mano_left: Option<PathBuf>,
    /// Right MANO file; not without `mano_left`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mano_right: Option<PathBuf>,
    /// Folder for `checkpoint.safetensors`, `state.safetensors`, `config.yaml`, `log.csv` and `curves.png`.
    pub out: PathBuf,
    /// Geometry of the network: the name of a preset, all keys, or `init` for the geometry of the initial checkpoint.
    pub model: ModelChoice,
    /// Checkpoint with the initial weights, or `shipped` for the one shipped with egotac; without it they are random.
    #[serde(default)]
    pub init: Option<PathBuf>,
    /// Checkpoint with the initial weights of the encoder alone; not together with `init`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub encoder: Option<PathBuf>,
    /// Seed of weights, order of the data and augmentation.
    pub seed: u64,
    /// Seconds between observation steps.
    #[serde(default = "default_frame_dt")]
    pub frame_dt: f64,
    /// Number format of forward and backward pass: f32 or bf16. On a GPU, bf16 is faster and takes half the memory for activations. On a
    /// CPU only the products of linear layers take bf16: faster where the processor has a matrix unit (AMX), elsewhere slower than f32.
    /// Weights, optimiser, losses and their gradients are f32 in both cases.
    #[serde(default)]
    pub precision: Precision,
    /// Optimisation steps.
    pub steps: usize,
    /// Size of a step.
    #[serde(default)]
    pub batch: BatchConfig,
    /// AdamW and its schedule.
    #[serde(default)]
    pub optimizer: OptimizerConfig,
    /// Weights of the objective.
    #[serde(default)]
    pub loss: LossWeights,
    /// Image augmentation.
    #[serde(default)]
    pub augment: AugmentConfig,
    /// Decay per step of the exponential moving average of the weights; the average is scored and saved. 0 = no averaging.
    #[serde(default = "default_ema")]
    pub ema: f64,
    /// Steps between saves of the resumable state.
    #[serde(default = "default_every")]
    pub save_every: usize,
    /// Steps between validations on the held-out stores.
    #[serde(default = "default_every")]
    pub validate_every: usize,
    /// Threads that load and augment batches.
    #[serde(default = "default_threads")]
    pub threads: usize,
    /// True keeps the stores in memory; false reads each clip when it is needed.
    #[serde(default = "default_true")]
    pub in_memory: bool,
}

/// Value of [`Config::model`] that takes the geometry of the initial checkpoint.
const AS_INIT: &str = "init";

/// Choice of the network's geometry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum ModelChoice {
    /// Name of a preset, or `init`.
    Preset(String),
    /// All keys of the network's configuration.
    Explicit(model::Config),
}

impl Config {
    /// Reads and checks a YAML file.
    ///
    /// # Errors
    /// If it can't be read, is not YAML, a key is unknown, missing or of another type, or a value is out of range.
    pub fn read(path: &Path) -> Result<Self> {
        let config = Self::read_unchecked(path)?;
        config.check().map_err(|e| Error::file(path, e))?;
        Ok(config)
    }

    /// Reads a YAML file without checking its values; the caller must call [`Config::check`].
    ///
    /// # Errors
    /// If it can't be read, is not YAML, or a key is unknown, missing or of another type.
    pub fn read_unchecked(path: &Path) -> Result<Self> {
        Self::read_with(path, &[])
    }

    /// As [`Config::read_unchecked`], with `values` in place of those of the file: pairs of a key, dotted as in
    /// `optimizer.learning_rate` or `data.0.quota`, and its value in YAML.
    ///
    /// # Errors
    /// As [`Config::read_unchecked`], or if a key leads into a value that has no keys, or a value is not YAML.
    pub fn read_with(path: &Path, values: &[(String, String)]) -> Result<Self> {
        let text = input::read_text(path, limits::TEXT)?;
        let mut config: Self = match values {
            [] => parse_yaml(&text).map_err(|e| Error::file(path, e))?,
            values => {
                let mut whole: Value = parse_yaml(&text).map_err(|e| Error::file(path, e))?;
                for (key, value) in values {
                    let value = parse_yaml(value).map_err(|e| Error::value(key, "a value in YAML", e))?;
                    *place(&mut whole, key)? = value;
                }
                let names: Vec<&str> = values.iter().map(|(key, _)| key.as_str()).collect();
                let with = |e| Error::file(path, format!("with other values of {}: {e}", names.join(", ")));
                serde_yaml::from_value(whole).map_err(with)?
            }
        };
        if config.init.as_deref() == Some(Path::new("shipped")) {
            config.init = Some(model::shipped::path()?);
        }
        Ok(config)
    }

    /// Returns the network's geometry.
    ///
    /// # Errors
    /// If the preset is unknown, the geometry is invalid, or it is that of a checkpoint that is missing or can't be read.
    pub fn geometry(&self) -> Result<model::Config> {
        match &self.model {
            ModelChoice::Preset(name) if name == AS_INIT => match &self.init {
                Some(path) => model::checkpoint::geometry(path),
                None => Err(Error::value("model", "a preset or a geometry, as no init names a checkpoint", AS_INIT)),
            },
            ModelChoice::Preset(name) => model::Config::preset(name),
            ModelChoice::Explicit(config) => config.check().map(|()| config.clone()),
        }
    }

    /// Returns the configuration of the one process whose batches are those of `ranks` ranks.
    ///
    /// # Errors
    /// If their clips are more than a step may have.
    pub(super) fn of_ranks(&self, ranks: usize) -> Result<Self> {
        let clips = self.batch.clips.saturating_mul(ranks);
        match clips <= MAX_BATCH {
            true => Ok(Self { batch: BatchConfig { clips, ..self.batch }, ..self.clone() }),
            false => {
                Err(Error::value("batch.clips", format!("{MAX_BATCH} or fewer clips of all {ranks} ranks"), clips))
            }
        }
    }

    /// Returns the factor on the encoder's learning rate.
    pub fn encoder_factor(&self) -> f64 {
        let trained = self.init.is_some() || self.encoder.is_some();
        self.optimizer.encoder_factor.unwrap_or(if trained { 0.1 } else { 1.0 })
    }

    /// Returns true if each frame has to be encoded only once: the encoder does not learn, and augmentation changes no pixel.
    pub fn keeps_tokens(&self) -> bool {
        self.encoder_factor() <= 0.0 && self.augment.keeps_pixels()
    }

    /// Returns the learning rate of step `step`, counted from 0: linear warm-up, then cosine decay.
    pub fn learning_rate(&self, step: usize) -> f64 {
        let OptimizerConfig { learning_rate, final_learning_rate, warmup, .. } = self.optimizer;
        let warmup_steps = (warmup * self.steps as f64).ceil();
        let step = step as f64;
        if step < warmup_steps {
            return learning_rate * (step + 1.0) / warmup_steps;
        }
        let progress = (step - warmup_steps) / (self.steps as f64 - 1.0 - warmup_steps).max(1.0);
        let cosine = 0.5 * (1.0 + (std::f64::consts::PI * progress.min(1.0)).cos());
        final_learning_rate + (learning_rate - final_learning_rate) * cosine
    }
}

/// Returns the place of a dotted key in a YAML document; keys that are missing are added.
fn place<'a>(document: &'a mut Value, key: &str) -> Result<&'a mut Value> {
    let mut at = document;
    for part in key.split('.') {
        if at.is_null() {
            *at = Value::Mapping(Default::default());
        }
        at = match at {
            Value::Mapping(map) => map.entry(part.into()).or_insert(Value::Null),
            Value::Sequence(list) => {
                let index = part.parse::<usize>().ok().filter(|index| *index < list.len());
                let expected = || Error::value(key, format!("an index below {}", list.len()), part);
                let index = index.ok_or_else(expected)?;
                &mut list[index]
            }
            _ => return Err(Error::value(key, "a key that holds others before the dot", part)),
        };
    }
    Ok(at)
}

fn default_frame_dt() -> f64 {
    0.12
}

fn default_ema() -> f64 {
    0.999
}

fn default_every() -> usize {
    500
}

fn default_threads() -> usize {
    2
}

fn default_true() -> bool {
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    const MINIMAL: &str = "{name: a, data: [.], out: x, model: toy, seed: 1, steps: 100}";

    #[test]
    fn config_with_unknown_key_or_value_out_of_range_is_refused() {
        let parsed = |text: &str| -> std::result::Result<Config, String> {
            let config: Config = serde_yaml::from_str(text).map_err(|e| e.to_string())?;
            config.check().map_err(|e| e.to_string())?;
            Ok(config)
        };
        parsed(MINIMAL).unwrap();
        for (added, names) in [
            ("stepz: 4", "stepz"),
            ("batch: {clip: 4}", "clip"),
            ("batch: {clips: 0}", "batch.clips"),
            ("frame_dt: 0", "frame_dt"),
            ("frame_dt: .nan", "frame_dt"),
            ("optimizer: {final_learning_rate: 1}", "optimizer.final_learning_rate"),
            ("loss: {force: 0, contact: 0, active: 0}", "loss"),
            ("loss: {consistency: -1}", "loss.consistency"),
            ("sampling: {temperature: -0.5}", "sampling.temperature"),
            ("sampling: {epoch: 0}", "sampling.epoch"),
            ("batch: {accumulate: 0}", "batch.accumulate"),
            ("threads: 1000000", "threads: expected 1 to 256"),
            ("batch: {accumulate: 1152921504606846976}", "batch.accumulate: expected 1 to 65536"),
            ("sampling: {epoch: 17179869184}", "sampling.epoch: expected 1 to 16777216"),
            ("augment: {mirror: 2}", "augment.mirror"),
            ("validation: [no/such/store]", "no/such/store"),
            ("encoder: no/such/checkpoint", "no/such/checkpoint"),
            ("encoder: ., init: .", "encoder"),
            ("mano_left: .", "mano_left and mano_right"),
            ("mano_left: ., mano_right: no/such/file", "no/such/file"),
            ("loss: {force: 0, contact: 0, active: 0, keypoints: 0}", "loss"),
        ] {
            let error = parsed(&MINIMAL.replace('}', &format!(", {added}}}"))).unwrap_err();
            assert!(error.contains(names), "{added}: {error}");
        }
        for (data, names) in [
            ("{stores: [.], quota: 1.5}", "data[0].quota"),
            ("{stores: [.], quota: 0.7}, {stores: [.], quota: 0.7}", "sum of quotas"),
            ("{stores: []}", "data.stores"),
            ("{stores: [.], mirrors: true}", "mirrors"),
        ] {
            let error = parsed(&MINIMAL.replace("data: [.]", &format!("data: [{data}]"))).unwrap_err();
            assert!(error.contains(names), "{data}: {error}");
        }
        let steps = parsed(&MINIMAL.replace("steps: 100", "steps: 17179869184")).unwrap_err();
        assert!(steps.contains("steps: expected 1 to 1073741824"), "{steps}");
        assert!(parsed(&MINIMAL.replace("toy", "huge")).unwrap_err().contains("pocket"));
        assert!(parsed(&MINIMAL.replace("toy", "init")).unwrap_err().contains("no init names a checkpoint"));
        let absent = MINIMAL.replace("toy", "init, init: no/such/checkpoint");
        assert!(parsed(&absent).unwrap_err().contains("no/such/checkpoint"));
    }

    #[test]
    fn dotted_keys_replace_values_of_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.yaml");
        std::fs::write(&path, MINIMAL).unwrap();
        let read = |values: &[(&str, &str)]| {
            let values: Vec<_> = values.iter().map(|(key, value)| (key.to_string(), value.to_string())).collect();
            Config::read_with(&path, &values).map_err(|error| error.to_string())
        };
        let config =
            read(&[("steps", "7"), ("loss.keypoints", "0.3"), ("data.0", "b.zarr"), ("validation", "[c]")]).unwrap();
        assert_eq!((config.steps, config.loss.keypoints), (7, 0.3));
        assert_eq!(config.data[0].stores, [PathBuf::from("b.zarr")]);
        assert_eq!(config.validation, [PathBuf::from("c")]);
        assert_eq!(config.loss.force, LossWeights::default().force);
        for (key, value, names) in [
            ("stepz", "7", "stepz"),
            ("loss.keypoint", "1", "keypoint"),
            ("steps", "many", "steps"),
            ("steps.a", "1", "steps.a"),
            ("data.3", "b", "data.3"),
            ("name", "[", "name"),
        ] {
            let error = read(&[(key, value)]).unwrap_err();
            assert!(error.contains(names), "{key}: {error}");
        }
        assert!(read(&[("init", "shipped")]).unwrap().init.unwrap().is_file());
    }

    #[test]
    fn a_trained_encoder_learns_at_a_tenth_of_the_rate_by_default() {
        let of = |added: &str| -> Config { serde_yaml::from_str(&MINIMAL.replace('}', added)).unwrap() };
        assert_eq!(of("}").encoder_factor(), 1.0);
        assert_eq!(of(", init: a.safetensors}").encoder_factor(), 0.1);
        assert_eq!(of(", encoder: a.safetensors}").encoder_factor(), 0.1);
        assert_eq!(of(", init: a.safetensors, optimizer: {encoder_factor: 0.5}}").encoder_factor(), 0.5);
    }

    #[test]
    fn the_learning_rate_warms_up_to_its_peak_and_ends_at_its_final_value() {
        let config: Config = serde_yaml::from_str(MINIMAL).unwrap();
        let rates: Vec<f64> = (0..100).map(|step| config.learning_rate(step)).collect();
        assert!((rates[4] - 1e-4).abs() < 1e-12 && rates[0] < rates[1]);
        assert!(rates[5..].windows(2).all(|pair| pair[1] <= pair[0]));
        assert!((rates[99] - 1e-5).abs() < 1e-12);
    }
}
