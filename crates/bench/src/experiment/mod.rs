//! Experiments on rendered data: the paper's claims, tested where a simulation can.
//!
//! | experiment | question |
//! |---|---|
//! | `sources` | benefit of sources without force, labelled by distance, across domains |
//! | `consistency` | benefit of the consistency loss in this mixture |
//! | `sampling` | temperature and quotas against the starvation of a small source |
//! | `glove` | gap between gloved and bare hands, and what closes it |
//! | `history` | benefit of the history of pictures |
//! | `separation` | touch and no touch, beside a per-frame baseline on crops |
//! | `scaling` | benefit of more data and more sources |
//! | `ablations` | contribution of each part of the method |
//! | `limits` | limit of the scores: time, resolution or capacity |
//! | `motion` | benefit of forces estimated from motion |
//! | `recordings` | benefit of training on two imported data sets over either alone |
//! | `hands` | squares around the hands in place of the whole picture, in the same time |
//! | `transfer` | dynamics of force against sensors with another layout, gain and spread; no training |
//! | `decline` | accuracy against occlusion, blur, noise, exposure, resolution and frame rate; no training |
//! | `attention` | share of the attention on hands and objects; no training |
//! | `reuse` | accuracy and time if images that hardly change are not encoded, or patches without hands; no training |
//!
//! Arms start from the encoder of a network that has learned, the shipped one by default: a network this small spends a whole
//! run on learning to see otherwise. Finished runs stay in the work folder, so an experiment can be stopped at any time and
//! resumed, and experiments share equal runs.

pub mod arm;
pub mod attention;
pub mod claims;
pub mod data;
pub mod decline;
mod degrade;
mod finished;
mod mask;
mod measure;
mod motion;
mod network;
pub mod plot;
mod recipe;
pub mod recording;
mod render;
pub mod report;
pub mod reuse;
mod sensor;
pub mod table;
mod training;
pub mod transfer;

use std::path::PathBuf;

use candle_core::Device;
use egotac::error::Result;
use serde::Serialize;

use crate::train::{self as bench, Form};

pub use arm::{Arm, Experiment};
use data::Stores;
pub use network::Network;
use recipe::Recipe;
use recording::Layout;
pub use render::render;
pub use report::Report;
use training::{BATCH, Run};

/// Size of an experiment.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Size {
    /// Training episodes of each scene; 0 without training.
    pub episodes: usize,
    /// Held-out episodes of each scene.
    pub held_out: usize,
    /// Optimisation steps of a run; 0 without training.
    pub steps: usize,
    /// Peak learning rate of a run.
    pub learning_rate: f64,
    /// Runs of each arm.
    pub seeds: u64,
    /// Side of the pictures, pixels.
    pub image: u32,
    /// Scenes of each world at most.
    pub scenes: usize,
    /// Repetition, from 0: each has other episodes for training and test, and other seeds of the runs.
    pub repetition: u64,
}

impl Size {
    /// A size for tests, with this many training episodes of each scene.
    #[cfg(test)]
    fn of(episodes: usize) -> Self {
        Self { episodes, held_out: 2, steps: 5, learning_rate: 1e-4, seeds: 2, image: 112, scenes: 9, repetition: 0 }
    }
}

/// Size, network and work folder of an experiment.
#[derive(Debug, Clone)]
pub struct Setup {
    /// Size.
    pub size: Size,
    /// Network that all arms start from, or that is measured.
    pub network: Network,
    /// Folder for data and runs.
    pub work: PathBuf,
    /// True to measure only the last level of each kind of degradation.
    pub quick: bool,
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
    /// Episodes rendered, and all episodes.
    Rendered(u64, u64),
    /// Work to do, sent before the first run.
    Budget(&'a Budget),
    /// Steps of a run: arm, seed, steps done, all steps.
    Step(&'a str, u64, usize, usize),
    /// A finished run: arm, seed.
    Run(&'a str, u64),
    /// Conditions measured, and all conditions.
    Measured(usize, usize),
}

/// Renders the missing data, makes the missing runs and scores all.
///
/// # Errors
/// If data can't be made, a run fails, or a file can't be written.
pub fn run(
    experiment: &Experiment,
    setup: &Setup,
    device: &Device,
    command: String,
    progress: &mut dyn FnMut(Progress),
) -> Result<Report> {
    let folder = setup.work.join("data");
    let plan = if experiment.recorded { Stores::recorded } else { Stores::plan };
    let stores = plan(&folder, &setup.size)?;
    let mut runs = Vec::new();
    for arm in &experiment.arms {
        for seed in 0..setup.size.seeds {
            runs.push(Run::plan(arm, seed, &stores, setup)?);
        }
    }
    let mut recipes: Vec<Recipe> = runs.iter().flat_map(|run| run.recipes(&stores)).collect();
    for test in &experiment.tests {
        recipes.extend(stores.held_out(test.worlds)?);
    }
    match experiment.recorded {
        true => record(&folder, &stores, &recipes, progress)?,
        false => render(&recipes, progress)?,
    }
    progress(Progress::Budget(&budget(&runs, device)?));
    for run in &runs {
        let (arm, seed) = (run.arm.name, run.seed);
        run.train(device, |done, all| progress(Progress::Step(arm, seed, done, all)))?;
        for test in &experiment.tests {
            run.predict(&test.file(), &stores.held_out(test.worlds)?, device)?;
        }
        progress(Progress::Run(arm, seed));
    }
    report::make(experiment, setup, &stores, &runs, command)
}

/// Renders the missing data with the hands of MANO-format files, and makes the missing recordings from it.
fn record(
    folder: &std::path::Path,
    stores: &Stores,
    recipes: &[Recipe],
    progress: &mut dyn FnMut(Progress),
) -> Result<()> {
    let recordings = stores.recordings();
    let mut scenes: Vec<&Recipe> = recordings.iter().flat_map(|recorded| &recorded.from).collect();
    scenes.dedup_by(|next, first| next.scene == first.scene);
    scenes.iter().try_for_each(|recipe| render::write_scene(recipe))?;
    // Clips alone hold poses as coefficients of the files' basis.
    let clips = recordings.iter().filter(|recorded| recorded.layout == Layout::Hot3d);
    let clips: Vec<&Recipe> = clips.flat_map(|recorded| &recorded.from).collect();
    let mano = recording::mano_files(&folder.join(data::MANO_FOLDER), &clips)?;
    render(recipes, progress)?;
    recordings.iter().try_for_each(|recorded| recorded.make(&mano))
}

/// Counts the missing work and times a step.
fn budget(runs: &[Run], device: &Device) -> Result<Budget> {
    let missing: Vec<&Run> = runs.iter().filter(|run| !run.is_trained()).collect();
    let windows = missing.iter().map(|run| run.config.steps * BATCH.clips * BATCH.windows).sum();
    let windows_per_s = match missing.first() {
        Some(run) => {
            let form = Form { clips: BATCH.clips, windows: BATCH.windows, encoded: run.config.keeps_tokens() };
            bench::step(&run.config.geometry()?, form, 3, run.config.precision, device)?.windows_per_s
        }
        None => f64::INFINITY,
    };
    Ok(Budget { runs: missing.len(), windows, windows_per_s })
}
