//! Reading and writing positions, velocities, controls and applied forces.

use glam::{DQuat, DVec3};

use super::{Body, FreeJoint, Servo, World};
use crate::error::{Error, Result};

impl World {
    /// Returns the positions of all joints (metres, radians or quaternions) in the engine's order.
    pub fn qpos(&self) -> &[f64] {
        self.data.qpos()
    }

    /// Sets the positions of all joints, in the order of [`Self::qpos`].
    ///
    /// # Errors
    /// If the length differs, or a value is not finite.
    pub fn set_qpos(&mut self, qpos: &[f64]) -> Result<()> {
        assign("qpos", self.data.qpos_mut(), qpos)
    }

    /// Returns the positions for writing, in the order of [`Self::qpos`]. Values are not validated; a guard of the
    /// simulation reports an invalid state.
    pub fn qpos_mut(&mut self) -> &mut [f64] {
        self.data.qpos_mut()
    }

    /// Returns the velocities of all degrees of freedom, m/s or rad/s.
    pub fn qvel(&self) -> &[f64] {
        self.data.qvel()
    }

    /// Returns the velocities for writing, in the order of [`Self::qvel`]; not validated, as [`Self::qpos_mut`].
    pub fn qvel_mut(&mut self) -> &mut [f64] {
        self.data.qvel_mut()
    }

    /// Returns the targets of all servos in the engine's order.
    pub fn ctrl(&self) -> &[f64] {
        self.data.ctrl()
    }

    /// Sets the targets of all servos, in the order of [`Self::ctrl`].
    ///
    /// # Errors
    /// As [`Self::set_qpos`].
    pub fn set_ctrl(&mut self, ctrl: &[f64]) -> Result<()> {
        assign("ctrl", self.data.ctrl_mut(), ctrl)
    }

    /// Returns the angle of a servo's joint, rad, or its displacement, m.
    pub fn joint_position(&self, servo: Servo) -> f64 {
        self.data.qpos()[servo.qpos]
    }

    /// Sets the position of a servo's joint; call [`Self::forward`] or [`Self::kinematics`] afterwards.
    pub fn set_joint_position(&mut self, servo: Servo, position: f64) {
        self.data.qpos_mut()[servo.qpos] = position;
    }

    /// Sets the target of a servo.
    pub fn set_target(&mut self, servo: Servo, target: f64) {
        self.data.ctrl_mut()[servo.ctrl] = target;
    }

    /// Sets position and orientation of a free body.
    ///
    /// # Errors
    /// If the position is not finite or the orientation is not a unit quaternion: the engine reads a zero quaternion as
    /// the identity and does not normalise others.
    pub fn set_pose(&mut self, joint: FreeJoint, position: DVec3, orientation: DQuat) -> Result<()> {
        if !position.is_finite() {
            return Err(Error::value("position", "finite metres", position));
        }
        let length = orientation.length();
        if !length.is_finite() || (length - 1.0).abs() > 1e-3 {
            return Err(Error::value("orientation", "a unit quaternion", format!("length {length}")));
        }
        let orientation = orientation.normalize();
        let qpos = &mut self.data.qpos_mut()[joint.qpos..joint.qpos + 7];
        qpos[..3].copy_from_slice(&position.to_array());
        qpos[3..].copy_from_slice(&[orientation.w, orientation.x, orientation.y, orientation.z]);
        Ok(())
    }

    /// Sets position and orientation of a mocap body.
    pub fn set_mocap(&mut self, mocap: usize, position: DVec3, orientation: DQuat) {
        self.data.mocap_pos_mut()[mocap] = position.to_array();
        self.data.mocap_quat_mut()[mocap] = [orientation.w, orientation.x, orientation.y, orientation.z];
    }

    /// Applies a force, N, and a torque, N m, to a body's centre of mass in every step from now on, world frame. Not
    /// validated, as [`Self::qpos_mut`].
    pub fn apply_force(&mut self, Body(body): Body, force: DVec3, torque: DVec3) {
        let [fx, fy, fz] = force.to_array();
        let [tx, ty, tz] = torque.to_array();
        self.data.xfrc_applied_mut()[body] = [fx, fy, fz, tx, ty, tz];
    }
}

fn assign(name: &str, to: &mut [f64], from: &[f64]) -> Result<()> {
    if to.len() != from.len() {
        return Err(Error::shape(name, format!("[{}]", to.len()), [from.len()]));
    }
    if let Some(bad) = from.iter().position(|value| !value.is_finite()) {
        return Err(Error::value(format!("{name}[{bad}]"), "a finite number", from[bad]));
    }
    to.copy_from_slice(from);
    Ok(())
}
