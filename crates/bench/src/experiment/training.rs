//! Runs of an experiment: configuration, training, prediction. What is finished is not made again.

use std::path::{Path, PathBuf};
use std::time::Instant;

use candle_core::Device;
use egotac::dataset::tensors;
use egotac::dataset::zarr::{self, ZarrReader};
use egotac::error::{Error, Result};
use egotac::file;
use egotac::model::{self, Checkpoint, Metadata, Precision, Predictor, Unknown, predictor};
use egotac::statistics::median;
use egotac::tactile::TactileSequence;
use egotac::train::config::{AugmentConfig, BatchConfig, LossWeights, ModelChoice, OptimizerConfig, SamplingConfig};
use egotac::train::data::Dataset;
use egotac::train::source::TrainingSource;
use egotac::train::{self, Config, Control, Event, crops, predict};

use super::arm::{Arm, Forces, View};
use super::data::{RATE, REPETITION, Stores};
use super::motion;
use super::network::Network;
use super::recipe::Recipe;
use super::{Setup, Size, measure};

/// Clips and windows of a training step. Runs are short: many small steps teach more than few large ones of the same time.
pub const BATCH: BatchConfig = BatchConfig { clips: 4, windows: 1, accumulate: 1 };
/// File name of a run's weights.
const CHECKPOINT: &str = "checkpoint.safetensors";
/// Producer of the stores of crops.
const PRODUCER: &str = "egotac experiment";

/// One training: an arm with a seed.
#[derive(Debug)]
pub struct Run<'a> {
    /// The arm.
    pub arm: &'a Arm,
    /// Seed, from 0.
    pub seed: u64,
    /// Configuration; its folder is named by its hash, so that experiments share equal runs.
    pub config: Config,
}

impl<'a> Run<'a> {
    /// Plans the run of an arm.
    ///
    /// # Errors
    /// If the arm names a world that does not exist.
    pub fn plan(arm: &'a Arm, seed: u64, stores: &Stores, setup: &Setup) -> Result<Self> {
        let mut config = usual(seed, stores, &setup.size, &setup.network)?;
        (arm.change)(&mut config, stores)?;
        if arm.view.is_cut() {
            let side = side_of(&config)?;
            // A mirrored crop would be one of a left hand, and all crops are of right hands.
            config.data.iter_mut().for_each(|source| {
                source.mirror = false;
                source.stores.iter_mut().for_each(|store| *store = cropped(store, side));
            });
        }
        if arm.forces == Forces::FromMotion {
            config.data.iter_mut().flat_map(|source| &mut source.stores).for_each(|store| *store = from_motion(store));
        }
        config.out = folder(&setup.work, &config, &setup.network)?;
        Ok(Self { arm, seed, config })
    }

    /// Returns the recipes of the stores that the run learns from.
    pub fn recipes(&self, stores: &Stores) -> Vec<Recipe> {
        let of = |path: &PathBuf| match stores.recordings().iter().find(|recorded| recorded.path == *path) {
            Some(recorded) => recorded.from.clone(),
            None => stores.recipe(&origin(path)).cloned().into_iter().collect(),
        };
        self.paths().iter().flat_map(of).collect()
    }

    fn paths(&self) -> Vec<PathBuf> {
        self.config.data.iter().flat_map(|source| source.stores.clone()).collect()
    }

    /// Trains the run, resumes it, or leaves it if it is finished.
    ///
    /// # Errors
    /// If a store can't be read or the training fails.
    pub fn train(&self, device: &Device, mut progress: impl FnMut(usize, usize)) -> Result<()> {
        let config = &self.config;
        if self.is_trained() {
            return Ok(());
        }
        for path in self.paths().iter().filter(|path| !path.exists()) {
            match (self.arm.view.is_cut(), self.arm.forces) {
                (true, _) => crops::write(&origin(path), path, side_of(config)?, PRODUCER).map(drop)?,
                (false, Forces::FromMotion) => motion::write(&origin(path), path)?,
                (false, Forces::True) => {}
            }
        }
        let resume = config.out.join("state.safetensors").exists();
        train::train(config, resume, device, &mut |event| {
            if let Event::Stepped(step) = event {
                progress(step.step, config.steps);
            }
            Control::Continue
        })?;
        Ok(())
    }

    /// Returns true if the run is finished; a stopped run has a checkpoint of fewer steps.
    pub fn is_trained(&self) -> bool {
        let steps = |record: &str| serde_json::from_str::<serde_json::Value>(record).ok()?["steps"].as_u64();
        Checkpoint::load(&self.config.out.join(CHECKPOINT), &Device::Cpu)
            .is_ok_and(|checkpoint| steps(&checkpoint.metadata.training) == Some(self.config.steps as u64))
    }

