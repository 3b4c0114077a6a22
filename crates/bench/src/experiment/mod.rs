//! Experiments on rendered data: one network under several conditions, scored on held-out episodes.
//!
//! | experiment | question |
//! |---|---|
//! | `ablations` | contribution of each part of the method |
//! | `sources` | benefit of contact-only data when force labels are scarce |
//! | `scaling` | benefit of more data and more sources |
//! | `limits` | limit of the scores: time, resolution or capacity |
//!
//! The encoder of all runs is trained once, to find the hands' keypoints in the training pictures, without labels of touch.
//! It replaces a published encoder: without one, a network this small spends a whole run on learning to see.
//!
//! Finished runs stay in the work folder, so an experiment can be stopped at any time and resumed.

pub mod arm;
pub mod data;
pub mod plot;
pub mod report;

use std::path::{Path, PathBuf};

use candle_core::Device;
use egotac::dataset::tensors;
use egotac::dataset::zarr;
use egotac::error::{Error, Result};
use egotac::file;
use egotac::model::{self, Checkpoint, Precision};
use egotac::train::config::{AugmentConfig, BatchConfig, LossWeights, ModelChoice, OptimizerConfig, SamplingConfig};
use egotac::train::data::Dataset;
use egotac::train::{self, Config, Control, Event, predict};

use crate::train::{self as bench, Form};

pub use arm::{Arm, Experiment};
use data::{Domain, Stores};
pub use report::ExperimentReport;

/// Clips and windows of a training step.
const BATCH: BatchConfig = BatchConfig { clips: 10, windows: 3, accumulate: 1 };

/// Factor of the encoder's learning rate: it is trained already.
const ENCODER_FACTOR: f64 = 0.3;
/// File name of a run's weights.
const CHECKPOINT: &str = "checkpoint.safetensors";

/// Size of an experiment.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Size {
    /// Training episodes of each scene.
    pub episodes: usize,
    /// Held-out episodes of each scene, in each domain.
    pub held_out: usize,
    /// Optimisation steps of the encoder, before all runs.
    pub encoder_steps: usize,
    /// Optimisation steps of a run.
    pub steps: usize,
    /// Runs of each arm.
    pub seeds: u64,
}

/// Work that an experiment still has to do.
#[derive(Debug, Clone, PartialEq)]
pub struct Budget {
    /// Missing runs.
    pub runs: usize,
    /// Windows of all their steps.
    pub windows: usize,
    /// Windows per second, measured on this machine.
    pub windows_per_s: f64,
}

