//! Trials under a policy.

use std::collections::VecDeque;

use egotac::error::Result;

use super::clone::Arm;
use super::demonstrations::LAG;
use super::network::{Inputs, Look, Policy};
use super::senses::{RENDERED, Senser, Senses};
use super::task::{MAX_CHANGE, Outcome, Trial};

/// Runs the trial of a seed under a policy with the touch of `arm`.
///
/// # Errors
/// If the trial can't be simulated, or a network fails.
pub fn run(seed: u64, policy: &Policy, arm: Arm, senser: &mut Senser) -> Result<Outcome> {
    let mut trial = Trial::start(seed, Some(RENDERED))?;
    // Oldest first.
    let mut senses: VecDeque<Senses> = VecDeque::new();
    senser.reset();
    loop {
        senses.push_back(senser.sense(&trial, arm == Arm::ImagePredictedTouch)?);
        if senses.len() > LAG + 1 {
            senses.pop_front();
        }
        let change = decide(policy, arm, &senses)?;
        if !trial.act(change, true)? {
            return Ok(trial.outcome());
        }
    }
}

/// Returns the change of the grip, N, after `senses`, oldest first.
fn decide(policy: &Policy, arm: Arm, senses: &VecDeque<Senses>) -> Result<f64> {
    let (Some(now), Some(earlier)) = (senses.back(), senses.front()) else { return Ok(0.0) };
    let places = [now, earlier];
    let mut inputs = Inputs::default();
    let touch = places.map(|at| arm.touch(&at.true_touch, &at.predicted_touch));
    inputs.push(places.map(|at| at.picture.as_slice()), Look::PLAIN, touch, &now.own);
    let shares = policy.forward(&inputs)?.to_vec1::<f32>()?;
    Ok(shares.first().map_or(0.0, |share| f64::from(*share) * MAX_CHANGE))
}
