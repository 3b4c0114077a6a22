//! Simulation of a model under all guards, with their reports.

use egotac::error::Result;
use egotac::mujoco::audit::{Expectation, Severity, audit};
use egotac::mujoco::options::Unchecked;
use egotac::mujoco::world::FreeJoint;
use egotac::mujoco::{PhysicsOptions, World};
use egotac::sim::guard::Guard;
use egotac::tactile::Validity;

use super::Outcome;

/// Largest penetration depth that the guard accepts, m; the same as in scenes.
const MAX_DEPTH: f64 = 0.004;
/// Time between two frames, s.
const FRAME_SECS: f64 = 0.04;

/// A model after a run.
pub(super) struct Watched {
    /// State after the last step.
    pub world: World,
    /// Reports of audit and guards, each once; empty if there are none.
    pub reports: String,
    /// Errors among the reports, which refuse a model or a frame; advice is left out.
    pub errors: String,
}

/// Returns the default options with a change.
pub(super) fn options(change: impl FnOnce(&mut Unchecked)) -> Result<PhysicsOptions> {
    let mut options = Unchecked::default();
    change(&mut options);
    PhysicsOptions::try_from(options)
}

/// Simulates `seconds` of a model; the guard watches the free bodies `objects`. `prepare` may change the start; `each` is
/// called after every step.
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
    let (mut reports, mut errors) = (Vec::new(), Vec::new());
    for finding in audit(&world, Expectation::default()) {
        if finding.severity == Severity::Error {
            errors.push(finding.message.clone());
        }
        reports.push(finding.message);
    }
    let mut guard = Guard::new(&world, &joints, MAX_DEPTH);
    guard.frame(&world);
    let per_frame = (FRAME_SECS / options.timestep).round().max(1.0) as usize;
    for step in 1..=(seconds / options.timestep).round() as usize {
        world.step();
        guard.after_step(&world);
        each(&mut world);
        if step % per_frame == 0 {
            world.forward();
            let validity = guard.frame(&world);
            let reason = validity.reason().to_owned();
            if validity != Validity::Valid && !errors.contains(&reason) {
                errors.push(reason.clone());
                reports.push(reason);
            }
        }
    }
    Ok(Watched { world, reports: reports.join("; "), errors: errors.join("; ") })
}

/// Simulates without a callback between steps.
pub(super) fn settle(mjcf: &str, options: &PhysicsOptions, objects: &[&str], seconds: f64) -> Result<Watched> {
    simulate(mjcf, options, objects, seconds, |_| (), |_| ())
}

/// Compares a model as the user wrote it with its remedy; each run comes with its error.
pub(super) fn compare(
    (unguarded, as_written): (f64, Watched),
    (remedied, remedy): (f64, Watched),
    error_of: &'static str,
    tolerance: f64,
) -> Outcome {
    Outcome {
        error_of,
        tolerance,
        unguarded: Some(unguarded),
        guard: as_written.reports,
        remedied,
        remedied_guard: remedy.errors,
    }
}
