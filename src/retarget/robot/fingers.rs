//! Fingers of a robot hand: the chains of its model that bend.

use glam::DVec3;

use super::kinematics::SAME_KNUCKLE;
use super::labels::labels;
use super::lookup;
use super::spec::{FINGERS, FingerSpec, RobotSpec, finger_index};
use super::tip::{Tip, colliding_or_all, find_tip, named_body, world_points};
use crate::error::{Error, Result};
use crate::mujoco::World;
use crate::mujoco::parts::{Motion, Parts};

/// Least cosine between a joint's axis and the last joint's at which the joint bends the finger (45 degrees).
const MIN_BEND_COSINE: f64 = 0.7;
/// Greatest distance of a tip from the ends of the geoms that are its skin, m. A tip further out has lost its mesh.
const MAX_TIP_OVERHANG: f64 = 0.005;

/// Finger of the robot.
#[derive(Debug, Clone)]
pub struct Finger {
    /// Human finger that it stands for, thumb 0 to little 4.
    pub human: usize,
    /// Bodies with a joint, from base to tip.
    pub links: Vec<usize>,
    /// Joints that move, from base to tip.
    pub joints: Vec<usize>,
    /// Body that carries the tip.
    pub tip_body: usize,
    /// Tip in that body's frame, m.
    pub tip: DVec3,
    /// Outward normal of the pad, in the tip body's frame.
    pub pad_normal: DVec3,
    /// Geoms of the fingertip; none if the model has no skin at the tip, which then touches others as a point.
    pub pad_geoms: Vec<usize>,
    /// Joints at which it bends, from base to tip; the first of those in one place.
    pub knuckles: Vec<usize>,
    /// Length of its last three phalanges (of all if it has fewer) from knuckle to knuckle to tip, m.
    pub length: f64,
    /// Part of the model that the tip was derived from, for people.
    pub tip_name: String,
}

impl Finger {
    /// Position of the tip in the world, m.
    pub fn tip_position(&self, world: &World) -> DVec3 {
        let (origin, rotation) = world.body_pose(self.tip_body);
        origin + rotation * self.tip
    }

    /// Outward normal of the pad in the world.
    pub fn world_pad_normal(&self, world: &World) -> DVec3 {
        world.body_pose(self.tip_body).1 * self.pad_normal
    }
}

/// Finds the fingers of a robot; `moves`: for each joint, true if it moves. Normals and lengths are those of the present
/// pose.
///
/// # Errors
/// If a name of the spec is not in the model, or there is no finger.
pub fn find(world: &World, parts: &Parts, spec: &RobotSpec, moves: &[bool]) -> Result<Vec<Finger>> {
    let chains = chains(parts, moves);
    let mut fingers = Vec::new();
    if spec.fingers.is_empty() {
        let labels = labels(world, parts, &chains);
        for (chain, label) in chains.iter().zip(labels) {
            if let Some(human) = label {
                fingers.push(finger(world, parts, moves, human, &FingerSpec::default(), chain.clone())?);
            }
        }
    } else {
        for (name, written) in &spec.fingers {
            let tip = named_body(parts, name, &written.tip)?;
            let chain = chain_of(parts, moves, &chains, tip);
            fingers.push(finger(world, parts, moves, finger_index(name)?, written, chain)?);
        }
    }
    fingers.sort_by_key(|finger| finger.human);
    if fingers.is_empty() {
        let joints: Vec<&str> = parts.joints.iter().map(|joint| joint.name.as_str()).collect();
        let got = format!("joints {}", joints.join(", "));
        return Err(Error::value("robot", "at least one finger: a chain of hinges or slides", got));
    }
    Ok(fingers)
}

/// Returns the chains of bodies with moving joints, each from the body that leaves the other chains to its last.
fn chains(parts: &Parts, moves: &[bool]) -> Vec<Vec<usize>> {
    let is_moving = |body: usize| parts.joints.iter().zip(moves).any(|(joint, moves)| *moves && joint.body == body);
    let moving: Vec<usize> = (1..parts.bodies.len()).filter(|body| is_moving(*body)).collect();
    let above = |body: usize| {
        let mut at = parts.bodies[body].parent;
        while at != 0 && !moving.contains(&at) {
            at = parts.bodies[at].parent;
        }
        at
    };
    let is_leaf = |body: &usize| moving.iter().all(|other| above(*other) != *body);
    let chain = |leaf: usize| {
        let mut chain = vec![leaf];
        let mut at = above(leaf);
        // A body that carries several fingers belongs to the palm. A single finger ends at the root.
        while at != 0 && moving.iter().filter(|body| above(**body) == at).count() < 2 {
            chain.push(at);
            at = above(at);
        }
        chain.reverse();
        chain
    };
    moving.iter().copied().filter(is_leaf).map(chain).collect()
}

/// Returns the chain that moves a body, up to that body; empty if no joint moves it.
fn chain_of(parts: &Parts, moves: &[bool], chains: &[Vec<usize>], tip_body: usize) -> Vec<usize> {
    let mut at = tip_body;
    while at != 0 {
        if parts.joints.iter().zip(moves).any(|(joint, moves)| *moves && joint.body == at)
            && let Some(chain) = chains.iter().find(|chain| chain.contains(&at))
        {
            return chain.iter().copied().take_while(|link| *link != at).chain([at]).collect();
        }
        at = parts.bodies[at].parent;
    }
    Vec::new()
}

