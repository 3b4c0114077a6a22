//! Experiments on rendered data: one network under several conditions, scored on held-out episodes.
//!
//! | experiment | question |
//! |---|---|
//! | `ablations` | what each part of the method gives |
//! | `sources` | whether contact-only data helps where force is scarce |
//! | `scaling` | what more data and more sources give |
//! | `limits` | whether time, resolution or capacity holds the scores back |
//!
//! The encoder of all runs is trained once, to find the hands' keypoints in the training pictures: no touch is told to it. It
//! stands in for a published one, without which a network this small spends a run on learning to see.
//!
//! A finished run is kept in the work folder and not made again, so an experiment may be stopped at any time.

pub mod arm;
pub mod data;
pub mod plot;
pub mod report;

use std::path::{Path, PathBuf};

use candle_core::Device;

use crate::bench::train::{self as bench, Form};
use crate::dataset::tensors;
use crate::dataset::zarr;
use crate::error::{Error, Result};
use crate::file;
use crate::model::{self, Checkpoint, Precision};
use crate::train::config::{Augment, Batch, Geometry, Loss, Optimizer, Sampling};
use crate::train::data::Dataset;
use crate::train::{self, Config, Control, Event, predict};

pub use arm::{Arm, Experiment};
use data::{Domain, Stores};
pub use report::Report;

/// Clips and windows of a step.
const BATCH: Batch = Batch { clips: 10, windows: 3, accumulate: 1 };

/// What the encoder's learning rate is multiplied by: it has learned to see already.
const ENCODER_FACTOR: f64 = 0.3;
/// A run's weights.
const CHECKPOINT: &str = "checkpoint.safetensors";

/// How large an experiment is.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Size {
    /// Training episodes of each scene.
    pub episodes: usize,
    /// Held-out episodes of each scene, in each domain.
    pub held_out: usize,
    /// Steps of the encoder's own training, before all runs.
    pub encoder_steps: usize,
    /// Optimisation steps of a run.
    pub steps: usize,
    /// Runs of each arm.
    pub seeds: u64,
}

/// What an experiment is about to do.
#[derive(Debug, Clone, PartialEq)]
pub struct Budget {
    /// Runs that are not there yet.
    pub runs: usize,
    /// Windows that they learn from in all their steps.
    pub windows: usize,
    /// Windows per second, measured here.
    pub windows_per_s: f64,
}

