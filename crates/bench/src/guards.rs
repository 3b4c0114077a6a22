//! Cost of the guards: the same steps with and without them, in turn.

use std::time::{Duration, Instant};

use egotac::error::{Error, Result};
use egotac::machine::Machine;
use egotac::mujoco::world::FreeJoint;
use egotac::sim::guard::Guard;
use egotac::sim::{Rollout, RolloutOptions, Scene};
use egotac::tactile::Validity;
use serde::Serialize;

/// Largest allowed time of the guards, as a share of a step.
pub const BUDGET: f64 = 0.05;

/// Cost of the guards in one scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Price {
    /// Name of the scene.
    pub scene: String,
    /// Contact points while it was measured.
    pub contacts: usize,
    /// Time of one step without guards, microseconds.
    pub step_us: f64,
    /// Additional time of a step with guards, microseconds.
    pub guard_us: f64,
    /// Time of the guards at each frame, microseconds.
    pub frame_us: f64,
    /// Time of the guards per step, with their share of a frame, over the time of a step.
    pub share: f64,
}

/// Cost of the guards in several scenes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Prices {
    /// Version of the program.
    pub version: &'static str,
    /// The machine that it was measured on.
    pub machine: Machine,
    /// Measurements of each kind; the least counts.
    pub rounds: usize,
    /// One per scene.
    pub scenes: Vec<Price>,
}

/// Measures in the middle of an episode of each scene, while the hand touches.
///
/// # Errors
/// If a scene cannot be built.
pub fn measure(scenes: &[&str], rounds: usize) -> Result<Prices> {
    let scenes = scenes.iter().map(|scene| price(scene, rounds)).collect::<Result<_>>()?;
    Ok(Prices { version: egotac::VERSION, machine: Machine::this(), rounds, scenes })
}

fn price(name: &str, rounds: usize) -> Result<Price> {
    let options = RolloutOptions { picture: None, ..RolloutOptions::default() };
    let mut rollout = Rollout::new(&Scene::load(name)?, 1, &options)?;
    for _ in 0..rollout.frame_count() / 2 {
        rollout.skip_frame();
    }
    // Objects on joints of their own have no free joint; the guard does not watch them one by one.
    let objects = rollout.episode().objects.iter().filter_map(|object| rollout.world().free_joint(&object.name).ok());
    let objects: Vec<FreeJoint> = objects.collect();
    let world = rollout.world_mut();
    world.forward();
    let start = world.state();
    let per_frame = (0.04 / world.options().timestep).round() as usize;
    let (mut bare, mut guarded, mut frame) = (Duration::MAX, Duration::MAX, Duration::MAX);
    for _ in 0..rounds {
        // The same steps without and with guards in turn: other load on the machine slows both alike.
        world.set_state(&start)?;
        bare = bare.min(time(|| (0..per_frame).for_each(|_| world.step())));
        world.set_state(&start)?;
        let mut guard = Guard::new(world, &objects, 0.004);
        guarded = guarded.min(time(|| {
            for _ in 0..per_frame {
                world.step();
                guard.after_step(world);
            }
        }));
        world.forward();
        let mut validity = Validity::Valid;
        frame = frame.min(time(|| validity = guard.frame(world)));
        if matches!(validity, Validity::NotFinite | Validity::EngineWarning) {
            return Err(Error::value(format!("state of {name}"), "a valid one", validity.reason()));
        }
    }
    let contacts = world.gaps().count();
    let micros = |duration: Duration, n: usize| 1e6 * duration.as_secs_f64() / n as f64;
    let (step_us, with_us, frame_us) = (micros(bare, per_frame), micros(guarded, per_frame), micros(frame, 1));
    let guard_us = with_us - step_us;
    let share = (guard_us + frame_us / per_frame as f64) / step_us;
    Ok(Price { scene: name.to_owned(), contacts, step_us, guard_us, frame_us, share })
}

fn time(work: impl FnOnce()) -> Duration {
    let start = Instant::now();
    work();
    start.elapsed()
}
