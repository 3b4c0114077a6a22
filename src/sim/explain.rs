//! Report of a scene's effects: on or off, reason, measured cost.

use std::time::Instant;

use serde::Serialize;

use super::effect::{Effect, EffectSet};
use super::rollout::{Rollout, RolloutOptions};
use super::scene::{EffectPlan, Scene};
use crate::error::Result;

/// Number of frames over which a cost is measured, around the middle of the episode.
const MEASURED_FRAMES: usize = 24;

/// An effect in a scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Explained {
    /// Effect.
    pub effect: Effect,
    /// True if it is simulated.
    pub on: bool,
    /// Reason why it is on or off.
    pub reason: String,
    /// Cost, or cost that it would have, ms per simulated second, together with the effects that come and go with it;
    /// `None` if it was not measured.
    #[serde(rename = "ms_per_simulated_second")]
    pub cost: Option<f64>,
}

/// Returns the effects of a scene in the order of [`Effect::ALL`], without costs.
///
/// # Errors
/// As [`EffectPlan::of`].
pub fn explain(scene: &Scene) -> Result<Vec<Explained>> {
    let plan = EffectPlan::of(&scene.spec)?;
    let of = |effect: Effect| {
        let (on, reason) = (plan.effects().contains(effect), plan.reason(effect).to_owned());
        Explained { effect, on, reason, cost: None }
    };
    Ok(Effect::ALL.into_iter().map(of).collect())
}

/// Measures the cost of `effect` in a scene, ms per simulated second: the median difference between frames of a rollout
/// with it and of one without it, simulated alternately.
///
/// If the effect is on, the second rollout also lacks all effects that require it; if it is off, the first one also has
/// all effects that it requires.
///
/// # Errors
/// If a rollout fails, for instance without OpenGL.
pub fn cost(scene: &Scene, seed: u64, options: &RolloutOptions, effect: Effect) -> Result<f64> {
    let planned = EffectPlan::of(&scene.spec)?.effects();
    let (with, without) = match planned.contains(effect) {
        true => (planned, without(planned, effect)),
        false => (with(planned, effect), planned),
    };
    let rollout = |effects: EffectSet| {
        let options = RolloutOptions { effects: Some(effects), ..options.clone() };
        Rollout::new(scene, seed, &options)
    };
    let mut rollouts = [rollout(with)?, rollout(without)?];
    let start = rollouts[0].frame_count().saturating_sub(MEASURED_FRAMES) / 2;
    for _ in 0..start {
        rollouts.iter_mut().for_each(|rollout| _ = rollout.skip_frame());
    }
    let mut differences = Vec::new();
    for _ in 0..MEASURED_FRAMES {
        let mut seconds = [0.0; 2];
        for (rollout, seconds) in rollouts.iter_mut().zip(&mut seconds) {
            let begun = Instant::now();
            rollout.next_frame()?;
            *seconds = begun.elapsed().as_secs_f64();
        }
        differences.push(seconds[0] - seconds[1]);
    }
    differences.sort_by(f64::total_cmp);
    Ok(1e3 * differences[MEASURED_FRAMES / 2] * scene.spec.rate)
}

/// Adds an effect and all effects that it requires.
fn with(effects: EffectSet, effect: Effect) -> EffectSet {
    effect.needs().iter().fold(effects.with(effect), |effects, needed| with(effects, *needed))
}

/// Removes an effect and all effects that require it.
fn without(effects: EffectSet, effect: Effect) -> EffectSet {
    let users = Effect::ALL.into_iter().filter(|user| user.needs().contains(&effect));
    users.fold(effects.without(effect), without)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn effects_are_added_and_removed_with_their_requirements() {
        let all: EffectSet = Effect::ALL.into_iter().collect();
        for effect in Effect::ALL {
            without(all, effect).check().unwrap();
            with(EffectSet::default(), effect).check().unwrap();
            assert!(!without(all, effect).contains(effect) && with(EffectSet::default(), effect).contains(effect));
        }
        assert!(!without(all, Effect::Dynamics).contains(Effect::TorsionalFriction));
        assert!(without(all, Effect::Dynamics).contains(Effect::RigidContact));
    }
}