/// Progress of an experiment.
#[derive(Debug)]
pub enum Progress<'a> {
    /// Work to do, sent before the first run.
    Budget(&'a Budget),
    /// Steps of a run: arm, seed, steps done, all steps.
    Step(&'a str, u64, usize, usize),
    /// A finished run: arm, seed.
    Run(&'a str, u64),
}

/// Returns the network of all experiments: 112 pixels, and so small that a run takes minutes on two cores.
pub fn geometry() -> model::Config {
    model::Config {
        vision_width: 96,
        vision_depth: 4,
        vision_heads: 3,
        width: 96,
        depth: 2,
        heads: 3,
        ..model::Config::pocket()
    }
}

/// Makes the missing runs and scores all.
///
/// # Errors
/// If data can't be made (rendering needs the feature `sim`), a run fails, or a file can't be written.
pub fn run(
    experiment: &Experiment,
    size: &Size,
    stores: &Stores,
    work: &Path,
    command: String,
    report_progress: &mut dyn FnMut(Progress),
) -> Result<ExperimentReport> {
    let (mut planned, mut encoders): (Vec<_>, Vec<Config>) = Default::default();
    for arm in &experiment.arms {
        for seed in 0..size.seeds {
            let (config, encoder) = config(arm, seed, size, stores, work)?;
            planned.push((arm, seed, config));
            if !encoders.iter().any(|other| other.out == encoder.out) {
                encoders.push(encoder);
            }
        }
    }
    report_progress(Progress::Budget(&budget(&encoders, &planned)?));
    for config in &encoders {
        train_once(config, |done, all| report_progress(Progress::Step("encoder", 0, done, all)))?;
    }
    let mut runs = Vec::new();
    for (arm, seed, config) in &planned {
        let checkpoint = train_once(config, |done, all| report_progress(Progress::Step(arm.name, *seed, done, all)))?;
        for domain in Domain::ALL {
            predict_once(&checkpoint, stores.held_out(domain), &fields_file(config, domain))?;
        }
        report_progress(Progress::Run(arm.name, *seed));
        runs.push((*arm, *seed, config));
    }
    report::make(experiment, size, stores, &runs, command)
}

/// Returns the configuration of an arm's run and of the encoder that it starts from.
fn config(arm: &Arm, seed: u64, size: &Size, stores: &Stores, work: &Path) -> Result<(Config, Config)> {
    let mut config = Config {
        name: "experiment".into(),
        data: stores.sources(),
        sampling: SamplingConfig::default(),
        validation: Vec::new(),
        out: PathBuf::new(),
        model: ModelChoice::Explicit(geometry()),
        init: None,
        encoder: None,
        seed: seed + 1,
        frame_dt: 1.0 / data::RATE,
        precision: Precision::F32,
        steps: size.steps,
        batch: BATCH,
        optimizer: OptimizerConfig {
            learning_rate: 1e-3,
            weight_decay: 0.05,
            encoder_factor: Some(ENCODER_FACTOR),
            ..OptimizerConfig::default()
        },
        // Five times the paper's weights, and ten times its weight of force: touch is zero nearly everywhere, and a network
        // this small learns it from a random start only if force weighs more. Keypoints keep the encoder on the hands.
        loss: LossWeights {
            force: 50.0,
            contact: 5.0,
            active: 1.0,
            consistency: 0.25,
            keypoints: 0.3,
            ..LossWeights::default()
        },
        augment: AugmentConfig::default(),
        ema: 0.995,
        save_every: 200,
        validate_every: size.steps,
        threads: 1,
        in_memory: true,
    };
    let mut encoder = Config {
        data: stores.sources(),
        model: config.model.clone(),
        seed: 1,
        steps: size.encoder_steps,
        batch: BatchConfig { clips: BATCH.clips * BATCH.windows, windows: 1, accumulate: 1 },
        optimizer: OptimizerConfig { encoder_factor: None, ..config.optimizer },
        loss: LossWeights {
            force: 0.0,
            contact: 0.0,
            active: 0.0,
            consistency: 0.0,
            keypoints: 1.0,
            ..LossWeights::default()
        },
        validate_every: size.encoder_steps.max(1),
        ..config.clone()
    };
    (arm.change)(&mut config, stores);
    if let (ModelChoice::Explicit(own), ModelChoice::Explicit(of_arm)) = (&mut encoder.model, &config.model) {
        // One frame is enough to find keypoints.
        *own = model::Config { horizon: 1, ..of_arm.clone() };
    }
    encoder.out = folder(work, &encoder)?;
    config.encoder = Some(encoder.out.join(CHECKPOINT));
    config.out = folder(work, &config)?;
    Ok((config, encoder))
}

/// Returns the folder of a run, named by the hash of its configuration.
fn folder(work: &Path, config: &Config) -> Result<PathBuf> {
    let config = Config { out: PathBuf::new(), ..config.clone() };
    let yaml = serde_yaml::to_string(&config).map_err(|e| Error::value("config", "one that YAML can hold", e))?;
    Ok(work.join("runs").join(&file::sha256(yaml.as_bytes())[..12]))
}

/// Counts the missing work and times a step.
fn budget(encoders: &[Config], planned: &[(&Arm, u64, Config)]) -> Result<Budget> {
    let predicted = |config: &&Config| Domain::ALL.iter().all(|domain| fields_file(config, *domain).exists());
    let runs = planned.iter().map(|(_, _, config)| config).filter(|config| !predicted(config));
    let encoders = encoders.iter().filter(|config| !is_trained(config));
    let missing: Vec<&Config> = encoders.chain(runs).collect();
    let windows = missing.iter().map(|config| config.steps * config.batch.clips * config.batch.windows).sum();
    let timed = bench::step(&geometry(), Form { clips: BATCH.clips, windows: BATCH.windows }, 3, &Device::Cpu)?;
    Ok(Budget { runs: missing.len(), windows, windows_per_s: timed.windows_per_s })
}

/// Trains a run, or resumes it; returns its checkpoint.
fn train_once(config: &Config, mut progress: impl FnMut(usize, usize)) -> Result<PathBuf> {
    if !is_trained(config) {
        let resume = config.out.join("state.safetensors").exists();
        train::train(config, resume, &Device::Cpu, &mut |event| {
            if let Event::Stepped(step) = event {
                progress(step.step, config.steps);
            }
            Control::Continue
        })?;
    }
    Ok(config.out.join(CHECKPOINT))
}

/// Returns true if the run is finished; a stopped run has a checkpoint of fewer steps.
fn is_trained(config: &Config) -> bool {
    Checkpoint::load(&config.out.join(CHECKPOINT), &Device::Cpu)
        .is_ok_and(|checkpoint| steps_of(&checkpoint.metadata.training) == Some(config.steps))
}

/// Reads the number of steps from a checkpoint's record of its training.
fn steps_of(record: &str) -> Option<usize> {
    serde_json::from_str::<serde_json::Value>(record).ok()?["steps"].as_u64().map(|steps| steps as usize)
}

fn fields_file(config: &Config, domain: Domain) -> PathBuf {
    config.out.join(format!("{}.safetensors", domain.name()))
}

/// Writes a checkpoint's predictions on stores, unless the file exists.
fn predict_once(checkpoint: &Path, stores: &[PathBuf], out: &Path) -> Result<()> {
    if out.exists() {
        return Ok(());
    }
    let checkpoint = Checkpoint::load(checkpoint, &Device::Cpu)?;
    let data =
        Dataset::new(zarr::open_all(stores)?, checkpoint.metadata.preparation(checkpoint.model.config()), false)?;
    let predicted = predict(&checkpoint.model, &checkpoint.metadata, &data, &Device::Cpu, |_| ())?;
    tensors::write(out, &predicted, Default::default())
}
