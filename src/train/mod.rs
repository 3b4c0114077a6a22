//! Training: stores in, checkpoint out.
//!
//! [`train()`] is the whole loop. The weights of a run depend only on its [`Config`] and data: a repeated run gives the same
//! weights, and so does a run that was stopped and resumed. [`train_on`] is the same loop on several [`ranks`].

mod augment;
pub mod batch;
pub mod calibration;
mod checkpoint;
pub mod config;
pub mod crops;
mod curves;
pub mod data;
pub mod familiarity;
pub mod fixed_encoder;
mod gradients;
pub mod initial_weights;
pub mod job;
pub mod keypoints;
mod loader;
mod log;
pub mod loss;
pub mod memory;
mod mixture;
pub mod optimizer;
pub mod param;
pub mod pass;
mod predict;
pub mod presence;
pub mod ranks;
mod root;
mod run;
pub mod sampler;
mod setup;
pub mod source;
mod steps;
mod together;

use std::path::PathBuf;

use candle_core::Device;

use crate::error::{Error, Result};
use crate::score::metrics::Metrics;

use checkpoint::Progress;
pub use config::Config;
use loader::Loader;
use optimizer::AdamW;
use pass::{Losses, Pass};
pub use predict::predict;
use ranks::{Communicator, Single};
use root::Root;
use run::{Files, Run};
use sampler::Share;
use setup::{Data, Network};
use steps::Steps;

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
    /// Ranks that train together.
    pub ranks: usize,
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
    /// Observation windows in the step, of all ranks.
    pub windows: usize,
    /// Frames encoded for the windows, of all ranks.
    pub frames: usize,
    /// Wall-clock time of the step, s.
    pub secs: f64,
    /// Part of `secs` spent waiting for data, s.
    pub wait_secs: f64,
    /// Part of `secs` spent in messages to the other ranks, or waiting for them, s.
    pub exchange_secs: f64,
    /// Bytes that this rank gives to the sum of the gradients; 0 with one rank.
    pub exchange_bytes: usize,
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
    let outcome = train_on(&Single, config, resume, device, observe)?;
    outcome.ok_or_else(|| Error::value("ranks", "a rank 0", "none"))
}

/// Trains on several ranks, which all call this: the result is that of one process whose batches have `batch.clips` clips for each
/// rank. A resumed run keeps the batches of the ranks that it began with, and its present ranks share them.
///
/// Rank 0 alone writes files and scores the held-out stores; the others return None. The observer of every rank is told of start and steps,
/// that of rank 0 of the rest; if one answers with a stop, all ranks stop.
///
/// # Errors
/// As [`train()`], or if a rank has failed: an error on one ends all.
pub fn train_on(
    ranks: &dyn Communicator,
    config: &Config,
    resume: bool,
    device: &Device,
    observe: &mut dyn FnMut(Event) -> Control,
) -> Result<Option<Outcome>> {
    memory::keep(true);
    let outcome = run_steps(ranks, config, resume, device, observe);
    if let Err(error) = &outcome {
        ranks.abort(error);
    }
    outcome
}

fn run_steps(
    ranks: &dyn Communicator,
    config: &Config,
    resume: bool,
    device: &Device,
    observe: &mut dyn FnMut(Event) -> Control,
) -> Result<Option<Outcome>> {
    config.check()?;
    let geometry = config.geometry()?;
    let files = if ranks.is_root() { Some(Files::new(config, resume)?) } else { None };
    let data = Data::open(config, &geometry)?;
    let network = Network::build(config, &geometry, &data, device)?;
    let mut optimizer = AdamW::new(&network.varmap, config)?;
    together::same_run(ranks, config, &data, device)?;
    let progress = match &files {
        Some(files) if resume => files.resume(&mut optimizer, config.steps, ranks.size())?,
        _ => Progress { step: 0, ranks: ranks.size() },
    };
    let Progress { step: first, ranks: began } = together::share_state(ranks, &mut optimizer, progress)?;
    let whole = config.of_ranks(began)?;
    let started = Started { ranks: ranks.size(), ..data.started(config, &network, first) };
    let run = |files| Run { config, geometry: &geometry, data: &data, files, started: &started, device, began };
    let root = files.as_ref().map(|files| Root::new(run(files))).transpose()?;
    let collate = data.collate(config, &geometry);
    let control = together::agree(ranks, observe(Event::Started(&started)))?;

    std::thread::scope(|scope| {
        let share = Share { rank: ranks.rank(), ranks: ranks.size() };
        let batches = first * config.batch.accumulate;
        let mut loader = Loader::start(scope, &data.training, &collate, &whole, batches, share)?;
        let pass = Pass {
            network: &network.model,
            variables: &network.varmap,
            fixed_encoder: network.fixed_encoder.as_ref(),
            keypoint_heads: network.keypoint_heads.as_ref(),
            geometry: &geometry,
            force_scale: data.metadata.force_scale,
            weights: &config.loss,
            device,
        };
        let mut steps = Steps::new(ranks, config, pass, optimizer, first, root, control);
        steps.run(&mut loader, observe)?;
        steps.finish()
    })
}
