//! Control of the force with which a site of the hand presses.

use crate::mujoco::world::Body;
use crate::mujoco::{Contact, World};
use crate::sim::randomize::ContactGoal;

/// Time constant of the force correction, s.
const FORCE_TIME_CONSTANT: f64 = 0.15;
/// Largest force correction, as a multiple of the goal.
const MAX_FORCE_CORRECTION: f64 = 1.5;

/// Integral control of a goal's force.
#[derive(Debug)]
pub(super) struct ForceControl {
    /// Goal of the site.
    pub goal: ContactGoal,
    /// Bodies of the goal's site.
    pub bodies: Vec<Body>,
    /// Change of servo targets per newton, m or rad: index into wrist (0..6) or hinges (6..), and change.
    pub per_newton: Vec<(usize, f64)>,
    /// Integrated correction, N.
    pub correction: f64,
}

impl ForceControl {
    /// Integrates the difference between the wanted and the measured force over `interval`, s; resets without squeeze.
    pub fn update(&mut self, world: &World, squeeze: f64, interval: f64, is_target: impl Fn(Body) -> bool) {
        if squeeze <= 0.0 {
            self.correction = 0.0;
            return;
        }
        let touches = |contact: &Contact| {
            let [a, b] = contact.bodies;
            (self.bodies.contains(&a) && is_target(b)) || (self.bodies.contains(&b) && is_target(a))
        };
        let measured: f64 = world.contacts().filter(touches).map(|contact| contact.normal_force).sum();
        let limit = MAX_FORCE_CORRECTION * self.goal.force;
        let missing = squeeze * self.goal.force - measured;
        self.correction = (self.correction + missing * interval / FORCE_TIME_CONSTANT).clamp(-limit, limit);
    }
}
