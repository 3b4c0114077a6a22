//! Training: stores in, checkpoint out.
//!
//! [`train()`] is the whole loop. A run depends on its [`Config`] and data alone: started again it gives the same
//! weights, stopped and resumed too.

mod augment;
pub mod baseline;
pub mod batch;
mod checkpoint;
pub mod config;
mod curves;
pub mod data;
pub mod initial_weights;
pub mod job;
pub mod keypoints;
mod loader;
mod log;
pub mod loss;
pub mod mixture;
pub mod optimizer;
pub mod pass;
mod predict;
pub mod sampler;
pub mod source;

use std::path::PathBuf;
use std::time::Instant;

use candle_core::{DType, Device};
use candle_nn::VarMap;

use crate::dataset::zarr;
use crate::error::{Error, Result};
use crate::file;
use crate::model::{self, Checkpoint, EgoTac, Metadata, Precision};
use crate::score::metrics::{self, EvalOptions, Report};

use batch::Collate;
pub use config::Config;
use data::Dataset;
use loader::Loader;
use optimizer::AdamW;
use pass::{Losses, Pass};
pub use predict::predict;

/// Steps in a row whose gradient may be not finite before the run gives up.
const MAX_BROKEN_STEPS: usize = 10;

/// What a run tells while it runs.
#[derive(Debug)]
pub enum Event<'a> {
    /// Everything is loaded; the first step comes.
    Started(&'a Started),
    /// A step was taken.
    Stepped(&'a Step),
    /// The averaged weights were scored on the held-out stores.
    Validated(usize, &'a Report),
    /// State and checkpoint were saved after this many steps.
    Saved(usize),
}

/// Whether to go on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Control {
    /// Take the next step.
    Continue,
    /// Save and return.
    Stop,
}

/// What a run begins with.
#[derive(Debug, Clone, PartialEq)]
pub struct Started {
    /// Frames of the training stores.
    pub frames: usize,
    /// Frames of the held-out stores.
    pub validation_frames: usize,
    /// Trainable numbers.
    pub parameters: usize,
    /// N per normalised unit.
    pub force_scale: f32,
    /// Steps already taken, when resumed.
    pub step: usize,
    /// Steps of the whole run.
    pub steps: usize,
}

/// One optimisation step.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// Steps taken, this one included.
    pub step: usize,
    /// The objective and its parts.
    pub losses: Losses,
    /// Of the step.
    pub learning_rate: f64,
    /// Norm of the gradient before clipping; not finite = the step changed nothing.
    pub grad_norm: f64,
    /// Observation windows in the step.
    pub windows: usize,
    /// Frames encoded for them.
    pub frames: usize,
    /// Wall-clock time of the step, s.
    pub secs: f64,
    /// Part of it spent waiting for data, s.
    pub wait_secs: f64,
}

/// How a run ended.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// The checkpoint with the averaged weights.
    pub checkpoint: PathBuf,
    /// Its SHA-256.
    pub sha256: String,
    /// Steps taken; fewer than asked for if the observer stopped the run.
    pub steps: usize,
    /// Scores of the saved weights on the held-out stores, if there are any.
    pub validation: Option<Report>,
    /// Steps left out because their gradient was not finite.
    pub broken_steps: usize,
}

