//! Experiment "touch helps a policy": one task in simulation, one small policy, and touch of three kinds.
//!
//! [`task`] is to lift a ball whose weight no picture tells. An expert that knows the forces shows it
//! ([`control::expert`], [`demonstrations`]); the policy ([`network`]) is cloned from the demonstrations ([`clone`]) with
//! pictures alone, pictures and the touch that the shipped network predicts from them, or pictures and the simulator's
//! touch. In each of two rounds the expert corrects the policy's own trials, and the policy is trained anew (DAgger): a
//! clone of demonstrations alone takes the grip that the expert has chosen for a sign of the weight. Then it is tried on
//! seeds that no demonstration has ([`closed_loop`]). Initial weights, demonstrations, and the seeds of corrections and trials
//! are the same for all arms. A predicted touch is a function of the pictures: it can bring what another network has learned
//! about them, and nothing that they do not show.
//!
//! Demonstrations, weights and results of trials stay in the work folder, so a stopped experiment resumes.

pub mod arm;
pub mod clone;
pub mod closed_loop;
pub mod control;
pub mod cores;
pub mod demonstrations;
pub mod interval;
pub mod network;
pub mod plot;
pub mod recent;
pub mod report;
pub mod senses;
pub mod task;

use std::path::{Path, PathBuf};

use candle_core::Tensor;
use candle_nn::VarMap;
use egotac::error::{Error, Result};
use egotac::file;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use arm::Arm;
use clone::Trained;
use control::{constant, expert};
use cores::on_all_cores;
use demonstrations::Demonstrations;
use network::Policy;
use report::PolicyReport;
use senses::Senser;
use task::Outcome;

/// First seed of the demonstrations.
const DEMONSTRATION_SEED: u64 = 1_000_000;
/// First seed of the trials. Seeds from 2,000,000 were spent on the design: correction was added to all arms after pictures
/// alone had been tried on 48 of them.
const TRIAL_SEED: u64 = 4_000_000;
/// First seed of the policies' own trials that the expert corrects.
const CORRECTION_SEED: u64 = 3_000_000;
/// Rounds of correction: after each, a policy is trained anew on all data so far.
const ROUNDS: usize = 2;
/// Demonstrations of one file.
const LOT: usize = 24;
/// Most trials by which the best constant grip is chosen.
const CHOICE: usize = 48;
/// Constant grips that are compared, N.
const CONSTANTS: [f64; 9] = [0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6];

/// Sources on which demonstrations depend; a change of them makes new ones.
const DEMONSTRATION_SOURCES: [&str; 5] = [
    include_str!("lift_ball.yaml"),
    include_str!("task.rs"),
    include_str!("control.rs"),
    include_str!("senses.rs"),
    include_str!("demonstrations.rs"),
];
/// Further sources on which trainings and their trials depend.
const TRAINING_SOURCES: [&str; 5] = [
    include_str!("arm.rs"),
    include_str!("network.rs"),
    include_str!("clone.rs"),
    include_str!("recent.rs"),
    include_str!("closed_loop.rs"),
];

/// Size of the experiment.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Size {
    /// Demonstrations.
    pub demonstrations: usize,
    /// Steps of a training.
    pub steps: usize,
    /// Trials of each policy.
    pub trials: usize,
    /// Trainings of each arm.
    pub seeds: u64,
}

/// Progress: what is being done, and how many of all are done.
pub type Progress<'a> = &'a mut dyn FnMut(&str, usize, usize);

/// Results of the controllers that learn nothing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Baselines {
    /// Trials of the expert.
    pub expert: Vec<Outcome>,
    /// Each constant grip, N, with its success rate on seeds of demonstrations.
    pub constants: Vec<(f64, f64)>,
    /// The constant grip that was best there, N.
    pub best: f64,
    /// Trials of that grip.
    pub constant: Vec<Outcome>,
}

