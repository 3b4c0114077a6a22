//! Guard against creep: slow slip of a held object far inside the friction cone.
//!
//! Friction constraints are soft. Under a steady load they slide at a steady speed, a millimetre per second with
//! default settings, so that a held object leaves the hand after some seconds. A single frame does not show it.

use std::collections::VecDeque;

use glam::DVec3;

use crate::mujoco::World;
use crate::mujoco::world::FreeJoint;
use crate::tactile::Validity;

/// Largest slip of a sticking grip over a whole window, m/s; changing forces may slip more for a moment.
const MAX_CREEP: f64 = 5e-4;
/// Duration for which each frame must slip more than [`MAX_CREEP`] before the guard fires, s.
const CREEP_WINDOW: f64 = 0.5;
/// Share of the friction cone above which a grip slides on purpose.
const MAX_STICKING_CONE_RATIO: f64 = 0.9;

/// Checks held objects.
#[derive(Debug)]
pub(super) struct CreepGuard {
    objects: Vec<HeldObject>,
}

#[derive(Debug)]
struct HeldObject {
    joint: FreeJoint,
    /// Time and slip of the frames since the object is held, s and m/s; at most one frame is older than the window.
    slips: VecDeque<(f64, f64)>,
}

impl CreepGuard {
    /// Creates a guard of `objects`.
    pub(super) fn new(objects: &[FreeJoint]) -> Self {
        Self { objects: objects.iter().map(|joint| HeldObject { joint: *joint, slips: VecDeque::new() }).collect() }
    }

    /// Checks the world; call after `World::forward`.
    pub(super) fn check(&mut self, world: &World) -> Validity {
        // Each object must see each frame: no short circuit.
        let creeps = self.objects.iter_mut().map(|object| object.creeps(world)).fold(false, |any, one| any | one);
        if creeps { Validity::Creeping } else { Validity::Valid }
    }
}

impl HeldObject {
    fn creeps(&mut self, world: &World) -> bool {
        let Some(slip) = self.slip(world) else {
            self.slips.clear();
            return false;
        };
        let now = world.time();
        self.slips.push_back((now, slip));
        // Keep one frame that is older than the window, so that the rest covers it.
        while self.slips.get(1).is_some_and(|(time, _)| now - time >= CREEP_WINDOW) {
            self.slips.pop_front();
        }
        if self.slips.front().is_none_or(|(time, _)| now - time < CREEP_WINDOW) {
            return false;
        }
        self.slips.iter().all(|(_, slip)| *slip > MAX_CREEP)
    }

    /// Returns the magnitude of the mean slip over all grips, weighted by normal force, m/s; `None` if the object is
    /// not held: it touches nothing that moves, rests on something that does not move, or slides.
    fn slip(&self, world: &World) -> Option<f64> {
        let body = world.body_of(self.joint);
        let (mut sum, mut force) = (DVec3::ZERO, 0.0);
        for grip in world.grips() {
            let [a, b] = grip.bodies;
            let (other, sign) = match (a == body, b == body) {
                (false, true) => (a, 1.0),
                (true, false) => (b, -1.0),
                _ => continue,
            };
            if world.tree(other).is_none() || grip.cone_ratio > MAX_STICKING_CONE_RATIO {
                return None;
            }
            sum += sign * grip.slip * grip.normal_force;
            force += grip.normal_force;
        }
        (force > 0.0).then(|| sum.length() / force)
    }
}
