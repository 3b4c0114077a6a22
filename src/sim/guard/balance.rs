//! Guard of the forces at one instant: Newton's second law, and the friction cone.

use glam::DVec3;

use crate::mujoco::World;
use crate::mujoco::world::FreeJoint;
use crate::tactile::Validity;

/// Largest residual of Newton's second law, as a share of the forces on the object.
const MAX_IMBALANCE: f64 = 0.02;
/// Largest ratio of friction to the friction that the cone allows.
const MAX_CONE_RATIO: f64 = 1.05;
/// Normal force below which the friction cone is not checked, N.
const MIN_CONE_FORCE: f64 = 0.01;

/// Checks the forces of an instant.
#[derive(Debug)]
pub(super) struct BalanceGuard {
    /// Objects with their masses, kg.
    objects: Vec<(FreeJoint, f64)>,
}

impl BalanceGuard {
    /// Creates a guard of the forces on `objects`, and of friction everywhere.
    pub(super) fn new(world: &World, objects: &[FreeJoint]) -> Self {
        Self { objects: objects.iter().map(|joint| (*joint, world.mass(world.body_of(*joint)))).collect() }
    }

    /// Checks the world; call after `World::forward`.
    pub(super) fn check(&self, world: &World) -> Validity {
        if self.objects.iter().any(|object| !is_balanced(world, *object)) {
            Validity::Unbalanced
        } else if world.grips().any(|grip| grip.normal_force > MIN_CONE_FORCE && grip.cone_ratio > MAX_CONE_RATIO) {
            Validity::OutsideCone
        } else {
            Validity::Valid
        }
    }
}

/// Returns true if Newton's second law holds for a free object: contact forces + m g = m a.
fn is_balanced(world: &World, (joint, mass): (FreeJoint, f64)) -> bool {
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
    (sum - mass * world.acceleration(joint)).length() <= MAX_IMBALANCE * size.max(1e-9)
}
