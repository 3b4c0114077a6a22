//! Counts of the effects at work in a world; tests use them to prove that a disabled effect is absent.

use mujoco_rs::prelude::*;

use super::World;

/// Counts and switches of a world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Facts {
    /// Pairs in the contact list.
    pub contacts: usize,
    /// Pairs in the contact list that do not touch.
    pub near: usize,
    /// Largest number of force directions of a contact: 1 without friction, 3 with friction, 4 with torsion.
    pub contact_dimensions: usize,
    /// Constraints in the solver.
    pub constraints: usize,
    /// Joints.
    pub joints: usize,
    /// Soft bodies.
    pub soft_bodies: usize,
    /// Kinematic trees that sleep.
    pub asleep: usize,
    /// True if gravity acts.
    pub gravity: bool,
    /// Edge of the shadow map, pixels; 0 draws no shadow.
    pub shadow_map: usize,
}

impl World {
    /// Counts the effects at work in the current state.
    pub fn facts(&self) -> Facts {
        let model = self.data.model();
        let contacts = self.data.contact();
        let enabled = |bit: MjtDisableBit| model.opt().disableflags & bit as i32 == 0;
        let near = contacts.iter().filter(|contact| contact.dist > 0.0).count();
        Facts {
            contacts: contacts.len(),
            near,
            contact_dimensions: contacts.iter().map(|contact| contact.dim.max(0) as usize).max().unwrap_or(0),
            constraints: self.data.ffi().nefc.max(0) as usize,
            joints: model.ffi().njnt as usize,
            soft_bodies: model.ffi().nflex as usize,
            asleep: self.data.tree_asleep().iter().filter(|cycle| **cycle >= 0).count(),
            gravity: enabled(MjtDisableBit::mjDSBL_GRAVITY),
            shadow_map: model.vis().quality.shadowsize.max(0) as usize,
        }
    }
}
