//! Guard of single steps: time, finiteness, memory, speeds, depths, solver.

use crate::mujoco::World;
use crate::mujoco::audit::{depth_limits, speed_limits};
use crate::mujoco::world::Body;
use crate::tactile::Validity;

/// Largest generalised velocity, m/s or rad/s: no motion in a scene reaches it.
const MAX_SPEED: f64 = 200.0;
/// Largest use of the engine's memory, as a share: above it the engine may soon drop contacts.
const MAX_ARENA: f64 = 0.8;

/// Checks each step by itself.
#[derive(Debug)]
pub(super) struct StepGuard {
    /// Time after the last step, s.
    time: f64,
    /// Bodies with a speed limit below [`MAX_SPEED`], and the limit, m/s.
    max_speeds: Vec<(Body, f64)>,
    /// Largest penetration depth per geom, m.
    max_depths: Vec<f64>,
}

impl StepGuard {
    /// Creates a guard that allows contacts up to `max_depth`, m, and up to half the thickness of what touches.
    pub(super) fn new(world: &World, max_depth: f64) -> Self {
        let mut max_speeds = speed_limits(world);
        max_speeds.retain(|(_, limit)| *limit < MAX_SPEED);
        Self { time: world.time(), max_speeds, max_depths: depth_limits(world, max_depth) }
    }

    /// Checks the world after a step.
    pub(super) fn check(&mut self, world: &World) -> Validity {
        let dt = world.options().timestep;
        let advanced = (world.time() - self.time - dt).abs() < 1e-6 * dt.max(world.time());
        self.time = world.time();
        let limit = |geoms: [usize; 2]| self.max_depths[geoms[0]].min(self.max_depths[geoms[1]]);
        if !advanced || !world.is_finite() {
            Validity::NotFinite
        } else if world.warnings() > 0 {
            Validity::EngineWarning
        } else if world.qvel().iter().any(|v| v.abs() > MAX_SPEED)
            || self.max_speeds.iter().any(|(body, limit)| world.speed(*body) > *limit)
        {
            Validity::TooFast
        } else if world.gaps().any(|(geoms, distance)| -distance > limit(geoms)) {
            Validity::TooDeep
        } else if world.hit_iteration_cap() {
            Validity::NotConverged
        } else if world.arena_use() > MAX_ARENA {
            Validity::MemoryFull
        } else {
            Validity::Valid
        }
    }
}
