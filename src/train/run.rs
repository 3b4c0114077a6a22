//! Validation and saving of a run's weights.

use std::fs::{self, File, OpenOptions};
use std::path::{Path, PathBuf};

use candle_core::{Device, Tensor};
use candle_nn::VarMap;

use super::checkpoint::Progress;
use super::config::Config;
use super::optimizer::AdamW;
use super::setup::Data;
use super::{Started, checkpoint, familiarity, keypoints, predict, presence};
use crate::error::{Error, Result};
use crate::file::{self, input, limits};
use crate::model::{self, Checkpoint, EgoTac, Metadata};
use crate::score::metrics::{self, EvalOptions, Metrics};

/// Locks a folder for one run; the lock ends with the returned file.
///
/// # Errors
/// If another run has locked it, or the folder can't be written.
pub fn lock_folder(folder: &Path) -> Result<File> {
    fs::create_dir_all(folder).map_err(Error::io(folder))?;
    let path = folder.join(".lock");
    let lock = OpenOptions::new().create(true).append(true).open(&path).map_err(Error::io(&path))?;
    match file::lock(&lock) {
        true => Ok(lock),
        false => Err(Error::file(folder, "another run trains in this folder: wait for its end, or choose another one")),
    }
}

/// Files in the folder of a run, which is locked as long as they are used.
pub struct Files {
    /// Resumable state.
    pub state: PathBuf,
    /// Checkpoint with the averaged weights.
    pub checkpoint: PathBuf,
    /// CSV file with one line per step.
    pub log: PathBuf,
    config: PathBuf,
    /// The configuration as YAML; identifies the run.
    pub yaml: String,
    _lock: File,
}

impl Files {
    /// Locks the folder of the run and names its files.
    ///
    /// # Errors
    /// If another run trains in the folder, or it holds the state of a run that is not to be resumed.
    pub fn new(config: &Config, resume: bool) -> Result<Self> {
        let yaml = serde_yaml::to_string(config).map_err(|e| Error::value("config", "one that YAML can hold", e))?;
        let folder = &config.out;
        let [state, checkpoint, log, config] =
            ["state.safetensors", "checkpoint.safetensors", "log.csv", "config.yaml"].map(|name| folder.join(name));
        let lock = lock_folder(folder)?;
        match !resume && state.exists() {
            true => Err(Error::file(&state, "a run lies there already: resume it, or choose another folder")),
            false => Ok(Self { state, checkpoint, log, config, yaml, _lock: lock }),
        }
    }

    /// Restores the state that the run of `steps` steps saved last. Returns its progress: no steps and `ranks`, with the beginning left as it
    /// is, if the run was stopped before its first save.
    ///
    /// # Errors
    /// If the state can't be read, or the folder is that of a run with another configuration.
    pub fn resume(&self, optimizer: &mut AdamW, steps: usize, ranks: usize) -> Result<Progress> {
        if self.state.exists() {
            return checkpoint::load(&self.state, optimizer, &self.yaml, steps);
        }
        if self.config.exists() {
            checkpoint::check_config(&self.config, &input::read_text(&self.config, limits::TEXT)?, &self.yaml)?;
        }
        Ok(Progress { step: 0, ranks })
    }

    /// Writes the configuration beside the weights.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn write_config(&self) -> Result<()> {
        file::write(&self.config, self.yaml.as_bytes())
    }
}

/// The parts of a run that stay the same from step to step.
pub struct Run<'a> {
    pub config: &'a Config,
    pub geometry: &'a model::Config,
    pub data: &'a Data,
    pub files: &'a Files,
    pub started: &'a Started,
    pub device: &'a Device,
    /// Ranks that the run began with.
    pub began: usize,
}