    /// Returns the file of the predictions on held-out stores. Arms that differ in how the hands are found share the network, not this.
    pub fn predictions(&self, worlds: &str) -> PathBuf {
        let found = if self.arm.view == View::Hands { "found." } else { "" };
        self.config.out.join(format!("{found}{worlds}.safetensors"))
    }

    /// Returns the predictions on held-out stores, made now unless they were made before.
    ///
    /// # Errors
    /// If a store or the checkpoint can't be read.
    pub fn predict(&self, worlds: &str, held_out: &[Recipe], device: &Device) -> Result<PathBuf> {
        let out = self.predictions(worlds);
        if out.exists() {
            return Ok(out);
        }
        let predicted = match self.arm.view {
            View::Hands => measure::predict(&mut self.predictor()?, held_out, &mut |_, image| Ok(image))?,
            view => self.predict_prepared(view, held_out, device)?,
        };
        tensors::write(&out, &predicted, Default::default())?;
        Ok(out)
    }

    /// Predicts on stores whose pictures are what the network takes.
    fn predict_prepared(&self, view: View, held_out: &[Recipe], device: &Device) -> Result<TactileSequence> {
        let Checkpoint { model, metadata, .. } = Checkpoint::load(&self.config.out.join(CHECKPOINT), device)?;
        let metadata = Metadata { has_force: metadata.has_force || self.arm.untrained_force, ..metadata };
        let (preparation, side) = (metadata.preparation(model.config()), side_of(&self.config)?);
        let mut all = TactileSequence::default();
        for recipe in held_out {
            let path = if view.is_cut() { cropped(&recipe.path, side) } else { recipe.path.clone() };
            if !path.exists() {
                crops::write(&recipe.path, &path, side, PRODUCER)?;
            }
            let data = Dataset::new(zarr::open_all(&[path])?, preparation.clone(), false)?;
            let mut predicted = predict(&model, &metadata, &data, device, |_| ())?;
            if view == View::Crop {
                // This arm learns contact alone, so its force head says nothing.
                predicted.force.fill(f32::NAN);
            }
            all.append(&if view.is_cut() { crops::put_back(&recipe.path, &predicted)? } else { predicted })?;
        }
        Ok(all)
    }

    /// Loads the network as one that watches whole pictures; a hand that it does not find has no touch.
    fn predictor(&self) -> Result<Predictor> {
        let options = predictor::Options {
            max_gap_secs: Some(f64::MAX),
            locator: self.config.encoder.clone(),
            unknown: Unknown::Zero,
            // Worlds are compared, also those that look unfamiliar.
            familiarity_threshold: Some(0.0),
            ..Default::default()
        };
        Predictor::load(&self.config.out.join(CHECKPOINT), options)
    }

    /// Measures the median time per picture of held-out stores, ms, with the locator if there is one.
    ///
    /// # Errors
    /// If a store or the checkpoint can't be read.
    pub fn picture_ms(&self, held_out: &[Recipe]) -> Result<f64> {
        /// Pictures at the start that do not count, and pictures in all.
        const PICTURES: (usize, usize) = (8, 48);
        let mut predictor = self.predictor()?;
        let Some(recipe) = held_out.first() else { return Err(Error::value("held-out stores", "one", "none")) };
        let reader = ZarrReader::open(&recipe.path)?;
        let mut times = Vec::new();
        for (at, picture) in reader.images(0..reader.len().min(PICTURES.1))?.iter().enumerate() {
            let started = Instant::now();
            predictor.push(picture, at as f64 / RATE)?;
            times.push(1e3 * started.elapsed().as_secs_f64());
        }
        Ok(median(times.into_iter().skip(PICTURES.0)))
    }

    /// Counts the training frames.
    ///
    /// # Errors
    /// If a store can't be opened.
    pub fn frames(&self) -> Result<usize> {
        Ok(zarr::open_all(&self.paths())?.iter().map(zarr::ZarrReader::len).sum())
    }

    /// Returns the minutes of all steps in the log.
    pub fn minutes(&self) -> f64 {
        let text = std::fs::read_to_string(self.config.out.join("log.csv")).unwrap_or_default();
        let mut lines = text.lines();
        let column = lines.next().and_then(|line| line.split(',').position(|name| name == "secs"));
        let secs = lines.filter_map(|line| line.split(',').nth(column?)?.parse::<f64>().ok());
        secs.sum::<f64>() / 60.0
    }
}

