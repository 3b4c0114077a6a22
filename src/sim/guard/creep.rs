//! Slow slip of a held object: friction that gives way although it is far inside of its cone.
//!
//! A friction constraint is soft; under a steady load it slides at a steady speed, a millimetre per second with default
//! settings, and a held object leaves the hand by itself after some seconds. In one frame that is invisible.

use std::collections::VecDeque;

use glam::DVec3;

use crate::mujoco::World;
use crate::mujoco::world::FreeJoint;
use crate::tactile::Validity;

/// Slip of a grip that should stick, m/s. Forces that change slip a little on their way; those that rest must not.
const MAX_CREEP: f64 = 5e-4;
/// Seconds of holding in which no frame may slip less.
const WINDOW: f64 = 0.5;
/// Share of the cone above which a grip is meant to slide.
const STICKING: f64 = 0.9;

/// Watches held objects.
#[derive(Debug)]
pub struct Creep {
    objects: Vec<Held>,
}

#[derive(Debug)]
struct Held {
    joint: FreeJoint,
    /// Time and slip of the frames since the object is held, s and m/s.
    slips: VecDeque<(f64, f64)>,
}

impl Creep {
    /// Watches `objects`.
    pub fn new(objects: &[FreeJoint]) -> Self {
        Self { objects: objects.iter().map(|joint| Held { joint: *joint, slips: VecDeque::new() }).collect() }
    }

    /// Looks at the world after `World::forward`.
    pub fn look(&mut self, world: &World) -> Validity {
        let creeps = self.objects.iter_mut().map(|object| object.creeps(world)).fold(false, |any, one| any | one);
        if creeps { Validity::Creeping } else { Validity::Valid }
    }
}

impl Held {
    fn creeps(&mut self, world: &World) -> bool {
        let Some(slip) = self.slip(world) else {
            self.slips.clear();
            return false;
        };
        let now = world.time();
        self.slips.push_back((now, slip));
        // The oldest frame that is kept is just older than the window.
        while self.slips.get(1).is_some_and(|(time, _)| now - time >= WINDOW) {
            self.slips.pop_front();
        }
        if self.slips.front().is_none_or(|(time, _)| now - time < WINDOW) {
            return false;
        }
        self.slips.iter().all(|(_, slip)| *slip > MAX_CREEP)
    }

    /// Length of the mean slip over all grips, weighted by normal force, m/s; `None` if the object is not held: it touches nothing that
    /// moves, rests on something that does not, or slides.
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
            if world.tree(other).is_none() || grip.cone_ratio > STICKING {
                return None;
            }
            sum += sign * grip.slip * grip.normal_force;
            force += grip.normal_force;
        }
        (force > 0.0).then(|| sum.length() / force)
    }
}
