//! Grips in simulation: how hard a robot presses at the pose and with the torques that come out, against what it was told
//! to feel.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::follow::percentile;
use super::trajectory::{RATE, Trajectory};
use crate::error::{Error, Result};
use crate::hand::{N_KEYPOINTS, Side};
use crate::mujoco::options::Unchecked;
use crate::mujoco::{PhysicsOptions, World};
use crate::retarget::human::pad_normal;
use crate::retarget::human::{Hand, keypoint};
use crate::retarget::{Input, Retargeter, Robot, Touch};

/// Our own robot of joints with a position servo each.
const ROBOT: &str = "four_finger";
const MODEL: &str = include_str!("../../../sim/robots/four_finger.xml");
/// Its servos' stiffness, N m/rad.
const STIFFNESS: f64 = 4.0;
/// Radius of the object's balls, m.
const KNOB: f64 = 0.012;
/// Distance of human tips that hold something, m.
const APART: std::ops::RangeInclusive<f64> = 0.025..=0.07;
/// Cosine of the angle between a pad and the line to the other one from which on they face each other.
const FACING: f64 = 0.75;
/// Share of the force asked for that a robot is to press with at least.
pub(super) const PRESSED: f64 = 0.8;
/// Frames until the robot stands still, and steps until the object does.
const SETTLE: (usize, usize) = (40, 500);

/// How grips went.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Grips {
    /// Grips tried.
    pub count: usize,
    /// Poses left out: there the expected force is less than that asked for by more than a fifth.
    pub slippery: usize,
    /// Objects that were not held by both.
    pub lost: usize,
    /// Difference of the measured from the expected force over the expected one, of both fingers of those held.
    pub error_median: f64,
    /// Likewise, what nine of ten keep.
    pub error_p90: f64,
}

/// What holds the object.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hold {
    /// Nothing but the fingers.
    Free,
    /// The world, as it holds a door's handle.
    Fixed,
}

/// Grips objects at poses of a trajectory, `most` at most: two balls, one where each fingertip is pressed, joined.
///
/// # Errors
/// If the model can't be simulated.
pub fn measure(trajectory: &Trajectory, most: usize, hold: Hold) -> Result<Grips> {
    let mut grips = Grips::default();
    let mut errors = Vec::new();
    for (frame, keypoints) in trajectory.keypoints.iter().enumerate().step_by(3) {
        let hand = Hand::new(keypoints, Side::Right)?;
        for finger in (1..4).filter(|finger| holds(&hand, *finger)) {
            if grips.count == most {
                break;
            }
            let force = 1.0 + 2.0 * (0.37 * frame as f64).sin().abs();
            let Some(measured) = grip(keypoints, finger, force, hold)? else { continue };
            if measured.iter().any(|(_, expected)| *expected < PRESSED * force) {
                grips.slippery += 1;
                continue;
            }
            grips.count += 1;
            grips.lost += usize::from(measured.iter().any(|(got, _)| *got == 0.0));
            if measured.iter().all(|(got, _)| *got > 0.0) {
                errors.extend(measured.iter().map(|(got, expected)| (got - expected).abs() / expected));
            }
        }
    }
    (grips.error_median, grips.error_p90) = (percentile(&errors, 0.5), percentile(&errors, 0.9));
    Ok(grips)
}

/// Whether thumb and finger face each other as if they held something.
fn holds(hand: &Hand, finger: usize) -> bool {
    let [thumb, tip] = [0, finger].map(|finger| hand.points[keypoint(finger, 3)]);
    let line = (tip - thumb).normalize_or_zero();
    let facing = [(0, line), (finger, -line)].map(|(finger, line)| pad_normal(&hand.points, finger).dot(line));
    APART.contains(&tip.distance(thumb)) && facing.iter().all(|cosine| *cosine > FACING)
}

