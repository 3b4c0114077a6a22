//! Energy that comes or goes without work.
//!
//! Contacts, limits and friction can give back what they have stored, and no more; and a body that nothing turns keeps
//! its energy of rotation. With the mean of the velocities before and after a step, force times velocity times timestep
//! is the change of kinetic energy to the last digit, so what is found here is the integrator's error and no rounding.

use crate::mujoco::World;
use crate::mujoco::world::FreeJoint;
use crate::tactile::Validity;

/// Share of the energy put into constraints that they may give back in excess.
const MARGIN: f64 = 0.1;
/// Energy that never matters, J: what lifts a gram by 10 mm.
const SMALL: f64 = 1e-4;
/// Share by which the energy of a free spin may drift.
const MAX_DRIFT: f64 = 0.02;

/// Keeps the accounts of energy.
#[derive(Debug)]
pub struct Energy {
    qvel: Vec<f64>,
    between: Vec<f64>,
    /// Whether contacts may do work on their own, so that nothing can be said about them.
    driven: bool,
    stored: f64,
    absorbed: f64,
    released: f64,
    spins: Vec<Spin>,
}

#[derive(Debug)]
struct Spin {
    joint: FreeJoint,
    /// Energy when the body was last left alone, J; `None` = something turns it.
    energy: Option<f64>,
}

impl Energy {
    /// Watches all constraints, and the spin of `objects`.
    pub fn new(world: &World, objects: &[FreeJoint]) -> Self {
        let spins = objects.iter().map(|joint| Spin { joint: *joint, energy: None }).collect();
        let mut energy = Self {
            qvel: world.qvel().to_vec(),
            between: vec![0.0; world.qvel().len()],
            driven: world.constraints_may_work(),
            stored: 0.0,
            absorbed: 0.0,
            released: 0.0,
            spins,
        };
        energy.begin_window(world);
        energy
    }

    /// Begins new accounts; call after `World::forward`.
    pub fn begin_window(&mut self, world: &World) {
        (self.absorbed, self.released) = (0.0, 0.0);
        // More than a spring holds that is pressed so deep by such a force.
        let pressed = world.contacts().map(|contact| contact.normal_force * (-contact.distance).max(0.0));
        self.stored = if self.driven { 0.0 } else { pressed.sum::<f64>() + world.limit_energy() };
    }

    /// Looks at the world after a step.
    pub fn look(&mut self, world: &World) -> Validity {
        for (between, (before, after)) in self.between.iter_mut().zip(self.qvel.iter().zip(world.qvel())) {
            *between = 0.5 * (before + after);
        }
        self.qvel.copy_from_slice(world.qvel());
        let work = world.options().timestep * world.constraint_power(&self.between);
        self.released += work.max(0.0);
        self.absorbed -= work.min(0.0);
        let gained = self.released > (1.0 + MARGIN) * (self.absorbed + self.stored) + SMALL;
        let drifts = self.spins.iter_mut().map(|spin| spin.drifts(world)).fold(false, |any, one| any | one);
        if (gained && !self.driven) || drifts { Validity::EnergyError } else { Validity::Valid }
    }
}

impl Spin {
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