/// Returns the configuration of the usual run: the mixture of all sources, from the encoder of a network that has learned.
fn usual(seed: u64, stores: &Stores, size: &Size, network: &Network) -> Result<Config> {
    let geometry = model::Config { image: size.image as usize, ..network.geometry.clone() };
    Ok(Config {
        name: "experiment".into(),
        data: stores.mixture(3)?,
        sampling: SamplingConfig::default(),
        validation: Vec::new(),
        out: PathBuf::new(),
        model: ModelChoice::Explicit(geometry),
        init: None,
        encoder: network.path.clone(),
        seed: seed + 1 + REPETITION * size.repetition,
        frame_dt: 1.0 / RATE,
        precision: Precision::F32,
        steps: size.steps,
        batch: BATCH,
        // The encoder has learned and stays as it is: each frame is encoded once, so that the rest takes several times as many steps
        // in the same time.
        optimizer: OptimizerConfig {
            learning_rate: size.learning_rate,
            encoder_factor: Some(0.0),
            ..OptimizerConfig::default()
        },
        loss: LossWeights::default(),
        augment: AugmentConfig { mirror: 0.5, ..AugmentConfig::none() },
        ema: 0.98,
        save_every: 200,
        validate_every: size.steps,
        threads: 1,
        mano_left: None,
        mano_right: None,
        in_memory: true,
    })
}

/// Returns the folder of a run, named by the hash of its configuration and of the network it starts from.
fn folder(work: &Path, config: &Config, network: &Network) -> Result<PathBuf> {
    let mut hashed = Config { out: PathBuf::new(), encoder: None, ..config.clone() };
    // Moving the work folder changes no run.
    let name = |path: &PathBuf| path.file_name().map(PathBuf::from).unwrap_or_default();
    hashed.data.iter_mut().for_each(|source: &mut TrainingSource| {
        source.stores = source.stores.iter().map(name).collect();
    });
    let yaml = serde_yaml::to_string(&hashed).map_err(|e| Error::value("config", "one that YAML can hold", e))?;
    Ok(work.join("runs").join(&file::sha256(format!("{} {yaml}", network.sha256).as_bytes())[..12]))
}

/// Returns the side of a run's input, pixels.
fn side_of(config: &Config) -> Result<u32> {
    Ok(config.geometry()?.image as u32)
}

/// Extension of a store of crops, before `.zarr`.
const CROPS: &str = ".crops";

/// Returns the path of the crops of a store.
fn cropped(path: &Path, side: u32) -> PathBuf {
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{name}{CROPS}{side}.zarr"))
}

/// Extension of a store of forces from motion.
const FROM_MOTION: &str = ".motion.zarr";

/// Returns the path of the store with forces from motion in place of the true ones.
fn from_motion(path: &Path) -> PathBuf {
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{name}{FROM_MOTION}"))
}

/// Returns the path of the rendered store that crops or forces from motion are made of; other paths as they are.
fn origin(path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    match name.split_once(CROPS).or_else(|| name.split_once(FROM_MOTION)) {
        Some((own, _)) => path.with_file_name(format!("{own}.zarr")),
        None => path.to_path_buf(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::Experiment;

    #[test]
    fn experiments_share_equal_runs_and_seeds_and_arms_differ() {
        let setup = Setup { size: Size::of(10), network: Network::toy(), work: "work".into(), quick: true };
        let stores = Stores::plan(Path::new("work/data"), &setup.size).unwrap();
        let folder = |experiment: &str, arm: &str, seed: u64| {
            let experiment = Experiment::by_name(experiment).unwrap();
            let arm = experiment.arms.iter().find(|other| other.name == arm).unwrap();
            Run::plan(arm, seed, &stores, &setup).unwrap().config.out
        };
        assert_eq!(folder("ablations", "mixed", 0), folder("sources", "plus_3", 0));
        assert_eq!(folder("history", "no_context", 1), folder("ablations", "no_context", 1));
        assert_ne!(folder("ablations", "mixed", 0), folder("ablations", "mixed", 1));
        assert_ne!(folder("ablations", "mixed", 0), folder("ablations", "no_force", 0));
    }

    #[test]
    fn paths_of_derived_stores_lead_back_to_their_store() {
        let store = Path::new("data/force_poke_train0_3_abcd.zarr");
        let crops = cropped(store, 56);
        assert_eq!(crops, Path::new("data/force_poke_train0_3_abcd.crops56.zarr"));
        assert_eq!((origin(&crops), origin(store)), (store.to_path_buf(), store.to_path_buf()));
        let moved = from_motion(store);
        assert_eq!(
            (moved.as_path(), origin(&moved).as_path()),
            (Path::new("data/force_poke_train0_3_abcd.motion.zarr"), store)
        );
    }
}