/// Trains a network as `config` says; with `resume`, from the state that an earlier run left in its folder.
///
/// # Errors
/// If the configuration or data don't fit, the state is another run's, gradients stay not finite, or a file can't be
/// written.
pub fn train(
    config: &Config,
    resume: bool,
    device: &Device,
    observe: &mut dyn FnMut(Event) -> Control,
) -> Result<Outcome> {
    config.check()?;
    let geometry = config.geometry()?;
    let yaml = serde_yaml::to_string(config).map_err(|e| Error::value("config", "one that YAML can hold", e))?;
    let [state_file, checkpoint_file] =
        ["state.safetensors", "checkpoint.safetensors"].map(|name| config.out.join(name));
    if !resume && state_file.exists() {
        return Err(Error::file(&state_file, "a run lies there already: resume it, or choose another folder"));
    }

    // Data.
    let mut metadata = Metadata::new(&config.name, 1.0, config.frame_dt);
    let preparation = metadata.preparation(&geometry);
    let mut data = Dataset::open(&config.data, preparation.clone(), config.in_memory)?;
    let validation = match config.validation.is_empty() {
        true => None,
        false => {
            let held_out = Dataset::new(zarr::open_all(&config.validation)?, preparation, config.in_memory)?;
            data.topology().must_match(held_out.topology())?;
            let labels = held_out.labels()?;
            Some((held_out, labels))
        }
    };
    if config.loss.keypoints > 0.0 {
        data.find_keypoints()?;
    }
    metadata.topology = data.topology();
    let statistics = data.statistics()?;
    match statistics.force_scale {
        Some(force_scale) => metadata.force_scale = force_scale,
        None => metadata.has_force = false,
    }

    // Network and optimiser.
    let varmap = VarMap::new();
    let network = EgoTac::new(&geometry, model::init::var_builder(&varmap, config.seed, device))?;
    match &config.init {
        Some(path) => {
            if let Some(before) = model::checkpoint::load_variables(path, &varmap)? {
                before.topology.must_match(metadata.topology).map_err(|error| Error::file(path, error))?;
                // Newtons stay newtons in the new unit.
                initial_weights::rescale_force(&varmap, before.force_scale / metadata.force_scale)?;
            }
        }
        None => {
            initial_weights::positions(&varmap, &geometry)?;
            initial_weights::heads(&varmap, &statistics, metadata.force_scale, config.loss.positive_weight as f32)?;
            if let Some(path) = &config.encoder {
                model::checkpoint::load_encoder(path, &varmap)?;
            }
        }
    }
    let keypoint_heads = match config.loss.keypoints > 0.0 {
        true => {
            let vb = model::init::var_builder(&varmap, config.seed, device).pp("keypoints");
            Some(keypoints::Heads::new(&geometry, vb)?)
        }
        false => None,
    };
    let mut optimizer = AdamW::new(&varmap, config)?;
    let first = if resume { checkpoint::load(&state_file, &mut optimizer, &yaml)? } else { 0 };
    file::write(&config.out.join("config.yaml"), yaml.as_bytes())?;
    let mut log = log::Log::open(&config.out.join("log.csv"), first)?;

    let collate = Collate {
        horizon: geometry.horizon,
        predict: geometry.predict,
        frame_dt: config.frame_dt,
        force_scale: metadata.force_scale,
        augment: config.augment,
        seed: config.seed,
    };
    let started = Started {
        frames: data.n_frames(),
        validation_frames: validation.as_ref().map_or(0, |(held_out, _)| held_out.n_frames()),
        parameters: varmap.all_vars().iter().map(|var| var.elem_count()).sum(),
        force_scale: metadata.force_scale,
        step: first,
        steps: config.steps,
    };
    let mut stop = observe(Event::Started(&started)) == Control::Stop;

    let save = |optimizer: &AdamW, step: usize, report: Option<&(usize, Report)>| -> Result<String> {
        checkpoint::save(&state_file, optimizer, step, &yaml)?;
        let mut metadata = metadata.clone();
        // A report tells of the weights it was made with.
        let report = report.filter(|(at, _)| *at == step).map(|(_, report)| report);
        metadata.training = training_record(config, &started, step, report);
        Checkpoint::save(&checkpoint_file, &geometry, &metadata, &averaged(optimizer, config, &geometry, device)?)
    };
    let score = |optimizer: &AdamW| -> Result<Option<Report>> {
        let Some((held_out, labels)) = &validation else { return Ok(None) };
        let varmap = averaged(optimizer, config, &geometry, device)?;
        let network = EgoTac::new(&geometry, model::init::var_builder(&varmap, config.seed, device))?.freeze()?;
        let predicted = predict(&network, &metadata, held_out, device, |_| ())?;
        metrics::evaluate(&predicted, labels, &EvalOptions::default()).map(Some)
    };

    std::thread::scope(|scope| {
        let mut loader = Loader::start(scope, &data, &collate, config, first * config.batch.accumulate)?;
        let pass = Pass {
            network: &network,
            keypoint_heads: keypoint_heads.as_ref(),
            geometry: &geometry,
            force_scale: metadata.force_scale,
            weights: &config.loss,
            device,
        };
        let (mut step, mut broken, mut broken_in_a_row) = (first, 0, 0);
        let mut report = None;
        let mut scores = Vec::new();
        let mut began = Instant::now();
        while step < config.steps && !stop {
            // The mean gradient of all batches of the step.
            let mut wait_secs = 0.0;
            let (mut gradients, mut losses, mut windows, mut frames) = (None, Losses::default(), 0, 0);
            let share = 1.0 / config.batch.accumulate as f64;
            for _ in 0..config.batch.accumulate {
                let waiting = Instant::now();
                let batch = loader.next()?;
                wait_secs += waiting.elapsed().as_secs_f64();
                frames += batch.n_frames(geometry.image);
                windows += batch.windows.len() / geometry.horizon;
                let one = match config.precision {
                    Precision::Bf16 => {
                        // Anew for each batch: the weights have changed.
                        let cast = model::init::cast_builder(&varmap, DType::BF16, device);
                        let network = EgoTac::new(&geometry, cast)?;
                        Pass { network: &network, ..pass }.run(batch, share)?
                    }
                    _ => pass.run(batch, share)?,
                };
                losses.add(&one.losses, share as f32);
                optimizer.gather(&mut gradients, one.gradients)?;
            }
            let Some(gradients) = gradients else { break };
            let learning_rate = config.learning_rate(step);
            let grad_norm = optimizer.step(&gradients, learning_rate)?;

            step += 1;
            broken_in_a_row = if grad_norm.is_finite() { 0 } else { broken_in_a_row + 1 };
            broken += usize::from(!grad_norm.is_finite());
            if broken_in_a_row >= MAX_BROKEN_STEPS {
                let expected = "a finite number; a lower learning rate may help";
                return Err(Error::value(format!("gradient at step {step}"), expected, grad_norm));
            }
            let taken = Step {
                step,
                losses,
                learning_rate,
                grad_norm,
                windows,
                frames,
                secs: began.elapsed().as_secs_f64(),
                wait_secs,
            };
            began = Instant::now();
            log.push(&taken)?;
            stop = observe(Event::Stepped(&taken)) == Control::Stop;

            let last = stop || step == config.steps;
            if last || step.is_multiple_of(config.validate_every) {
                report = score(&optimizer)?.map(|report| (step, report));
                if let Some((_, report)) = &report {
                    scores.push((step, report.clone()));
                    stop |= observe(Event::Validated(step, report)) == Control::Stop;
                }
            }
            if last || step.is_multiple_of(config.save_every) {
                save(&optimizer, step, report.as_ref())?;
                stop |= observe(Event::Saved(step)) == Control::Stop;
            }
        }
        if report.as_ref().is_none_or(|(at, _)| *at != step) {
            report = score(&optimizer)?.map(|report| (step, report));
        }
        let sha256 = save(&optimizer, step, report.as_ref())?;
        curves::write(&config.out.join("log.csv"), &scores)?;
        Ok(Outcome {
            checkpoint: checkpoint_file.clone(),
            sha256,
            steps: step,
            validation: report.map(|(_, report)| report),
            broken_steps: broken,
        })
    })
}

/// Variables with the averaged weights.
fn averaged(optimizer: &AdamW, config: &Config, geometry: &model::Config, device: &Device) -> Result<VarMap> {
    let mut varmap = VarMap::new();
    EgoTac::new(geometry, model::init::var_builder(&varmap, config.seed, device))?;
    optimizer.write_average(&mut varmap)?;
    Ok(varmap)
}

/// What the checkpoint says about its making, as JSON.
fn training_record(config: &Config, started: &Started, step: usize, report: Option<&Report>) -> String {
    serde_json::json!({
        "config": config,
        "steps": step,
        "frames": started.frames,
        "validation_frames": started.validation_frames,
        "validation": report,
        "producer": concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")),
    })
    .to_string()
}