/// Measured and expected force of thumb and finger, N; None where the robot has no such finger, or is not to press.
fn grip(keypoints: &[DVec3; N_KEYPOINTS], finger: usize, force: f64, hold: Hold) -> Result<Option<[(f64, f64); 2]>> {
    let line = (keypoints[keypoint(0, 3)] - keypoints[keypoint(finger, 3)]).normalize_or_zero();
    let mut touch = Touch { tip_contact: [0.0; 5], tip_force: Some([DVec3::ZERO; 5]), segments: None };
    for (finger, force) in [(0, force * line), (finger, -force * line)] {
        touch.tip_contact[finger] = 1.0;
        touch.tip_force.iter_mut().for_each(|forces| forces[finger] = force);
    }
    let mut retargeter = Retargeter::new(Robot::load(ROBOT, None)?)?;
    for frame in 0..SETTLE.0 {
        let time = frame as f64 / RATE;
        retargeter.push(&Input { touch: Some(touch.clone()), ..Input::new(*keypoints, time) })?;
    }
    let output = retargeter.output().clone();
    let (robot, _) = retargeter.robot_and_goal_mut();
    let mut presses = Vec::new();
    for human in [0, finger] {
        let Some(tip) = robot.fingers.iter().find(|finger| finger.human == human).map(|finger| finger.tip_body) else {
            return Ok(None);
        };
        let name = robot.parts.bodies[tip].name.clone();
        let Some(link) = output.expected_touch.links.iter().find(|link| link.name == name && link.normal_force > 0.1)
        else {
            return Ok(None);
        };
        let (origin, rotation) = robot.world.body_pose(tip);
        let place = origin + rotation * link.body_position;
        presses.push(Press { tip: name, place, force: rotation * link.body_force });
    }
    let mut knobs = Vec::new();
    for press in &presses {
        let Some(knob) = knob(&output.qpos, press)? else { return Ok(None) };
        knobs.push(knob);
    }
    let middle = 0.5 * (knobs[0] + knobs[1]);
    let balls: String =
        knobs.iter().map(|knob| ball(*knob - if hold == Hold::Free { middle } else { DVec3::ZERO })).collect();
    let (mut world, mut qpos) = (world_with(&hold.body(&balls))?, output.qpos.clone());
    if hold == Hold::Free {
        qpos.extend([middle.x, middle.y, middle.z, 1.0, 0.0, 0.0, 0.0]);
    }
    world.set_qpos(&qpos)?;
    let mut ctrl = output.ctrl.clone();
    for (joint, torque) in robot.coupling.masters.iter().zip(&output.expected_touch.torque) {
        let name = &robot.parts.joints[*joint].name;
        if let Some(servo) = robot.commands.names.iter().position(|command| command == name) {
            ctrl[servo] += torque / STIFFNESS;
        }
    }
    world.set_ctrl(&ctrl)?;
    for _ in 0..SETTLE.1 {
        world.step();
    }
    world.forward();
    let object = world.body("object")?;
    let mut forces = [(0.0, 0.0); 2];
    for (press, force) in presses.iter().zip(&mut forces) {
        let tip = world.body(&press.tip)?;
        let between = |bodies: &[_; 2]| bodies.contains(&object) && bodies.contains(&tip);
        let measured: DVec3 = world.contacts().filter(|c| between(&c.bodies)).map(|c| c.force).sum();
        *force = (measured.length(), press.force.length());
    }
    Ok(Some(forces))
}

/// A fingertip and what the world does to it.
struct Press {
    tip: String,
    /// Where, in the world frame, m.
    place: DVec3,
    /// N.
    force: DVec3,
}

/// Middle of the ball that touches a fingertip where it is pressed, m; None where none does.
fn knob(qpos: &[f64], press: &Press) -> Result<Option<DVec3>> {
    const NEAR: f64 = 0.1;
    let mut world = world_with(&format!(r#"<body name="object"><freejoint/>{}</body>"#, ball(DVec3::ZERO)))?;
    let parts = world.parts();
    let tip = world.body(&press.tip)?;
    let of_tip =
        |geom: &usize| parts.geoms[*geom].solid && world.body_name(tip) == parts.bodies[parts.geoms[*geom].body].name;
    let geoms: Vec<usize> = (0..parts.geoms.len()).filter(of_tip).collect();
    let probe = parts.geoms.len() - 1;
    let toward = press.force.normalize_or_zero();
    let mut at = press.place - 0.04 * toward;
    // The ball comes along the force until it touches.
    for _ in 0..30 {
        let mut all = qpos.to_vec();
        all.extend([at.x, at.y, at.z, 1.0, 0.0, 0.0, 0.0]);
        world.set_qpos(&all)?;
        world.update_poses();
        let gap = geoms.iter().map(|geom| world.geom_distance([*geom, probe], NEAR).0).fold(NEAR, f64::min);
        at += gap * toward;
        if gap.abs() < 1e-5 {
            return Ok(Some(at));
        }
    }
    Ok(None)
}

fn ball(at: DVec3) -> String {
    let DVec3 { x, y, z } = at;
    format!(r#"<geom type="sphere" size="{KNOB}" pos="{x} {y} {z}" mass="0.05" friction="1 0.005 0.0001"/>"#)
}

impl Hold {
    fn body(self, balls: &str) -> String {
        let joint = if self == Self::Free { "<freejoint/>" } else { "" };
        format!(r#"<body name="object">{joint}{balls}</body>"#)
    }
}

/// The robot without gravity, and something else.
fn world_with(body: &str) -> Result<World> {
    let (before, after) =
        MODEL.rsplit_once("</worldbody>").ok_or_else(|| Error::value("four_finger.xml", "a worldbody", "none"))?;
    let options = PhysicsOptions::try_from(Unchecked { gravity: [0.0; 3], ..Unchecked::default() })?;
    World::from_mjcf(&format!("{before}{body}</worldbody>{after}"), &options)
}