/// A trained policy's results.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// Arm.
    pub arm: Arm,
    /// Seed of the training.
    pub seed: u64,
    /// Errors of the training.
    pub trained: Trained,
    /// Trials, in the order of their seeds.
    pub outcomes: Vec<Outcome>,
}

/// Makes what is missing and reports all.
///
/// # Errors
/// If there is no shipped network or no OpenGL, a trial can't be simulated, or a file can't be written.
pub fn run(size: &Size, work: &Path, command: String, progress: Progress) -> Result<PolicyReport> {
    let senser = Senser::new()?;
    let sources = DEMONSTRATION_SOURCES.concat() + senser.sha256();
    let folder = work.join("policy").join(&file::sha256(sources.as_bytes())[..12]);
    let baselines = baselines(size, &folder, progress)?;
    let demonstrations = demonstrate(size, &folder, &senser, progress)?;
    let sources = format!("{}{} {}", TRAINING_SOURCES.concat(), size.demonstrations, size.steps);
    let folder = folder.join(&file::sha256(sources.as_bytes())[..12]);
    let mut runs = Vec::new();
    for seed in 1..=size.seeds {
        for arm in Arm::ALL {
            runs.push(run_arm(size, arm, seed, &demonstrations, &folder, &senser, progress)?);
        }
    }
    Ok(report::make(size, &baselines, &demonstrations, &runs, senser.sha256(), command))
}

/// Tries the controllers that learn nothing.
fn baselines(size: &Size, folder: &Path, progress: Progress) -> Result<Baselines> {
    let path = folder.join(format!("baselines-{}-{}.json", size.demonstrations, size.trials));
    if let Some(read) = read_json(&path)? {
        return Ok(read);
    }
    // The best constant is chosen where demonstrations are made, not where policies are tried.
    let (choice, trials) = (seeds(DEMONSTRATION_SEED, size.demonstrations.min(CHOICE)), trial_seeds(size));
    let all = choice.len() * CONSTANTS.len() + 2 * trials.len();
    let mut done = 0;
    let mut count = || {
        done += 1;
        progress("expert and constant grips", done, all);
    };
    let mut constants = Vec::new();
    for grip in CONSTANTS {
        let outcomes = try_all(&choice, |trial| Ok(constant(trial, grip)), &mut count)?;
        constants.push((grip, report::success(&outcomes)));
    }
    let best = constants.iter().fold((f64::NAN, -1.0), |best, next| if next.1 > best.1 { *next } else { best }).0;
    let constant = try_all(&trials, |trial| Ok(constant(trial, best)), &mut count)?;
    let expert = try_all(&trials, expert, &mut count)?;
    let baselines = Baselines { expert, constants, best, constant };
    write_json(&path, &baselines)?;
    Ok(baselines)
}

/// Runs trials without pictures.
fn try_all(
    seeds: &[u64],
    control: impl Fn(&task::Trial) -> Result<f64> + Sync,
    done: impl FnMut(),
) -> Result<Vec<Outcome>> {
    on_all_cores(seeds, || (), |(), seed| control::run(*seed, &control), done)
}

/// Records the demonstrations that are missing.
fn demonstrate(size: &Size, folder: &Path, senser: &Senser, progress: Progress) -> Result<Demonstrations> {
    let mut all = Demonstrations::default();
    let mut done = 0;
    for (index, lot) in seeds(DEMONSTRATION_SEED, size.demonstrations).chunks(LOT).enumerate() {
        let path = folder.join(format!("demonstrations-{index}-{}.safetensors", lot.len()));
        all.append(demonstrations::lot(&path, lot, senser, None, || {
            done += 1;
            progress("demonstrations", done, size.demonstrations);
        })?);
    }
    match all.is_empty() {
        true => Err(Error::value("demonstrations", "at least one", 0)),
        false => Ok(all),
    }
}

