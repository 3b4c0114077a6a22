//! What is at work in a world at an instant, counted: the proof that an effect which is off is really absent.

use glam::DVec3;
use mujoco_rs::prelude::*;

use super::world::{Body, World};

/// Counts and switches of a world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Facts {
    /// Pairs in the contact list.
    pub contacts: usize,
    /// Pairs in that list which are apart.
    pub near: usize,
    /// Largest number of directions in which a contact has forces: 1 without friction, 3 with it, 4 with torsion.
    pub contact_dimensions: usize,
    /// Constraints in the solver.
    pub constraints: usize,
    /// Joints.
    pub joints: usize,
    /// Soft bodies.
    pub soft_bodies: usize,
    /// Trees of bodies that sleep.
    pub asleep: usize,
    /// Whether gravity acts.
    pub gravity: bool,
    /// Edge of the shadow map, pixels; 0 draws no shadow.
    pub shadow_map: usize,
}

impl World {
    /// Counts what is at work at this instant.
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

    /// Finds poses and touching pairs without masses and forces, and sets the clock to `time`, s.
    pub fn detect(&mut self, time: f64) {
        self.place(time);
        self.data.collision();
    }

    /// Finds poses alone, without looking for touching pairs, and sets the clock to `time`, s.
    pub fn place(&mut self, time: f64) {
        self.kinematics();
        self.data.camlight();
        self.data.set_time(time);
    }

    /// Whether a body takes part in the simulation; one that sleeps has no contacts in the list.
    pub fn is_awake(&self, Body(body): Body) -> bool {
        let tree = self.data.model().body_treeid()[body];
        usize::try_from(tree).map_or(true, |tree| self.data.tree_asleep()[tree] < 0)
    }

    /// Velocity of a body's material point, m/s in the world frame.
    pub fn point_velocity(&self, Body(body): Body, point: DVec3) -> DVec3 {
        let root = self.data.model().body_rootid()[body] as usize;
        let [wx, wy, wz, vx, vy, vz] = self.data.cvel()[body];
        let arm = point - DVec3::from_array(self.data.subtree_com()[root]);
        DVec3::new(vx, vy, vz) + DVec3::new(wx, wy, wz).cross(arm)
    }
}
