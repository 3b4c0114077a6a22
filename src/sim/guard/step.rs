//! What a single step shows: time, finiteness, memory, speeds, depths, the solver.

use crate::mujoco::World;
use crate::mujoco::audit::{depth_limits, speed_limits};
use crate::mujoco::world::Body;
use crate::tactile::Validity;

/// Velocity that nothing in a scene reaches, m/s or rad/s.
const MAX_SPEED: f64 = 200.0;
/// Share of the engine's memory above which contacts may soon be dropped.
const MAX_ARENA: f64 = 0.8;

/// Looks at each step by itself.
#[derive(Debug)]
pub struct Step {
    time: f64,
    max_speeds: Vec<(Body, f64)>,
    /// Per geom, m.
    max_depths: Vec<f64>,
}

impl Step {
    /// No contact may be deeper than `max_depth`, m, nor than half of what touches is thick.
    pub fn new(world: &World, max_depth: f64) -> Self {
        let mut max_speeds = speed_limits(world);
        max_speeds.retain(|(_, limit)| *limit < MAX_SPEED);
        Self { time: world.time(), max_speeds, max_depths: depth_limits(world, max_depth) }
    }

    /// Looks at the world after a step.
    pub fn look(&mut self, world: &World) -> Validity {
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
