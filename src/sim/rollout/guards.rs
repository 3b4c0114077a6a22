//! Guards of a rollout, checked at every step or only at the frames' instants.

use crate::mujoco::World;
use crate::mujoco::world::FreeJoint;
use crate::sim::guard::Guard;
use crate::sim::scene_object::SceneObject;
use crate::tactile::Validity;

/// Largest penetration depth of a contact, m: neither skin nor the wall of a mug yields as far.
const MAX_DEPTH: f64 = 0.004;

/// Guard of all objects that move freely.
#[derive(Debug)]
pub(super) struct RolloutGuards {
    guard: Guard,
    every_step: bool,
}

impl RolloutGuards {
    /// Starts to guard; with `every_step` false, steps between frames are not checked.
    pub fn new(world: &World, objects: &[SceneObject], every_step: bool) -> Self {
        let joints: Vec<FreeJoint> = objects.iter().filter_map(|object| object.joint).collect();
        Self { guard: Guard::new(world, &joints, MAX_DEPTH), every_step }
    }

    /// Checks the world after a step.
    pub fn after_step(&mut self, world: &World) {
        if self.every_step {
            self.guard.after_step(world);
        }
    }

    /// Returns the validity of a frame; call after `World::forward`.
    pub fn frame(&mut self, world: &World) -> Validity {
        self.guard.frame(world)
    }
}
