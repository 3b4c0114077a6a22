//! What guards read of a world: memory, depths, work of the constraints, motion at the touching points.

use glam::DVec3;
use mujoco_rs::prelude::*;

use super::world::{Body, FreeJoint, World};

/// What friction does at one touching point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grip {
    /// The two bodies.
    pub bodies: [Body; 2],
    /// Normal force, N.
    pub normal_force: f64,
    /// Friction as a share of what the cone allows; above 1 is outside of it.
    pub cone_ratio: f64,
    /// Velocity of the second body against the first in the plane of contact, m/s.
    pub slip: DVec3,
}

impl World {
    /// Share of the memory for contacts and scratch that was in use at most, 0 to 1.
    pub fn arena_use(&self) -> f64 {
        self.data().maxuse_arena() as f64 / (self.data().narena() as f64).max(1.0)
    }

    /// Work of all constraints (contacts, limits, friction) per second, W, with generalised velocities `qvel`.
    pub fn constraint_power(&self, qvel: &[f64]) -> f64 {
        self.data().qfrc_constraint().iter().zip(qvel).map(|(force, v)| force * v).sum()
    }

    /// Energy in joint limits, J, or rather more: the force of all constraints on the joint times how far it is beyond.
    pub fn limit_energy(&self) -> f64 {
        let (model, data) = (self.model(), self.data());
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

    /// Whether anything but its own inertia turns a free body.
    pub fn is_turned(&self, joint: FreeJoint) -> bool {
        let dofs = joint.dof + 3..joint.dof + 6;
        let data = self.data();
        // What is smooth but not inertial: gravity has no torque about the centre of mass, so the bias is inertia.
        let outer = data.qfrc_smooth()[dofs.clone()].iter().zip(&data.qfrc_bias()[dofs.clone()]).map(|(s, b)| s + b);
        data.qfrc_constraint()[dofs].iter().copied().chain(outer).any(|torque| torque.abs() > 1e-12)
    }

    /// Kinetic energy of a free body's rotation, J.
    pub fn spin_energy(&self, joint: FreeJoint) -> f64 {
        let Body(body) = joint.body;
        let model = self.model();
        let [w, x, y, z] = model.body_iquat()[body];
        let omega = DVec3::from_slice(&self.data().qvel()[joint.dof + 3..joint.dof + 6]);
        let omega = glam::DQuat::from_xyzw(x, y, z, w).inverse() * omega;
        0.5 * (DVec3::from_array(model.body_inertia()[body]) * omega * omega).element_sum()
    }

    /// Kinetic energy of everything, J; valid after [`Self::forward`].
    pub fn kinetic_energy(&mut self) -> f64 {
        self.data_mut().energy_vel();
        self.data().energy()[1]
    }

    /// Speed of a body's centre of mass, m/s, in the state before the last step or at the last [`Self::forward`].
    pub fn speed(&self, Body(body): Body) -> f64 {
        self.point_velocity(Body(body), DVec3::from_array(self.data().xipos()[body])).length()
    }

    /// Both bodies' and geoms' indices and the distance of each touching point, m; without its force, so cheap.
    pub fn gaps(&self) -> impl Iterator<Item = ([usize; 2], f64)> + '_ {
        self.data().contact().iter().filter_map(|contact| match contact.geom.map(usize::try_from) {
            [Ok(a), Ok(b)] => Some(([a, b], contact.dist)),
            _ => None, // a flex, not a geom
        })
    }

    /// Friction and slip at all touching points with a normal force; valid after [`Self::forward`].
    pub fn grips(&self) -> impl Iterator<Item = Grip> + '_ {
        let geom_body = self.model().geom_bodyid();
        self.data().contact().iter().enumerate().filter_map(move |(index, contact)| {
            let [Ok(geom1), Ok(geom2)] = contact.geom.map(usize::try_from) else { return None };
            let [normal_force, f1, f2, ..] = self.data().contact_force(index);
            if normal_force <= 0.0 {
                return None;
            }
            let bodies = [geom_body[geom1] as usize, geom_body[geom2] as usize];
            let normal = DVec3::from_slice(&contact.frame[..3]);
            let place = DVec3::from_array(contact.pos);
            let velocity = self.point_velocity(Body(bodies[1]), place) - self.point_velocity(Body(bodies[0]), place);
            let [mu1, mu2, ..] = contact.friction;
            let cone_ratio = if contact.dim > 1 { (f1 / mu1).hypot(f2 / mu2) / normal_force } else { 0.0 };
            let slip = velocity.reject_from_normalized(normal);
            Some(Grip { bodies: bodies.map(Body), normal_force, cone_ratio, slip })
        })
    }

    /// Index of the kinematic tree a body belongs to; `None` = it cannot move.
    pub fn tree(&self, Body(body): Body) -> Option<usize> {
        usize::try_from(self.model().body_treeid()[body]).ok()
    }

    /// All bodies that can move.
    pub fn moving_bodies(&self) -> Vec<Body> {
        let trees = self.model().body_treeid();
        (0..trees.len()).filter(|body| trees[*body] >= 0).map(Body).collect()
    }

    /// Whether constraints may do work on their own: a driven body touches or holds something, surfaces run or stick.
    ///
    /// Bodies that are welded or coupled count too: what such a constraint stores is not known.
    pub fn constraints_may_work(&self) -> bool {
        let model = self.model();
        let driven = (0..model.body_mocapid().len()).any(|body| {
            model.body_mocapid()[body] >= 0 && (model.body_contype()[body] != 0 || model.body_conaffinity()[body] != 0)
        });
        let running = model.geom_surfacevel().iter().flatten().any(|v| *v != 0.0);
        let sticking = model.geom_adhesion().iter().any(|a| *a != 0.0);
        driven || running || sticking || model.ffi().neq > 0 || model.ffi().nflex > 0
    }
}
