//! Guards: reasons not to trust a frame. Engine warnings alone miss most of what goes wrong.

use glam::DVec3;

use crate::mujoco::World;
use crate::mujoco::world::FreeJoint;
use crate::tactile::Validity;

/// Velocity that nothing in a scene reaches, m/s or rad/s.
const MAX_SPEED: f64 = 200.0;
/// Share of the forces on an object by which they may miss its weight and acceleration.
const BALANCE: f64 = 0.02;

/// Watches a world from step to step.
#[derive(Debug)]
pub struct Guard {
    objects: Vec<(FreeJoint, f64)>,
    time: f64,
    steps: u64,
    max_depth: f64,
    fired: Validity,
}

impl Guard {
    /// Watches `objects`; no contact may be deeper than `max_depth`, m.
    pub fn new(world: &World, objects: &[FreeJoint], max_depth: f64) -> Self {
        let objects = objects.iter().map(|joint| (*joint, world.mass(world.body_of(*joint)))).collect();
        Self { objects, time: world.time(), steps: 0, max_depth, fired: Validity::Valid }
    }

    /// Looks at the world after a step.
    pub fn after_step(&mut self, world: &World) {
        self.steps += 1;
        let dt = world.options().timestep;
        let advanced = (world.time() - self.time - dt).abs() < 1e-6 * dt.max(world.time());
        self.time = world.time();
        if !advanced || !world.is_finite() {
            self.fire(Validity::NotFinite);
        } else if world.warnings() > 0 {
            self.fire(Validity::EngineWarning);
        } else if world.qvel().iter().any(|v| v.abs() > MAX_SPEED) {
            self.fire(Validity::TooFast);
        } else if world.contacts().any(|contact| contact.distance < -self.max_depth) {
            self.fire(Validity::TooDeep);
        } else if world.hit_iteration_cap() {
            self.fire(Validity::NotConverged);
        }
    }

    /// What fired since the last frame; looks at the forces of this instant too. Call after `World::forward`.
    ///
    /// A state that is not finite and an engine warning stay: nothing after them can be trusted.
    pub fn frame(&mut self, world: &World) -> Validity {
        if self.fired == Validity::Valid && self.objects.iter().any(|o| !balanced(world, *o)) {
            self.fire(Validity::Unbalanced);
        }
        let fired = self.fired;
        if !matches!(fired, Validity::NotFinite | Validity::EngineWarning) {
            self.fired = Validity::Valid;
        }
        fired
    }

    fn fire(&mut self, validity: Validity) {
        // The gravest reason of the frame is the one to report: codes 1 and 2 outlive the others.
        let rank = |v: Validity| match v {
            Validity::NotFinite => 0,
            Validity::EngineWarning => 1,
            Validity::Valid => u8::MAX,
            other => other.code() + 1,
        };
        if rank(validity) < rank(self.fired) {
            self.fired = validity;
        }
    }
}

/// Newton's second law on a free object: contact forces + m g = m a.
fn balanced(world: &World, (joint, mass): (FreeJoint, f64)) -> bool {
    let body = world.body_of(joint);
    let weight = mass * DVec3::from_array(world.options().gravity);
    let (mut sum, mut size) = (weight, weight.length());
    for contact in world.contacts() {
        let sign = match contact.bodies {
            [a, b] if b == body && a != body => 1.0,
            [a, b] if a == body && b != body => -1.0,
            _ => continue,
        };
        sum += sign * contact.force;
        size += contact.force.length();
    }
    (sum - mass * world.acceleration(joint)).length() <= BALANCE * size.max(1e-9)
}
