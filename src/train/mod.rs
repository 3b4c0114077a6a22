//! Training: stores in, checkpoint out.
//!
//! [`train()`] is the whole loop. The weights of a run depend only on its [`Config`] and data: a repeated run gives the same
//! weights, and so does a run that was stopped and resumed.

mod augment;
pub mod batch;
pub mod calibration;
mod checkpoint;
pub mod config;
mod curves;
pub mod data;
pub mod familiarity;
pub mod initial_weights;
pub mod job;
pub mod keypoints;
mod loader;
mod log;
pub mod loss;
mod mixture;
pub mod optimizer;
pub mod pass;
mod predict;
pub mod presence;
mod run;
pub mod sampler;
mod setup;
pub mod source;

use std::path::PathBuf;
use std::time::Instant;

use candle_core::Device;

use crate::error::{Error, Result};
use crate::score::metrics::Metrics;

pub use config::Config;
use loader::Loader;
use log::Log;
use optimizer::AdamW;
use pass::{Losses, Pass};
pub use predict::predict;
use run::{Files, Run};
use setup::{Data, Network};

/// Consecutive steps whose gradient may be not finite before the run fails: a single one happens, ten mean divergence.
const MAX_SKIPPED_IN_A_ROW: usize = 10;

/// Event of a run, for its observer.
#[derive(Debug)]
pub enum Event<'a> {
    /// Data and network are loaded; the first step comes next.
    Started(&'a Started),
    /// A step was taken.
    Stepped(&'a Step),
    /// The averaged weights were scored on the held-out stores after this many steps.
    Validated(usize, &'a Metrics),
    /// State and checkpoint were saved after this many steps.
    Saved(usize),
}

/// Answer of the observer to an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Control {
    /// Take the next step.
    Continue,
    /// Save, validate and return.
    Stop,
    /// Save and return.
    StopUnvalidated,
}

/// Sizes of a run, known before its first step.
#[derive(Debug, Clone, PartialEq)]
pub struct Started {
    /// Frames of the training stores.
    pub frames: usize,
    /// Frames of the held-out stores.
    pub validation_frames: usize,
    /// Trainable parameters.
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
    /// The objective and its terms.
    pub losses: Losses,
    /// Learning rate of the step.
    pub learning_rate: f64,
    /// Norm of the gradient before clipping; a step whose norm is not finite changes nothing.
    pub grad_norm: f64,
    /// Observation windows in the step.
    pub windows: usize,
    /// Frames encoded for the windows.
    pub frames: usize,
    /// Wall-clock time of the step, s.
    pub secs: f64,
    /// Part of `secs` spent waiting for data, s.
    pub wait_secs: f64,
}

/// Result of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// The checkpoint with the averaged weights.
    pub checkpoint: PathBuf,
    /// SHA-256 of the checkpoint.
    pub sha256: String,
    /// Steps taken; fewer than configured if the observer stopped the run.
    pub steps: usize,
    /// Scores of the saved weights on the held-out stores, if there are any.
    pub validation: Option<Metrics>,
    /// Steps that changed nothing because their gradient was not finite.
    pub skipped_steps: usize,
}

/// Trains a network as `config` says; with `resume`, from the state that an earlier run left in its folder, or from the
/// beginning if it was stopped before it saved any.
///
/// # Errors
/// If the configuration or data don't fit, the state is another run's, another run trains in the folder, gradients stay not
/// finite, or a file can't be written.
pub fn train(
    config: &Config,
    resume: bool,
    device: &Device,
    observe: &mut dyn FnMut(Event) -> Control,
) -> Result<Outcome> {
    config.check()?;
    let geometry = config.geometry()?;
    let files = Files::new(config, resume)?;
    let data = Data::open(config, &geometry)?;
    let network = Network::build(config, &geometry, &data, device)?;
    let mut optimizer = AdamW::new(&network.varmap, config)?;
    let first = if resume { files.resume(&mut optimizer, config.steps)? } else { 0 };
    files.write_config()?;
    let mut log = Log::open(&files.log, first)?;
    let started = data.started(config, &network, first);
    let run = Run { config, geometry: &geometry, data: &data, files: &files, started: &started, device };
    let collate = data.collate(config, &geometry);
    let control = observe(Event::Started(&started));
    let (mut stop, mut may_validate) = (control != Control::Continue, control != Control::StopUnvalidated);

    std::thread::scope(|scope| {
        let mut loader = Loader::start(scope, &data.training, &collate, config, first * config.batch.accumulate)?;
        let pass = Pass {
            network: &network.model,
            keypoint_heads: network.keypoint_heads.as_ref(),
            geometry: &geometry,
            force_scale: data.metadata.force_scale,
            weights: &config.loss,
            device,
        };
        let (mut step, mut skipped, mut skipped_in_a_row) = (first, 0, 0);
        let (mut validated, mut scores) = (None, Vec::new());
        let mut began = Instant::now();
        while step < config.steps && !stop {
            let sum = pass.accumulate(&mut loader, &optimizer, config, &network.varmap)?;
            let Some(gradients) = sum.gradients else { break };
            let learning_rate = config.learning_rate(step);
            let grad_norm = optimizer.step(&gradients, learning_rate)?;
            step += 1;

            skipped_in_a_row = if grad_norm.is_finite() { 0 } else { skipped_in_a_row + 1 };
            skipped += usize::from(!grad_norm.is_finite());
            if skipped_in_a_row >= MAX_SKIPPED_IN_A_ROW {
                let expected = "a finite number; a lower learning rate may help";
                return Err(Error::value(format!("gradient at step {step}"), expected, grad_norm));
            }
            let pass::Accumulated { losses, windows, frames, wait_secs, .. } = sum;
            let secs = began.elapsed().as_secs_f64();
            let taken = Step { step, losses, learning_rate, grad_norm, windows, frames, secs, wait_secs };
            began = Instant::now();
            log.push(&taken)?;
            let control = observe(Event::Stepped(&taken));
            stop = control != Control::Continue;
            may_validate = control != Control::StopUnvalidated;
            if control == Control::Stop {
                // Validation may take minutes. A program that is told to end may be killed before that.
                log.sync()?;
                run.save(&optimizer, step, validated.as_ref())?;
            }

            let last = stop || step == config.steps;
            if may_validate && (last || step.is_multiple_of(config.validate_every)) {
                validated = run.validate(&optimizer)?.map(|metrics| (step, metrics));
                if let Some((_, metrics)) = &validated {
                    scores.push((step, metrics.clone()));
                    stop |= observe(Event::Validated(step, metrics)) != Control::Continue;
                }
            }
            if last || step.is_multiple_of(config.save_every) {
                log.sync()?;
                run.save(&optimizer, step, validated.as_ref())?;
                stop |= observe(Event::Saved(step)) != Control::Continue;
            }
        }
        // The observer may have stopped the run after a step without validation.
        if may_validate && validated.as_ref().is_none_or(|(at, _)| *at != step) {
            validated = run.validate(&optimizer)?.map(|metrics| (step, metrics));
        }
        log.sync()?;
        let sha256 = run.finish(&optimizer, step, validated.as_ref(), may_validate)?;
        curves::write(&files.log, &scores)?;
        let validation = validated.map(|(_, metrics)| metrics);
        Ok(Outcome { checkpoint: files.checkpoint.clone(), sha256, steps: step, validation, skipped_steps: skipped })
    })
}
