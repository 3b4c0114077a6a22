//! Links of a robot that take force.

use glam::{DMat3, DVec3};

use crate::retarget::robot::Robot;
use crate::retarget::robot::fingers::Finger;
use crate::retarget::robot::kinematics::SAME_KNUCKLE;

/// Link of the robot that takes force.
#[derive(Debug, Clone)]
pub struct Link {
    /// Index of its body.
    pub body: usize,
    /// Base and end in the body's frame, m.
    pub ends: [DVec3; 2],
    /// Columns normal, lateral, along in the body's frame.
    pub axes: DMat3,
    /// Human finger whose robot fingertip this is; None = no fingertip.
    pub tip_of: Option<usize>,
}

/// Returns the last three links of a finger, or all if it has fewer, from base to tip.
pub fn finger_links(robot: &Robot, finger: &Finger) -> Vec<Link> {
    let tip = finger.tip_position(&robot.world);
    let pad = finger.world_pad_normal(&robot.world);
    let mut bases: Vec<(usize, DVec3)> = finger
        .knuckles
        .iter()
        .map(|joint| (robot.parts.joints[*joint].body, robot.world.joint_axis(*joint).0))
        .collect();
    if bases.is_empty() {
        let body = finger.tip_body;
        bases.push((body, robot.world.body_pose(body).0));
    }
    let count = bases.len();
    let link = |index: usize| {
        let (body, from) = bases[index];
        let is_tip = index + 1 == count;
        let to = if is_tip { tip } else { bases[index + 1].1 };
        let body = if is_tip { finger.tip_body } else { last_body_at(robot, finger, body, to) };
        let along = (to - from).try_normalize().unwrap_or(DVec3::Z);
        let normal =
            pad.reject_from_normalized(along).try_normalize().unwrap_or_else(|| along.any_orthonormal_vector());
        // On a left hand the wrist frame is left-handed, and so are the axes of human bones in it: mirror the lateral axis.
        let lateral = along.cross(normal);
        let lateral = if robot.wrist.axes.determinant() < 0.0 { -lateral } else { lateral };
        let (origin, rotation) = robot.world.body_pose(body);
        let into = rotation.transpose();
        Link {
            body,
            ends: [into * (from - origin), into * (to - origin)],
            axes: into * DMat3::from_cols(normal, lateral, along),
            tip_of: is_tip.then_some(finger.human),
        }
    };
    (count.saturating_sub(3)..count).map(link).collect()
}

/// Returns the last of the bodies whose joints share a knuckle: the one that carries the phalanx.
fn last_body_at(robot: &Robot, finger: &Finger, body: usize, next_knuckle: DVec3) -> usize {
    let at = finger.links.iter().position(|link| *link == body).unwrap_or(0);
    let mut last = body;
    for link in &finger.links[at..] {
        let anchor = robot.parts.joints.iter().position(|joint| joint.body == *link);
        if anchor.is_some_and(|joint| robot.world.joint_axis(joint).0.distance(next_knuckle) < SAME_KNUCKLE) {
            break;
        }
        last = *link;
    }
    last
}

/// Returns the palm; its normal points out of it.
pub fn palm_link(robot: &Robot) -> Link {
    let (origin, rotation) = robot.world.body_pose(robot.root);
    let (wrist, _) = robot.world.body_pose(robot.wrist.body);
    let axes = robot.wrist.world_axes(&robot.world);
    let bases = wrist + axes * robot.bases(|_| true);
    let into = rotation.transpose();
    let middle = into * (0.5 * (bases + wrist) - origin);
    Link { body: robot.root, ends: [middle; 2], axes: into * axes, tip_of: None }
}
