//! Guards: reasons not to trust a frame. Engine warnings alone miss most of what goes wrong.
//!
//! Three things are watched: every step ([`step`], [`energy`]), the forces at each frame's instant ([`balance`]), and
//! slow slip over many frames ([`creep`]). What a model tells before its first step is [`mod@crate::mujoco::audit`]'s.
//! A guard never says "no contact": a frame it refuses keeps its forces, and carries the reason.

pub mod balance;
pub mod creep;
pub mod energy;
pub mod step;

use crate::mujoco::World;
use crate::mujoco::world::FreeJoint;
use crate::tactile::Validity;

use balance::Balance;
use creep::Creep;
use energy::Energy;
use step::Step;

/// Watches a world from step to step.
#[derive(Debug)]
pub struct Guard {
    step: Step,
    energy: Energy,
    balance: Balance,
    creep: Creep,
    fired: Validity,
}

impl Guard {
    /// Watches `objects`; no contact may be deeper than `max_depth`, m, nor than half of what touches is thick.
    pub fn new(world: &World, objects: &[FreeJoint], max_depth: f64) -> Self {
        Self {
            step: Step::new(world, max_depth),
            energy: Energy::new(world, objects),
            balance: Balance::new(world, objects),
            creep: Creep::new(objects),
            fired: Validity::Valid,
        }
    }

    /// Looks at the world after a step.
    pub fn after_step(&mut self, world: &World) {
        let (step, energy) = (self.step.look(world), self.energy.look(world));
        self.fire(step);
        self.fire(energy);
    }

    /// What fired since the last frame; looks at the forces of this instant too. Call after `World::forward`.
    ///
    /// A state that is not finite and an engine warning stay: nothing after them can be trusted.
    pub fn frame(&mut self, world: &World) -> Validity {
        if !self.is_lost() {
            let (balance, creep) = (self.balance.look(world), self.creep.look(world));
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
