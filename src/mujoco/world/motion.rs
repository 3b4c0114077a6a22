//! Prescribed motion: positions, velocities and accelerations, and the forces that explain them.

use glam::{DQuat, DVec3};

use super::{FreeJoint, Servo, World};
use crate::error::Result;

impl World {
    /// Sets position, velocity and acceleration of a servo's joint: m or rad, per s, per s². Not validated, as
    /// [`Self::qpos_mut`].
    pub fn set_joint_motion(&mut self, servo: Servo, [position, velocity, acceleration]: [f64; 3]) {
        self.data.qpos_mut()[servo.qpos] = position;
        self.data.qvel_mut()[servo.dof] = velocity;
        self.data.qacc_mut()[servo.dof] = acceleration;
    }

    /// Sets pose, velocity and acceleration of a free body. `linear`: velocity, m/s, and acceleration, m/s², of its origin;
    /// `angular`: velocity, rad/s, and acceleration, rad/s²; all in the world frame.
    ///
    /// # Errors
    /// As [`Self::set_pose`].
    pub fn set_free_motion(
        &mut self,
        joint: FreeJoint,
        (position, orientation): (DVec3, DQuat),
        linear: [DVec3; 2],
        angular: [DVec3; 2],
    ) -> Result<()> {
        self.set_pose(joint, position, orientation)?;
        let back = orientation.normalize().inverse();
        let row = |k: usize| [linear[k], back * angular[k]].into_iter().flat_map(|v| v.to_array());
        let (velocity, acceleration): (Vec<f64>, Vec<f64>) = (row(0).collect(), row(1).collect());
        let dofs = joint.dof..joint.dof + 6;
        self.data.qvel_mut()[dofs.clone()].copy_from_slice(&velocity);
        self.data.qacc_mut()[dofs].copy_from_slice(&acceleration);
        Ok(())
    }

    /// Computes the contact forces that the engine's contact model has at the current positions, velocities and
    /// accelerations (inverse dynamics); [`Self::contacts`] then lists them.
    pub fn inverse(&mut self) {
        self.data.inverse();
    }
}
