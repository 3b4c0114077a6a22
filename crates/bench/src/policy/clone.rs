//! Behaviour cloning: a policy learns the expert's actions from demonstrations.

use std::path::Path;

use candle_nn::VarMap;
use egotac::error::{Error, Result};
use egotac::train::Config;
use egotac::train::optimizer::AdamW;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::arm::Arm;
use super::demonstrations::Demonstrations;
use super::network::{Inputs, Look, Policy};
use super::senses::{OWN, PICTURE, TOUCH};

/// Demonstrated frames per step.
const BATCH: usize = 64;
/// Largest shift of training pictures, pixels, and largest change of their brightness.
const MAX_SHIFT: i32 = 3;
const MAX_BRIGHTNESS: f32 = 0.2;

/// Result of a training: mean squared error of the action over its first and its last tenth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Trained {
    /// Error over the first tenth of the steps.
    pub first_loss: f64,
    /// Error over the last tenth of the steps.
    pub last_loss: f64,
}

/// Trains the policy of an arm and writes its weights to `path`.
///
/// Initial weights and the order of the demonstrations depend on `seed` alone, and so are the same for all arms.
///
/// # Errors
/// If the weights become infinite, or the file can't be written.
pub fn train(
    demonstrations: &Demonstrations,
    arm: Arm,
    seed: u64,
    steps: usize,
    path: &Path,
    mut progress: impl FnMut(usize),
) -> Result<Trained> {
    let config = config(seed, steps)?;
    let mut varmap = VarMap::new();
    let policy = Policy::new(&varmap, seed)?;
    let mut optimizer = AdamW::new(&varmap, &config)?;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut losses = Vec::with_capacity(steps);
    for step in 0..steps {
        let (inputs, actions) = batch(demonstrations, arm, &mut rng);
        let actions = candle_core::Tensor::from_vec(actions, BATCH, &candle_core::Device::Cpu)?;
        let loss = (policy.forward(&inputs)? - actions)?.sqr()?.mean_all()?;
        let norm = optimizer.step(&loss.backward()?, config.learning_rate(step))?;
        if !norm.is_finite() {
            return Err(Error::value("gradient of a policy", "finite numbers", norm));
        }
        losses.push(f64::from(loss.to_scalar::<f32>()?));
        progress(step + 1);
    }
    optimizer.write_average(&mut varmap)?;
    super::save_weights(&varmap, path)?;
    let tenth = steps.div_ceil(10).max(1);
    let mean = |losses: &[f64]| losses.iter().sum::<f64>() / losses.len().max(1) as f64;
    Ok(Trained {
        first_loss: mean(&losses[..tenth.min(losses.len())]),
        last_loss: mean(&losses[losses.len().saturating_sub(tenth)..]),
    })
}

/// Draws the observations and actions of a step.
fn batch(all: &Demonstrations, arm: Arm, rng: &mut ChaCha8Rng) -> (Inputs, Vec<f32>) {
    let (mut inputs, mut actions) = (Inputs::default(), Vec::with_capacity(BATCH));
    for _ in 0..BATCH {
        let now = rng.random_range(0..all.len());
        let places = [now, all.earlier(now)];
        let look = Look {
            shift: [0; 2].map(|_: i32| rng.random_range(-MAX_SHIFT..=MAX_SHIFT)),
            brightness: 1.0 + rng.random_range(-MAX_BRIGHTNESS..MAX_BRIGHTNESS),
        };
        let pictures = places.map(|at| &all.pictures[at * PICTURE..(at + 1) * PICTURE]);
        let touch = places.map(|at| {
            let range = at * TOUCH..(at + 1) * TOUCH;
            arm.touch(&all.true_touch[range.clone()], &all.predicted_touch[range])
        });
        inputs.push(pictures, look, touch, &all.own[now * OWN..(now + 1) * OWN]);
        actions.push(all.action[now]);
    }
    (inputs, actions)
}

/// Returns the schedule and optimiser of a training.
fn config(seed: u64, steps: usize) -> Result<Config> {
    let text = format!(
        "{{name: policy, data: [], out: policy, model: toy, seed: {seed}, steps: {steps}, ema: 0.99, \
         optimizer: {{learning_rate: 1.0e-3, final_learning_rate: 1.0e-5, weight_decay: 0.01}}}}"
    );
    serde_yaml::from_str(&text).map_err(|error| Error::value("configuration of a policy", "a valid one", error))
}
