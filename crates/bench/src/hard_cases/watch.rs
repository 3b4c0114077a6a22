//! Runs a model under all guards and says what they said.

use egotac::error::Result;
use egotac::mujoco::audit::{Expectation, Severity, audit};
use egotac::mujoco::options::Unchecked;
use egotac::mujoco::world::FreeJoint;
use egotac::mujoco::{PhysicsOptions, World};
use egotac::sim::guard::Guard;
use egotac::tactile::Validity;

/// Deepest contact that no case bears, m; the same as in scenes.
const MAX_DEPTH: f64 = 0.004;
/// Seconds between two frames.
const FRAME: f64 = 0.04;

/// A model that has run.
pub(super) struct Watched {
    /// As the last step left it.
    pub world: World,
    /// What was said, each thing once; empty = nothing.
    pub said: String,
    /// The same without advice: what refuses a model or a frame.
    pub refused: String,
}

/// Defaults with changes.
pub(super) fn options(change: impl FnOnce(&mut Unchecked)) -> Result<PhysicsOptions> {
    let mut options = Unchecked::default();
    change(&mut options);
    PhysicsOptions::try_from(options)
}

/// Simulates `seconds` of a model; `objects` are the free bodies to watch. `prepare` may change the start, `each` sees the
/// world after every step.
pub(super) fn simulate(
    mjcf: &str,
    options: &PhysicsOptions,
    objects: &[&str],
    seconds: f64,
    prepare: impl FnOnce(&mut World),
    mut each: impl FnMut(&mut World),
) -> Result<Watched> {
    let mut world = World::from_mjcf(mjcf, options)?;
    let joints = objects.iter().map(|name| world.free_joint(name)).collect::<Result<Vec<FreeJoint>>>()?;
    prepare(&mut world);
    world.forward();
    let (mut said, mut refused) = (Vec::new(), Vec::new());
    for finding in audit(&world, Expectation::default()) {
        if finding.severity == Severity::Error {
            refused.push(finding.message.clone());
        }
        said.push(finding.message);
    }
    let mut guard = Guard::new(&world, &joints, MAX_DEPTH);
    guard.frame(&world);
    let per_frame = (FRAME / options.timestep).round().max(1.0) as usize;
    for step in 1..=(seconds / options.timestep).round() as usize {
        world.step();
        guard.after_step(&world);
        each(&mut world);
        if step % per_frame == 0 {
            world.forward();
            let validity = guard.frame(&world);
            let reason = validity.reason().to_owned();
            if validity != Validity::Valid && !refused.contains(&reason) {
                refused.push(reason.clone());
                said.push(reason);
            }
        }
    }
    Ok(Watched { world, said: said.join("; "), refused: refused.join("; ") })
}

/// Simulates without a look in between.
pub(super) fn settle(mjcf: &str, options: &PhysicsOptions, objects: &[&str], seconds: f64) -> Result<Watched> {
    simulate(mjcf, options, objects, seconds, |_| (), |_| ())
}
