//! Energies and constraint power, which the simulation's energy guard balances.

use glam::DVec3;
use mujoco_rs::prelude::*;

use super::{Body, FreeJoint, World};

/// Torque that counts as zero, N m: rounding of sums that cancel.
const ZERO_TORQUE: f64 = 1e-12;

impl World {
    /// Returns the power of all constraints (contacts, limits, friction), W, at generalised velocities `qvel`.
    pub fn constraint_power(&self, qvel: &[f64]) -> f64 {
        self.data.qfrc_constraint().iter().zip(qvel).map(|(force, v)| force * v).sum()
    }

    /// Returns an upper bound of the energy stored in joint limits, J: the force of all constraints on the joint times
    /// its distance beyond the limit.
    pub fn limit_energy(&self) -> f64 {
        let (model, data) = (self.model(), &self.data);
        let joints = (0..model.jnt_limited().len()).filter(|joint| {
            let hinge_or_slide = !matches!(model.jnt_type()[*joint], MjtJoint::mjJNT_FREE | MjtJoint::mjJNT_BALL);
            model.jnt_limited()[*joint] && hinge_or_slide
        });
        let energy = |joint: usize| {
            let position = data.qpos()[model.jnt_qposadr()[joint] as usize];
            let [low, high] = model.jnt_range()[joint];
            let beyond = (low - position).max(position - high).max(0.0);
            beyond * data.qfrc_constraint()[model.jnt_dofadr()[joint] as usize].abs()
        };
        joints.map(energy).sum()
    }

    /// Returns true if a torque other than the inertial one acts on a free body.
    pub fn is_turned(&self, joint: FreeJoint) -> bool {
        let dofs = joint.dof + 3..joint.dof + 6;
        let (smooth, bias) = (self.data.qfrc_smooth(), self.data.qfrc_bias());
        // Smooth forces contain minus the bias. Gravity has no torque about the centre of mass, so the bias is
        // inertial.
        let outer = smooth[dofs.clone()].iter().zip(&bias[dofs.clone()]).map(|(s, b)| s + b);
        let constraint = self.data.qfrc_constraint()[dofs].iter().copied();
        constraint.chain(outer).any(|torque| torque.abs() > ZERO_TORQUE)
    }

    /// Returns the kinetic energy of a free body's rotation, J.
    pub fn spin_energy(&self, joint: FreeJoint) -> f64 {
        let Body(body) = joint.body;
        let model = self.model();
        let [w, x, y, z] = model.body_iquat()[body];
        let omega = DVec3::from_slice(&self.data.qvel()[joint.dof + 3..joint.dof + 6]);
        let omega = glam::DQuat::from_xyzw(x, y, z, w).inverse() * omega;
        0.5 * (DVec3::from_array(model.body_inertia()[body]) * omega * omega).element_sum()
    }

    /// Returns the kinetic energy of all bodies, J; valid after [`Self::forward`].
    pub fn kinetic_energy(&mut self) -> f64 {
        self.data.energy_vel();
        self.data.energy()[1]
    }

    /// Returns true if constraints may add energy: a driven body can touch or hold something, or a surface moves or
    /// sticks.
    ///
    /// Welds and couplings count too, because the energy that such a constraint stores is unknown.
    pub fn constraints_may_work(&self) -> bool {
        let model = self.model();
        let driven = (0..model.body_mocapid().len()).any(|body| {
            model.body_mocapid()[body] >= 0 && (model.body_contype()[body] != 0 || model.body_conaffinity()[body] != 0)
        });
        let moving_surface = model.geom_surfacevel().iter().flatten().any(|v| *v != 0.0);
        let sticking = model.geom_adhesion().iter().any(|a| *a != 0.0);
        driven || moving_surface || sticking || model.ffi().neq > 0 || model.ffi().nflex > 0
    }
}