/// What an experiment says on its way.
#[derive(Debug)]
pub enum News<'a> {
    /// Before the first run.
    Budget(&'a Budget),
    /// A run's steps: arm, seed, done, all.
    Step(&'a str, u64, usize, usize),
    /// A run is done.
    Run(&'a str, u64),
}

/// The network of all experiments: 112 pixels, so small that a run takes minutes on two cores.
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

/// Makes what is missing and scores all runs.
///
/// # Errors
/// If data can't be made (rendering needs the feature `sim`), a run fails, or a file can't be written.
pub fn run(
    experiment: &Experiment,
    size: &Size,
    stores: &Stores,
    work: &Path,
    command: String,
    tell: &mut dyn FnMut(News),
) -> Result<Report> {
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
    tell(News::Budget(&budget(&encoders, &planned)?));
    for config in &encoders {
        train_once(config, |done, all| tell(News::Step("encoder", 0, done, all)))?;
    }
    let mut runs = Vec::new();
    for (arm, seed, config) in &planned {
        let checkpoint = train_once(config, |done, all| tell(News::Step(arm.name, *seed, done, all)))?;
        for domain in Domain::ALL {
            predict_once(&checkpoint, stores.held_out(domain), &fields_file(config, domain))?;
        }
        tell(News::Run(arm.name, *seed));
        runs.push((*arm, *seed, config));
    }
    report::make(experiment, size, stores, &runs, command)
}

/// The run of an arm, and that of the encoder it starts from.
fn config(arm: &Arm, seed: u64, size: &Size, stores: &Stores, work: &Path) -> Result<(Config, Config)> {
    let mut config = Config {
        name: "experiment".into(),
        data: stores.sources(),
        sampling: Sampling::default(),
        validation: Vec::new(),
        out: PathBuf::new(),
        model: Geometry::Explicit(geometry()),
        init: None,
        encoder: None,
        seed: seed + 1,
        frame_dt: 1.0 / data::RATE,
        precision: Precision::F32,
        steps: size.steps,
        batch: BATCH,
        optimizer: Optimizer {
            learning_rate: 1e-3,
            weight_decay: 0.05,
            encoder_factor: Some(ENCODER_FACTOR),
            ..Optimizer::default()
        },
        // Five times the paper's weights, and ten times that of force: from a random start a network this small finds
        // touch, which is zero nearly everywhere, only if force weighs more. Keypoints keep the encoder seeing hands.
        loss: Loss { force: 50.0, contact: 5.0, active: 1.0, consistency: 0.25, keypoints: 0.3, ..Loss::default() },
        augment: Augment::default(),
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
        batch: Batch { clips: BATCH.clips * BATCH.windows, windows: 1, accumulate: 1 },
        optimizer: Optimizer { encoder_factor: None, ..config.optimizer },
        loss: Loss { force: 0.0, contact: 0.0, active: 0.0, consistency: 0.0, keypoints: 1.0, ..Loss::default() },
        validate_every: size.encoder_steps.max(1),
        ..config.clone()
    };
    (arm.change)(&mut config, stores);
    if let (Geometry::Explicit(own), Geometry::Explicit(of_arm)) = (&mut encoder.model, &config.model) {
        // A keypoint is seen in one frame.
        *own = model::Config { horizon: 1, ..of_arm.clone() };
    }
    encoder.out = folder(work, &encoder)?;
    config.encoder = Some(encoder.out.join(CHECKPOINT));
    config.out = folder(work, &config)?;
    Ok((config, encoder))
}

/// The folder of a run, named after all that decides its weights.
fn folder(work: &Path, config: &Config) -> Result<PathBuf> {
    let config = Config { out: PathBuf::new(), ..config.clone() };
    let yaml = serde_yaml::to_string(&config).map_err(|e| Error::value("config", "one that YAML can hold", e))?;
    Ok(work.join("runs").join(&file::sha256(yaml.as_bytes())[..12]))
}

fn budget(encoders: &[Config], planned: &[(&Arm, u64, Config)]) -> Result<Budget> {
    let predicted = |config: &&Config| Domain::ALL.iter().all(|domain| fields_file(config, *domain).exists());
    let runs = planned.iter().map(|(_, _, config)| config).filter(|config| !predicted(config));
    let encoders = encoders.iter().filter(|config| !is_trained(config));
    let missing: Vec<&Config> = encoders.chain(runs).collect();
    let windows = missing.iter().map(|config| config.steps * config.batch.clips * config.batch.windows).sum();
    let timed = bench::step(&geometry(), Form { clips: BATCH.clips, windows: BATCH.windows }, 3, &Device::Cpu)?;
    Ok(Budget { runs: missing.len(), windows, windows_per_s: timed.windows_per_s })
}

/// Trains, or goes on with what is there; gives the checkpoint.
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

/// Whether the run is over; one that was stopped has a checkpoint, too.
fn is_trained(config: &Config) -> bool {
    Checkpoint::load(&config.out.join(CHECKPOINT), &Device::Cpu)
        .is_ok_and(|checkpoint| steps_of(&checkpoint.metadata.training) == Some(config.steps))
}

/// Steps that a checkpoint's record of its training tells of.
fn steps_of(record: &str) -> Option<usize> {
    serde_json::from_str::<serde_json::Value>(record).ok()?["steps"].as_u64().map(|steps| steps as usize)
}

fn fields_file(config: &Config, domain: Domain) -> PathBuf {
    config.out.join(format!("{}.safetensors", domain.name()))
}

/// Writes a checkpoint's predictions on stores, unless they are there.
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
