//! The links of a robot that take force.

use glam::{DMat3, DVec3};

use crate::retarget::robot::fingers::Finger;
use crate::retarget::robot::{Robot, frame};

/// A link of the robot that takes force.
#[derive(Debug, Clone)]
pub struct Link {
    /// The body it belongs to.
    pub body: usize,
    /// Base and end in the body's frame, m.
    pub ends: [DVec3; 2],
    /// Columns normal, lateral, along in the body's frame.
    pub axes: DMat3,
    /// Finger whose tip it is, as the human's.
    pub tip_of: Option<usize>,
}

/// A finger's links from base to tip, three at most.
pub fn finger_links(robot: &Robot, finger: &Finger) -> Vec<Link> {
    let tip = frame::place(&robot.world, finger);
    let pad = frame::normal(&robot.world, finger);
    let mut ends: Vec<(usize, DVec3)> = finger
        .knuckles
        .iter()
        .map(|joint| (robot.parts.joints[*joint].body, robot.world.joint_axis(*joint).0))
        .collect();
    if ends.is_empty() {
        let body = finger.tip_body;
        ends.push((body, robot.world.body_pose(body).0));
    }
    let count = ends.len();
    let skip = count.saturating_sub(3);
    (skip..count)
        .map(|index| {
            let (body, from) = ends[index];
            let is_tip = index + 1 == count;
            let to = if is_tip { tip } else { ends[index + 1].1 };
            let body = if is_tip { finger.tip_body } else { last_body_at(robot, finger, body, to) };
            let along = (to - from).try_normalize().unwrap_or(DVec3::Z);
            let normal =
                pad.reject_from_normalized(along).try_normalize().unwrap_or_else(|| along.any_orthonormal_vector());
            let (origin, rotation) = robot.world.body_pose(body);
            let into = rotation.transpose();
            Link {
                body,
                ends: [into * (from - origin), into * (to - origin)],
                axes: into * DMat3::from_cols(normal, along.cross(normal), along),
                tip_of: is_tip.then_some(finger.human),
            }
        })
        .map(|link| mirrored(robot, link))
        .collect()
}

/// On a left hand the wrist frame is left-handed, and so are the bones' frames seen in it: the lateral axis turns round.
fn mirrored(robot: &Robot, link: Link) -> Link {
    match robot.wrist.axes.determinant() < 0.0 {
        true => Link { axes: DMat3::from_cols(link.axes.x_axis, -link.axes.y_axis, link.axes.z_axis), ..link },
        false => link,
    }
}

/// Of bodies whose joints share a knuckle, the last: the one that carries the phalanx.
fn last_body_at(robot: &Robot, finger: &Finger, body: usize, next: DVec3) -> usize {
    let at = finger.links.iter().position(|link| *link == body).unwrap_or(0);
    let mut last = body;
    for link in &finger.links[at..] {
        let anchor = robot.parts.joints.iter().position(|joint| joint.body == *link);
        if anchor.is_some_and(|joint| robot.world.joint_axis(joint).0.distance(next) < 0.006) {
            break;
        }
        last = *link;
    }
    last
}

/// The palm, with the normal out of it.
pub fn palm_link(robot: &Robot) -> Link {
    let (origin, rotation) = robot.world.body_pose(robot.root);
    let (wrist, _) = robot.world.body_pose(robot.wrist.body);
    let axes = robot.wrist.world_axes(&robot.world);
    let bases = wrist + axes * robot.bases(|_| true);
    let into = rotation.transpose();
    let middle = into * (0.5 * (bases + wrist) - origin);
    Link { body: robot.root, ends: [middle; 2], axes: into * axes, tip_of: None }
}
