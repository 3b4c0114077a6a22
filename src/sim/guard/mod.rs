//! Guards: checks that a frame's physics can be trusted. Engine warnings alone miss most failures.
//!
//! Guards check every step (`step`, `energy`), the forces at each frame's instant (`balance`), and slow slip over
//! many frames (`creep`). [`mod@crate::mujoco::audit`] checks the model before the first step. A refused frame keeps
//! its forces and carries the reason: it is never labelled as "no contact".

mod balance;
mod creep;
mod energy;
mod step;

use crate::mujoco::World;
use crate::mujoco::world::FreeJoint;
use crate::tactile::Validity;

use balance::BalanceGuard;
use creep::CreepGuard;
use energy::EnergyGuard;
use step::StepGuard;

/// Guard of a world, step by step and frame by frame.
#[derive(Debug)]
pub struct Guard {
    step: StepGuard,
    energy: EnergyGuard,
    balance: BalanceGuard,
    creep: CreepGuard,
    /// Gravest reason since the last frame.
    fired: Validity,
}

impl Guard {
    /// Creates a guard of `objects`; it allows contacts up to `max_depth`, m, and up to half the thickness of what
    /// touches.
    pub fn new(world: &World, objects: &[FreeJoint], max_depth: f64) -> Self {
        Self {
            step: StepGuard::new(world, max_depth),
            energy: EnergyGuard::new(world, objects),
            balance: BalanceGuard::new(world, objects),
            creep: CreepGuard::new(objects),
            fired: Validity::Valid,
        }
    }

    /// Checks the world after a step.
    pub fn after_step(&mut self, world: &World) {
        let (step, energy) = (self.step.check(world), self.energy.check(world));
        self.fire(step);
        self.fire(energy);
    }

    /// Returns the gravest reason since the last frame, the forces of this instant included. Call after
    /// `World::forward`.
    ///
    /// After a state that is not finite, or an engine warning, each further frame has the same reason.
    pub fn frame(&mut self, world: &World) -> Validity {
        if !self.is_lost() {
            let (balance, creep) = (self.balance.check(world), self.creep.check(world));
            self.fire(balance);
            self.fire(creep);
            self.energy.begin_window(world);
        }
        let fired = self.fired;
        if !self.is_lost() {
            self.fired = Validity::Valid;
        }
        fired
    }

    fn is_lost(&self) -> bool {
        matches!(self.fired, Validity::NotFinite | Validity::EngineWarning)
    }

    fn fire(&mut self, validity: Validity) {
        // The frame reports its gravest reason; lower codes are graver.
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