/// Derives a finger from its chain of bodies.
fn finger(
    world: &World,
    parts: &Parts,
    moves: &[bool],
    human: usize,
    spec: &FingerSpec,
    links: Vec<usize>,
) -> Result<Finger> {
    let name = FINGERS[human];
    let Some(last) = links.last().copied() else {
        return Err(Error::value(format!("fingers.{name}.tip"), "a body that a joint moves", "one that stands still"));
    };
    for link in &spec.links {
        lookup::body(parts, link)?;
    }
    let joints: Vec<usize> = links
        .iter()
        .flat_map(|link| (0..parts.joints.len()).filter(|joint| parts.joints[*joint].body == *link))
        .filter(|joint| moves[*joint])
        .collect();
    let Tip { body: tip_body, position: tip, name: tip_name } = find_tip(world, parts, &spec.tip, last, &joints)?;
    let (origin, rotation) = world.body_pose(tip_body);
    let tip_position = origin + rotation * tip;
    let knuckles = knuckles(world, parts, human, &joints);
    let anchors: Vec<DVec3> = knuckles.iter().map(|joint| world.joint_axis(*joint).0).chain([tip_position]).collect();
    // The third knuckle from the tip is the base of the finger; one before it turns a metacarpal, which is part of the palm.
    let phalanges = &anchors[anchors.len().saturating_sub(4)..];
    let length = phalanges.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
    let along = anchors.len().checked_sub(2).map_or(DVec3::ZERO, |at| (tip_position - anchors[at]).normalize_or_zero());
    let pad_geoms = pad_geoms(world, parts, spec, last, tip_position, along)?;
    let pad_normal = match spec.pad_normal {
        Some(normal) => DVec3::from_array(normal).try_normalize().ok_or_else(|| {
            Error::value(format!("fingers.{name}.pad_normal"), "a direction", "a vector without length")
        })?,
        None => rotation.transpose() * closing_direction(world, parts, &joints, tip_position, along),
    };
    Ok(Finger { human, links, joints, tip_body, tip, pad_normal, pad_geoms, knuckles, length, tip_name })
}

/// Returns the joints at which a finger bends, one for each knuckle.
fn knuckles(world: &World, parts: &Parts, human: usize, joints: &[usize]) -> Vec<usize> {
    let hinges: Vec<usize> =
        joints.iter().copied().filter(|joint| parts.joints[*joint].motion == Motion::Hinge).collect();
    let last_axis = hinges.last().map_or(DVec3::ZERO, |joint| world.joint_axis(*joint).1);
    // A finger bends about axes parallel to its last one; those of a thumb have any direction.
    let bends = |joint: &usize| human == 0 || world.joint_axis(*joint).1.dot(last_axis).abs() > MIN_BEND_COSINE;
    let mut knuckles: Vec<usize> = Vec::new();
    for joint in hinges.into_iter().filter(bends) {
        let anchor = world.joint_axis(joint).0;
        if knuckles.last().is_none_or(|other| world.joint_axis(*other).0.distance(anchor) > SAME_KNUCKLE) {
            knuckles.push(joint);
        }
    }
    knuckles
}

/// Returns the geoms of a fingertip: those that the file names, otherwise those of the last part; none of them if they all
/// end before the tip, because then the mesh of the tip itself is missing.
fn pad_geoms(
    world: &World,
    parts: &Parts,
    spec: &FingerSpec,
    last: usize,
    tip_position: DVec3,
    along: DVec3,
) -> Result<Vec<usize>> {
    if !spec.pad_geoms.is_empty() {
        return spec.pad_geoms.iter().map(|name| lookup::geom(parts, name)).collect();
    }
    let of_tip = |geom: &usize| {
        let geom = &parts.geoms[*geom];
        geom.solid && parts.bodies[geom.body].part == parts.bodies[last].part
    };
    let geoms = colliding_or_all(parts, (0..parts.geoms.len()).filter(of_tip).collect());
    let is_bare = overhang(world, parts, &geoms, tip_position, along) > MAX_TIP_OVERHANG;
    Ok(if is_bare { Vec::new() } else { geoms })
}

/// Distance of a tip from the far end of some geoms, m; negative = within them, infinite without geoms.
fn overhang(world: &World, parts: &Parts, geoms: &[usize], tip: DVec3, along: DVec3) -> f64 {
    let one = |geom: &usize| {
        world_points(world, parts, *geom).map(|point| (tip - point).dot(along)).fold(f64::INFINITY, f64::min)
    };
    geoms.iter().map(one).fold(f64::INFINITY, f64::min)
}

/// Direction in which the tip moves, across the last phalanx, when the last joint closes that moves it so. A joint closes
/// towards the larger part of its range.
fn closing_direction(world: &World, parts: &Parts, joints: &[usize], tip: DVec3, along: DVec3) -> DVec3 {
    // Not zero, which has no perpendicular: a tip at the last joint has no phalanx.
    let along = if along == DVec3::ZERO { DVec3::new(1e-9, 0.0, 1e-9) } else { along };
    for joint in joints.iter().rev() {
        let (anchor, axis) = world.joint_axis(*joint);
        let joint = &parts.joints[*joint];
        let position = world.qpos()[joint.qpos];
        let closes = if joint.range[1] - position >= position - joint.range[0] { 1.0 } else { -1.0 };
        let velocity = match joint.motion {
            Motion::Slide => axis,
            _ => axis.cross(tip - anchor),
        };
        if let Some(normal) = (closes * velocity).reject_from(along).try_normalize() {
            return normal;
        }
    }
    DVec3::Z
}
