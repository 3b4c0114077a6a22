//! Forces of one instant: Newton's second law, and the cone of friction.

use glam::DVec3;

use crate::mujoco::World;
use crate::mujoco::world::FreeJoint;
use crate::tactile::Validity;

/// Share of the forces on an object by which they may miss its weight and acceleration.
const BALANCE: f64 = 0.02;
/// Friction over what the cone allows, at most.
const CONE: f64 = 1.05;
/// Normal force below which the cone is not looked at, N.
const SMALL_FORCE: f64 = 0.01;

/// Looks at the forces of an instant.
#[derive(Debug)]
pub struct Balance {
    objects: Vec<(FreeJoint, f64)>,
}

impl Balance {
    /// Watches the forces on `objects`, and friction everywhere.
    pub fn new(world: &World, objects: &[FreeJoint]) -> Self {
        Self { objects: objects.iter().map(|joint| (*joint, world.mass(world.body_of(*joint)))).collect() }
    }

    /// Looks at the world after `World::forward`.
    pub fn look(&self, world: &World) -> Validity {
        if self.objects.iter().any(|object| !balanced(world, *object)) {
            Validity::Unbalanced
        } else if world.grips().any(|grip| grip.normal_force > SMALL_FORCE && grip.cone_ratio > CONE) {
            Validity::OutsideCone
        } else {
            Validity::Valid
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
