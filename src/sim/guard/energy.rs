//! Guard of energy: constraints and free rotation must not create or destroy it.
//!
//! Contacts, limits and friction can return at most the energy that they stored, and a body without torque keeps its
//! rotational energy. Force times the mean of the velocities before and after a step, times the timestep, is exactly
//! the change of kinetic energy; what this guard finds is the integrator's error, not rounding.

use crate::mujoco::World;
use crate::mujoco::world::FreeJoint;
use crate::tactile::Validity;

/// Largest excess of the energy returned by constraints, as a share of the energy put into them.
const MAX_ENERGY_EXCESS: f64 = 0.1;
/// Energy excess that is always allowed, J: it lifts a gram by 10 mm.
const NEGLIGIBLE_ENERGY: f64 = 1e-4;
/// Largest relative drift of the energy of a free rotation.
const MAX_DRIFT: f64 = 0.02;

/// Accounts for the energy of constraints and of free rotations.
#[derive(Debug)]
pub(super) struct EnergyGuard {
    /// Generalised velocities after the last step.
    qvel: Vec<f64>,
    /// Mean of the velocities before and after the last step.
    mean_qvel: Vec<f64>,
    /// True if constraints may do work by themselves; they are then not checked.
    driven: bool,
    /// Energy in the constraints at the start of the window, J.
    stored: f64,
    /// Energy put into constraints in the window, J.
    absorbed: f64,
    /// Energy returned by constraints in the window, J.
    released: f64,
    rotations: Vec<FreeRotation>,
}

#[derive(Debug)]
struct FreeRotation {
    joint: FreeJoint,
    /// Rotational energy when the last torque ended, J; `None` = a torque acts.
    energy: Option<f64>,
}

impl EnergyGuard {
    /// Creates a guard of all constraints, and of the rotation of `objects`.
    pub(super) fn new(world: &World, objects: &[FreeJoint]) -> Self {
        let rotations = objects.iter().map(|joint| FreeRotation { joint: *joint, energy: None }).collect();
        let mut energy = Self {
            qvel: world.qvel().to_vec(),
            mean_qvel: vec![0.0; world.qvel().len()],
            driven: world.constraints_may_work(),
            stored: 0.0,
            absorbed: 0.0,
            released: 0.0,
            rotations,
        };
        energy.begin_window(world);
        energy
    }

    /// Begins a new window of the account; call after `World::forward`.
    pub(super) fn begin_window(&mut self, world: &World) {
        (self.absorbed, self.released) = (0.0, 0.0);
        // Upper bound: a spring pressed to this depth by this force holds half of it.
        let pressed = world.contacts().map(|contact| contact.normal_force * (-contact.distance).max(0.0));
        self.stored = if self.driven { 0.0 } else { pressed.sum::<f64>() + world.limit_energy() };
    }

    /// Checks the world after a step.
    pub(super) fn check(&mut self, world: &World) -> Validity {
        for (mean, (before, after)) in self.mean_qvel.iter_mut().zip(self.qvel.iter().zip(world.qvel())) {
            *mean = 0.5 * (before + after);
        }
        self.qvel.copy_from_slice(world.qvel());
        let work = world.options().timestep * world.constraint_power(&self.mean_qvel);
        self.released += work.max(0.0);
        self.absorbed -= work.min(0.0);
        let gained = self.released > (1.0 + MAX_ENERGY_EXCESS) * (self.absorbed + self.stored) + NEGLIGIBLE_ENERGY;
        let drifts = self.rotations.iter_mut().map(|rotation| rotation.drifts(world)).fold(false, |any, one| any | one);
        if (gained && !self.driven) || drifts { Validity::EnergyError } else { Validity::Valid }
    }
}

impl FreeRotation {
    fn drifts(&mut self, world: &World) -> bool {
        if world.is_turned(self.joint) {
            self.energy = None;
            return false;
        }
        let now = world.spin_energy(self.joint);
        let begun = *self.energy.get_or_insert(now);
        (now - begun).abs() > MAX_DRIFT * begun.max(1e-9)
    }
}