/// Trains and tries a policy, unless that is done already.
fn run_arm(
    size: &Size,
    arm: Arm,
    seed: u64,
    demonstrations: &Demonstrations,
    folder: &Path,
    senser: &Senser,
    progress: Progress,
) -> Result<Run> {
    let named = |what: String| folder.join(format!("{}-{seed}{what}", arm.name()));
    let results = named(format!("-{}.json", size.trials));
    if let Some(read) = read_json(&results)? {
        return Ok(read);
    }
    let mut data = demonstrations.clone();
    for round in 0..ROUNDS {
        // The first policies only show where a policy of this arm goes wrong.
        let steps = size.steps.div_ceil(ROUNDS + 1);
        let (policy, _) = train_once(&data, arm, seed, steps, &named(format!("-round{round}")), progress)?;
        let count = size.demonstrations.div_ceil(2);
        let corrected = seeds(CORRECTION_SEED + (round * count) as u64, count);
        let path = named(format!("-corrections{round}.safetensors"));
        let what = format!("corrections of {}, seed {seed}", arm.name());
        let mut done = 0;
        data.append(demonstrations::lot(&path, &corrected, senser, Some((&policy, arm)), || {
            done += 1;
            progress(&what, done, count);
        })?);
    }
    let (policy, trained) = train_once(&data, arm, seed, size.steps, &named("-last".into()), progress)?;
    let what = format!("trials of {}, seed {seed}", arm.name());
    let mut done = 0;
    let outcomes = on_all_cores(
        &trial_seeds(size),
        || senser.clone(),
        |senser, trial| closed_loop::run(*trial, &policy, arm, senser),
        || {
            done += 1;
            progress(&what, done, size.trials);
        },
    )?;
    let run = Run { arm, seed, trained, outcomes };
    write_json(&results, &run)?;
    Ok(run)
}

/// Trains a policy and loads it, or loads it if that is done; `path`: its files without their endings.
fn train_once(
    data: &Demonstrations,
    arm: Arm,
    seed: u64,
    steps: usize,
    path: &Path,
    progress: Progress,
) -> Result<(Policy, Trained)> {
    let (weights, losses) = (path.with_extension("safetensors"), path.with_extension("json"));
    let trained = match read_json(&losses)? {
        Some(trained) => trained,
        None => {
            let what = format!("training {}, seed {seed}", arm.name());
            let trained = clone::train(data, arm, seed, steps, &weights, |step| progress(&what, step, steps))?;
            // Written last: weights without it are those of a stopped training.
            write_json(&losses, &trained)?;
            trained
        }
    };
    Ok((Policy::load(&weights)?, trained))
}

fn trial_seeds(size: &Size) -> Vec<u64> {
    seeds(TRIAL_SEED, size.trials)
}

fn seeds(first: u64, count: usize) -> Vec<u64> {
    (first..first + count as u64).collect()
}

/// Reads a JSON file; `None` if there is none.
fn read_json<T: DeserializeOwned>(path: &PathBuf) -> Result<Option<T>> {
    match std::fs::read(path) {
        Ok(bytes) => serde_json::from_slice(&bytes).map(Some).map_err(|error| Error::file(path, error)),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(Error::file(path, error)),
    }
}

fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    let text = serde_json::to_vec(value).map_err(|error| Error::file(path, error))?;
    file::write(path, &text)
}

/// Writes the variables of a network.
fn save_weights(varmap: &VarMap, path: &Path) -> Result<()> {
    let variables: Vec<(String, Tensor)> = match varmap.data().lock() {
        Ok(all) => all.iter().map(|(name, variable)| (name.clone(), variable.as_tensor().clone())).collect(),
        Err(_) => return Err(Error::value("variables", "unlocked ones", "a thread died while it held them")),
    };
    save(variables.iter().map(|(name, tensor)| (name.as_str(), tensor.clone())).collect(), path)
}

/// Writes tensors to a safetensors file.
fn save(tensors: Vec<(&str, Tensor)>, path: &Path) -> Result<()> {
    let bytes =
        safetensors::serialize(tensors, None).map_err(|error| Error::file(path, format!("not saved: {error}")))?;
    file::write(path, &bytes)
}
