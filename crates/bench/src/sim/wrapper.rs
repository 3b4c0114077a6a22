//! Overhead of our own code over a step of the engine.

use egotac::error::Result;
use egotac::mujoco::World;
use egotac::sim::budget::clock::{Clock, Stopwatch};
use egotac::sim::{Rollout, RolloutOptions, Scene};
use mujoco_rs::mujoco_c::{mj_step, mjData, mjModel};
use serde::{Deserialize, Serialize};

/// Times per step, and their ratios to the bare C loop over the same steps with the same servo targets.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Wrapper {
    /// Name of the scene.
    pub scene: String,
    /// Steps of the episode.
    pub steps: usize,
    /// Time of the engine's `mj_step`, microseconds per step.
    pub bare_us: f64,
    /// Time of `World::step` over that of `mj_step`.
    pub step_ratio: f64,
    /// Time of `World::step` and the rollout's control over that of `mj_step`.
    pub control_ratio: f64,
    /// Time of `World::step`, control and guards over that of `mj_step`.
    pub guarded_ratio: f64,
}

/// Servo targets with the number of steps that they hold, per frame.
type TargetSchedule = Vec<Vec<(Vec<f64>, usize)>>;

/// Times an episode in four ways, which take turns at each frame.
///
/// # Errors
/// If the rollout can't be made.
pub fn measure(scene: &Scene, seed: u64, options: &RolloutOptions, repetitions: usize) -> Result<Wrapper> {
    let new = |guards: bool| {
        let mut rollout = Rollout::new(scene, seed, &RolloutOptions { picture: None, guards, ..options.clone() })?;
        rollout.skip_frame();
        Ok::<_, egotac::Error>(rollout)
    };
    let course = course(new(false)?);
    let mut clocks: [Clock; 4] = Default::default();
    for _ in 0..repetitions.max(1) {
        let (mut bare, mut wrapped) = (new(false)?.into_world(), new(false)?.into_world());
        let (mut controlled, mut guarded) = (new(false)?, new(true)?);
        for (index, frame) in course.iter().enumerate() {
            let begun = Stopwatch::start();
            for (targets, steps) in frame {
                bare.set_ctrl(targets)?;
                step_bare(&mut bare, *steps);
            }
            clocks[0].add(index, begun.seconds());
            let begun = Stopwatch::start();
            for (targets, steps) in frame {
                wrapped.set_ctrl(targets)?;
                (0..*steps).for_each(|_| wrapped.step());
            }
            clocks[1].add(index, begun.seconds());
            let steps = frame.iter().map(|(_, steps)| steps).sum();
            clocks[2].add(index, steps_of_frame(&mut controlled, steps));
            clocks[3].add(index, steps_of_frame(&mut guarded, steps));
        }
    }
    let steps = course.iter().flatten().map(|(_, steps)| steps).sum();
    let [bare, step, control, guarded] = clocks.map(|clock| clock.total());
    Ok(Wrapper {
        scene: scene.name.clone(),
        steps,
        bare_us: 1e6 * bare / steps as f64,
        step_ratio: step / bare,
        control_ratio: control / bare,
        guarded_ratio: guarded / bare,
    })
}

/// Advances by `count` timesteps through the engine's own C function alone.
fn step_bare(world: &mut World, count: usize) {
    let data = world.engine_data_mut();
    let model: *const mjModel = data.model().ffi();
    // SAFETY: `data` was made from `model` and owns it, so both are valid and fit each other until this function returns;
    // the exclusive borrow of `world` keeps others away. mj_step upholds the same, as in MjData::step, which is this call.
    #[allow(unsafe_code)]
    unsafe {
        let data: *mut mjData = data.ffi_mut();
        for _ in 0..count {
            mj_step(model, data);
        }
    }
}

/// Times a frame up to the last of its `steps`, without the observation at its end, s.
fn steps_of_frame(rollout: &mut Rollout, steps: usize) -> f64 {
    let begun = Stopwatch::start();
    let (mut seconds, mut done) = (0.0, 0);
    rollout.skip_frame_watched(|_| {
        done += 1;
        // Reading the clock once takes a hundredth of a step.
        if done == steps {
            seconds = begun.seconds();
        }
    });
    seconds
}

fn course(mut rollout: Rollout) -> TargetSchedule {
    let mut course = TargetSchedule::new();
    loop {
        let mut frame: Vec<(Vec<f64>, usize)> = Vec::new();
        let go_on = rollout.skip_frame_watched(|world| match frame.last_mut() {
            Some((targets, steps)) if targets == world.ctrl() => *steps += 1,
            _ => frame.push((world.ctrl().to_vec(), 1)),
        });
        if !go_on {
            return course;
        }
        course.push(frame);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bare_loop_takes_the_same_steps_as_the_rollout() {
        let options = RolloutOptions { picture: None, ..RolloutOptions::default() };
        let scene = Scene::load("pinch_cube").unwrap();
        let new = || Rollout::new(&scene, 0, &options).unwrap();
        let course = course(new());
        let mut world = new().into_world();
        let mut rollout = new();
        for frame in &course {
            for (targets, steps) in frame {
                world.set_ctrl(targets).unwrap();
                step_bare(&mut world, *steps);
            }
            assert!(rollout.skip_frame());
            assert_eq!(world.qpos(), rollout.world().qpos());
        }
        assert!(!rollout.skip_frame());
    }
}
