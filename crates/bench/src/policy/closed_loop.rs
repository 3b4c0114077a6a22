//! Trials under a policy.

use egotac::error::Result;

use super::arm::Arm;
use super::network::Policy;
use super::recent::Recent;
use super::senses::{RENDERED, Senser};
use super::task::{Outcome, Trial};

/// Runs the trial of a seed under a policy with the touch of `arm`.
///
/// # Errors
/// If the trial can't be simulated, or a network fails.
pub fn run(seed: u64, policy: &Policy, arm: Arm, senser: &mut Senser) -> Result<Outcome> {
    let mut trial = Trial::start(seed, Some(RENDERED))?;
    let mut recent = Recent::default();
    senser.reset();
    loop {
        recent.push(senser.sense(&trial, arm == Arm::ImagePredictedTouch)?);
        let change = recent.decide(policy, arm)?;
        if !trial.act(change, true)? {
            return Ok(trial.outcome());
        }
    }
}
