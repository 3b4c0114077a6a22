//! Joints that move a body, and the velocity they give it.

use glam::DVec3;

use super::coupling::{Coupling, JointDrive};
use crate::mujoco::World;
use crate::mujoco::parts::{Motion, Parts};

/// Greatest distance of joint anchors that make one knuckle, m: the axes of such joints nearly cross.
pub const SAME_KNUCKLE: f64 = 0.006;

/// Hinge or slide that moves a body.
#[derive(Debug, Clone, Copy)]
pub struct ChainJoint {
    /// Index of the joint.
    pub joint: usize,
    /// Free coordinate that drives it.
    pub coordinate: usize,
    /// Joint position per unit of the coordinate.
    pub ratio: f64,
    /// True for a hinge, false for a slide.
    pub is_hinge: bool,
}

/// Returns the driven joints that move a body, from the root to the body.
pub fn chain(parts: &Parts, coupling: &Coupling, body: usize) -> Vec<ChainJoint> {
    let mut bodies = Vec::new();
    let mut at = body;
    while at != 0 {
        bodies.push(at);
        at = parts.bodies[at].parent;
    }
    let mut chain = Vec::new();
    for body in bodies.into_iter().rev() {
        for (index, joint) in parts.joints.iter().enumerate().filter(|(_, joint)| joint.body == body) {
            if let JointDrive::Coupled { coordinate, ratio, .. } = coupling.joints[index] {
                let is_hinge = joint.motion == Motion::Hinge;
                chain.push(ChainJoint { joint: index, coordinate, ratio, is_hinge });
            }
        }
    }
    chain
}

/// Velocity of a point per unit velocity of a joint, in the world; (anchor, axis): of the joint, in the world.
pub fn point_velocity(is_hinge: bool, (anchor, axis): (DVec3, DVec3), point: DVec3) -> DVec3 {
    if is_hinge { axis.cross(point - anchor) } else { axis }
}

/// Jacobian of a point fixed to a body: for each joint that moves it, the coordinate and the point's velocity in the world
/// per unit of the coordinate, m. A coordinate that drives several joints comes several times.
pub fn jacobian(
    world: &World,
    parts: &Parts,
    coupling: &Coupling,
    body: usize,
    point: DVec3,
) -> impl Iterator<Item = (usize, DVec3)> {
    chain(parts, coupling, body).into_iter().map(move |joint| {
        let velocity = point_velocity(joint.is_hinge, world.joint_axis(joint.joint), point);
        (joint.coordinate, joint.ratio * velocity)
    })
}
