//! What a scene simulates, why, and what each effect costs in it.

use std::time::Instant;

use serde::Serialize;

use super::effect::{Effect, EffectPlan, EffectSet};
use super::rollout::{Rollout, RolloutOptions};
use super::scene::Scene;
use crate::error::Result;

/// Frames over which an effect's cost is measured, around the middle of the episode.
const FRAMES: usize = 24;

/// One effect in one scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Explained {
    /// The effect.
    pub effect: Effect,
    /// Whether it is simulated.
    pub on: bool,
    /// Why.
    pub reason: String,
    /// What it costs, or would cost, ms per simulated second, together with the effects that come and go with it;
    /// `None` where it was not measured.
    #[serde(rename = "ms_per_simulated_second")]
    pub cost: Option<f64>,
}

/// The effects of a scene in the order of [`Effect::ALL`], without costs.
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

/// Measures what `effect` costs in a scene, ms per simulated second: rollouts with and without it, frame by frame in
/// turn, and the median of the differences.
///
/// An effect that is on is taken away with all that need it, one that is off is added with all that it needs.
///
/// # Errors
/// If a rollout fails, for instance since there is no OpenGL.
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
    let start = rollouts[0].frame_count().saturating_sub(FRAMES) / 2;
    for _ in 0..start {
        rollouts.iter_mut().for_each(|rollout| _ = rollout.skip_frame());
    }
    let mut differences = Vec::new();
    for _ in 0..FRAMES {
        let mut seconds = [0.0; 2];
        for (rollout, seconds) in rollouts.iter_mut().zip(&mut seconds) {
            let begun = Instant::now();
            rollout.next_frame()?;
            *seconds = begun.elapsed().as_secs_f64();
        }
        differences.push(seconds[0] - seconds[1]);
    }
    differences.sort_by(f64::total_cmp);
    Ok(1e3 * differences[FRAMES / 2] * scene.spec.rate)
}

fn with(effects: EffectSet, effect: Effect) -> EffectSet {
    effect.needs().iter().fold(effects.with(effect), |effects, needed| with(effects, *needed))
}

fn without(effects: EffectSet, effect: Effect) -> EffectSet {
    let users = Effect::ALL.into_iter().filter(|user| user.needs().contains(&effect));
    users.fold(effects.without(effect), without)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_effect_goes_with_all_that_need_it_and_comes_with_all_it_needs() {
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
