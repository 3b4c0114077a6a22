//! Hinges of a hand.

use glam::DVec3;

use super::{HandFrame, JOINT_NAMES, base_joint};
use crate::hand::N_JOINTS;
use crate::sim::scene::HandSite;

/// Hinge of a hand.
#[derive(Debug, Clone, PartialEq)]
pub struct Hinge {
    /// Name without the hand's prefix, e.g. `index1_flex`.
    pub name: String,
    /// Index of the joint.
    pub joint: usize,
    /// Finger.
    pub site: HandSite,
    /// Kind of motion.
    pub motion: HingeMotion,
    /// Unit axis in the joint's frame.
    pub axis: DVec3,
    /// Limits, rad.
    pub range: [f64; 2],
    /// Servo stiffness, N m/rad.
    pub stiffness: f64,
    /// Servo damping, N m s/rad.
    pub damping: f64,
    /// Torque limit, N m.
    pub torque: f64,
}

/// Kinds of hinge motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HingeMotion {
    /// Flexion towards the palm.
    Flex,
    /// Abduction towards the thumb; of the thumb, out of the palm's plane.
    Abduct,
    /// Rotation about the bone.
    Twist,
}

/// Creates the hinges of a human hand: ranges in rad, torques that give several newtons at a fingertip.
pub(super) fn hinges(joints: &[DVec3; N_JOINTS], frame: &HandFrame, tips: &[DVec3; 5]) -> Vec<Hinge> {
    let mut hinges = Vec::new();
    for (site, tip) in HandSite::FINGERS.into_iter().zip(tips) {
        let base = base_joint(site);
        let bones = [joints[base + 1] - joints[base], joints[base + 2] - joints[base + 1], *tip - joints[base + 2]];
        let pad = frame.pad_direction(site);
        let mut add = |link: usize, motion, axis: DVec3, range, stiffness, torque| {
            let joint = base + link;
            let word = match motion {
                HingeMotion::Flex => "flex",
                HingeMotion::Abduct => "abduct",
                HingeMotion::Twist => "twist",
            };
            let name = format!("{}_{word}", JOINT_NAMES[joint]);
            let axis = axis.try_normalize().unwrap_or(frame.thumb);
            let damping = 0.04 * stiffness;
            hinges.push(Hinge { name, joint, site, motion, axis, range, stiffness, damping, torque });
        };
        // A rotation about a x b moves a towards b.
        if site == HandSite::Thumb {
            let bone = bones[0];
            add(0, HingeMotion::Abduct, bone.cross(frame.palm), [-0.3, 1.0], 2.5, 1.2);
            add(0, HingeMotion::Flex, bone.cross(-frame.thumb), [-0.5, 0.7], 2.5, 1.2);
            add(0, HingeMotion::Twist, bone, [-0.8, 0.8], 1.5, 0.8);
            add(1, HingeMotion::Flex, bones[1].cross(pad), [-0.2, 0.9], 1.8, 0.8);
            add(2, HingeMotion::Flex, bones[2].cross(pad), [-0.3, 1.3], 1.2, 0.5);
        } else {
            add(0, HingeMotion::Abduct, bones[0].cross(frame.thumb), [-0.3, 0.3], 1.5, 0.5);
            add(0, HingeMotion::Flex, bones[0].cross(pad), [-0.4, 1.6], 1.8, 1.0);
            add(1, HingeMotion::Flex, bones[1].cross(pad), [-0.05, 1.8], 1.4, 0.7);
            add(2, HingeMotion::Flex, bones[2].cross(pad), [-0.1, 1.2], 0.9, 0.4);
        }
    }
    hinges
}
