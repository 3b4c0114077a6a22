//! The preset `replay`: contacts on recorded poses, by kinematics and collision alone.

use egotac::error::Result;
use egotac::geometry::SIGMA;
use egotac::mujoco::Preset;
use egotac::mujoco::world::Contact;
use egotac::sim::budget::clock::{Clock, Stopwatch};
use egotac::sim::{Rollout, RolloutOptions, Scene};
use egotac::tactile::CONTACT_FORCE_N;

use super::hands::Hand;
use super::knob::Setup;

/// Force that each contact counts with, N, because replay has no forces.
pub const NOMINAL_FORCE: f64 = 1.0;

/// Results of replaying an episode.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Replay {
    /// (frames) vertices in contact if each contact carries [`NOMINAL_FORCE`], ascending.
    pub touched: Vec<Vec<u32>>,
    /// Computation per simulated second, s.
    pub cost: f64,
}

/// Replays the `states` (frames) of an episode.
///
/// # Errors
/// If the episode can't be made, or the states are those of another one.
pub fn replay(
    scene: &Scene,
    seed: u64,
    states: &[Vec<f64>],
    options: &RolloutOptions,
    repetitions: usize,
) -> Result<Replay> {
    // The full model with all joints, because these are recorded; it is never stepped.
    let setup = Setup { physics: scene.spec.physics.with_preset(Preset::Replay), corners: None, points: None };
    let rollout = Rollout::new(scene, seed, &setup.options(scene, options)?)?;
    let (hands, interval) = (Hand::of(&rollout)?, rollout.interval());
    let spreaders = hands.iter().map(|hand| hand.spreader(SIGMA)).collect::<Result<Vec<_>>>()?;
    let mut world = rollout.into_world();
    let mut clock = Clock::default();
    let mut touched = Vec::new();
    for repetition in 0..repetitions.max(1) {
        for (index, state) in states.iter().enumerate() {
            let begun = Stopwatch::start();
            world.set_qpos(state)?;
            world.detect(index as f64 * interval);
            clock.add(index, begun.seconds());
            if repetition > 0 {
                continue;
            }
            let contacts: Vec<Contact> = world.contacts().collect();
            let mut vertices = Vec::new();
            for (hand, spreader) in hands.iter().zip(&spreaders) {
                let label = spreader.spread(&hand.vertices(&world), &hand.places(&contacts, NOMINAL_FORCE))?;
                let first = hand.side.range().start as u32;
                let hit = (0u32..).zip(&label.force).filter(|(_, force)| **force > CONTACT_FORCE_N);
                vertices.extend(hit.map(|(vertex, _)| first + vertex));
            }
            touched.push(vertices);
        }
    }
    Ok(Replay { touched, cost: clock.total() / (interval * states.len().max(1) as f64) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_soft_body_is_replayed_though_its_dynamics_need_an_integrator_of_their_own() {
        let scene = Scene::load("squeeze_ball").unwrap();
        let options = RolloutOptions { picture: None, ..RolloutOptions::default() };
        let start = Rollout::new(&scene, 0, &options).unwrap().world().qpos().to_vec();
        let replay = replay(&scene, 0, &[start.clone(), start], &options, 1).unwrap();
        // The hand waits away from the ball.
        assert!(replay.touched.iter().all(Vec::is_empty) && replay.touched.len() == 2);
        assert!(replay.cost > 0.0);
    }
}