impl Run<'_> {
    /// Scores the averaged weights on the held-out stores; None without such stores.
    ///
    /// # Errors
    /// If a store can't be read, or the network gives a number that is not finite.
    pub fn validate(&self, optimizer: &AdamW) -> Result<Option<Metrics>> {
        let Some((held_out, truth)) = &self.data.validation else { return Ok(None) };
        let network = self.network(&self.averaged(optimizer)?)?;
        let predicted = predict(&network, &self.data.metadata, held_out, self.device, |_| ())?;
        metrics::evaluate(&predicted, truth, &EvalOptions::default()).map(Some)
    }

    /// Saves the resumable state and the checkpoint with the averaged weights; returns the checkpoint's SHA-256.
    ///
    /// # Errors
    /// If a file can't be written.
    pub fn save(&self, optimizer: &AdamW, step: usize, validated: Option<&(usize, Metrics)>) -> Result<String> {
        checkpoint::save(&self.files.state, optimizer, Progress { step, ranks: self.began }, &self.files.yaml)?;
        let metadata = self.metadata(step, validated);
        Checkpoint::save(&self.files.checkpoint, self.geometry, &metadata, &self.averaged(optimizer)?)
    }

    /// As [`Run::save`], at the end of a run: with `measured`, the checkpoint also gets the statistics of its features, and in a
    /// run with the keypoint task the estimate of presence and keypoints, if the stores hold enough frames. A run that is told to end at once has no time for them.
    ///
    /// # Errors
    /// If a file can't be written, a store can't be read, or the network gives a number that is not finite.
    pub fn finish(
        &self,
        optimizer: &AdamW,
        step: usize,
        validated: Option<&(usize, Metrics)>,
        measured: bool,
    ) -> Result<String> {
        if !measured {
            return self.save(optimizer, step, validated);
        }
        checkpoint::save(&self.files.state, optimizer, Progress { step, ranks: self.began }, &self.files.yaml)?;
        let averaged = self.averaged(optimizer)?;
        let held_out = self.data.validation.as_ref().map(|(held_out, _)| held_out);
        let network = self.network(&averaged)?;
        let statistics = familiarity::measure_if_enough(&network, &self.data.training, held_out, self.device)?;
        let mut tensors = model::checkpoint::variables(&averaged)?;
        if let Some(statistics) = statistics {
            tensors.extend(statistics.tensors()?);
        }
        if let Some(layer) = self.keypoint_layer(optimizer)? {
            // The stores say where the hands are: what the network has learned of keypoints is kept.
            let fitted = presence::fit_if_enough(&network, &self.data.training, self.config.seed, Some(layer))?;
            tensors.extend(fitted.into_iter().flat_map(|fitted| fitted.tensors));
        }
        let metadata = self.metadata(step, validated);
        Checkpoint::save_tensors(&self.files.checkpoint, self.geometry, &metadata, &tensors)
    }

    /// Returns a network that infers with the averaged weights.
    fn network(&self, averaged: &VarMap) -> Result<EgoTac> {
        EgoTac::new(self.geometry, model::init::var_builder(averaged, self.config.seed, self.device))?.freeze()
    }

    /// Returns weight and bias of the trained keypoint logits of both hands, on the CPU; None in a run without the keypoint task.
    fn keypoint_layer(&self, optimizer: &AdamW) -> Result<Option<(Tensor, Tensor)>> {
        if self.config.loss.keypoints <= 0.0 {
            return Ok(None);
        }
        let mut varmap = VarMap::new();
        let vb = model::init::var_builder(&varmap, self.config.seed, self.device).pp("keypoints");
        let heads = keypoints::Heads::new(self.geometry, vb)?;
        optimizer.write_average(&mut varmap)?;
        heads.hand_logits().map(Some)
    }

    /// Returns the checkpoint's metadata after `step` steps.
    fn metadata(&self, step: usize, validated: Option<&(usize, Metrics)>) -> Metadata {
        let mut metadata = self.data.metadata.clone();
        // Scores of earlier weights are not those of the saved ones.
        let validation = validated.filter(|(at, _)| *at == step).map(|(_, metrics)| metrics);
        metadata.training = self.record(step, validation);
        metadata
    }

    /// Returns variables that hold the averaged weights.
    fn averaged(&self, optimizer: &AdamW) -> Result<VarMap> {
        let mut varmap = VarMap::new();
        // Creates the variables.
        EgoTac::new(self.geometry, model::init::var_builder(&varmap, self.config.seed, self.device))?;
        optimizer.write_average(&mut varmap)?;
        Ok(varmap)
    }

    /// Returns the checkpoint's record of its training, as JSON.
    fn record(&self, step: usize, validation: Option<&Metrics>) -> String {
        serde_json::json!({
            "config": self.config,
            "ranks": self.began,
            "steps": step,
            "frames": self.started.frames,
            "validation_frames": self.started.validation_frames,
            "validation": validation,
            "producer": concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")),
        })
        .to_string()
    }
}
