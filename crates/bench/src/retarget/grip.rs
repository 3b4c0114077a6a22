//! Grips in simulation: forces with which a robot presses at the retargeted pose and torques, against the forces that the
//! retargeter expects.

use egotac::error::{Error, Result};
use egotac::hand::{N_KEYPOINTS, Side};
use egotac::mujoco::options::Unchecked;
use egotac::mujoco::{PhysicsOptions, World};
use egotac::retarget::human::pad_normal;
use egotac::retarget::human::{Hand, keypoint};
use egotac::retarget::{Input, Retargeter, Robot, Touch};
use egotac::statistics::{median, percentile};
use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::trajectory::{RATE, Trajectory};

/// Shipped robot that has a position servo at each joint.
const ROBOT: &str = "four_finger";
const MODEL: &str = include_str!("../../../../sim/robots/four_finger.xml");
/// Stiffness of its servos, N m/rad.
const STIFFNESS: f64 = 4.0;
/// Radius of the object's balls, m.
const BALL_RADIUS: f64 = 0.012;
/// Distance between the human tips that counts as holding something, m.
const HELD_WIDTH: std::ops::RangeInclusive<f64> = 0.025..=0.07;
/// Least cosine of the angle between a pad's normal and the line to the other tip at which the pads face each other.
const FACING: f64 = 0.75;
/// Least share of the force asked for that the retargeter has to expect; poses below it are left out.
pub(super) const PRESSED: f64 = 0.8;
/// Frames until the robot stands still.
const SETTLE_FRAMES: usize = 40;
/// Steps until the object stands still.
const SETTLE_STEPS: usize = 500;

/// Results of all grips.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Grips {
    /// Grips tried.
    pub count: usize,
    /// Poses left out, at which the expected force is below 0.8 of the force asked for.
    pub slippery: usize,
    /// Objects that were not held by both fingers.
    pub lost: usize,
    /// Difference between measured and expected force over the expected force, median of both fingers of held objects.
    pub error_median: f64,
    /// Difference between measured and expected force over the expected force, 90th percentile.
    pub error_p90: f64,
}

/// Support of the object.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hold {
    /// The fingers alone.
    Free,
    /// The world, as it holds the handle of a door.
    Fixed,
}

/// Grips at most `most` objects at poses of a trajectory. An object is two joined balls, one at each pressed fingertip.
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
    (grips.error_median, grips.error_p90) = (median(errors.iter().copied()), percentile(errors, 0.9));
    Ok(grips)
}

/// Returns true if thumb and finger face each other as if they held something.
fn holds(hand: &Hand, finger: usize) -> bool {
    let [thumb, tip] = [0, finger].map(|finger| hand.points[keypoint(finger, 3)]);
    let line = (tip - thumb).normalize_or_zero();
    let facing = [(0, line), (finger, -line)].map(|(finger, line)| pad_normal(&hand.points, finger).dot(line));
    HELD_WIDTH.contains(&tip.distance(thumb)) && facing.iter().all(|cosine| *cosine > FACING)
}

/// Returns the measured and expected force of thumb and finger, N; `None` if the robot has no such finger or the
/// retargeter expects no force on it.
fn grip(keypoints: &[DVec3; N_KEYPOINTS], finger: usize, force: f64, hold: Hold) -> Result<Option<[(f64, f64); 2]>> {
    let line = (keypoints[keypoint(0, 3)] - keypoints[keypoint(finger, 3)]).normalize_or_zero();
    let mut touch = Touch { tip_contact: [0.0; 5], tip_force: Some([DVec3::ZERO; 5]), segments: None };
    for (finger, force) in [(0, force * line), (finger, -force * line)] {
        touch.tip_contact[finger] = 1.0;
        touch.tip_force.iter_mut().for_each(|forces| forces[finger] = force);
    }
    let mut retargeter = Retargeter::new(Robot::load(ROBOT, None)?)?;
    for frame in 0..SETTLE_FRAMES {
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
    for _ in 0..SETTLE_STEPS {
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

/// A fingertip and the force of the world on it.
struct Press {
    tip: String,
    /// Point of attack in the world frame, m.
    place: DVec3,
    /// Force in the world frame, N.
    force: DVec3,
}

/// Finds the centre of the ball that touches a fingertip where it is pressed, m; `None` if no ball does.
fn knob(qpos: &[f64], press: &Press) -> Result<Option<DVec3>> {
    /// Distance up to which the engine computes gaps, m.
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
    // The ball moves along the force until it touches.
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
    format!(r#"<geom type="sphere" size="{BALL_RADIUS}" pos="{x} {y} {z}" mass="0.05" friction="1 0.005 0.0001"/>"#)
}

impl Hold {
    fn body(self, balls: &str) -> String {
        let joint = if self == Self::Free { "<freejoint/>" } else { "" };
        format!(r#"<body name="object">{joint}{balls}</body>"#)
    }
}

/// Builds the robot without gravity, with `body` added to the world.
fn world_with(body: &str) -> Result<World> {
    let (before, after) =
        MODEL.rsplit_once("</worldbody>").ok_or_else(|| Error::value("four_finger.xml", "a worldbody", "none"))?;
    let options = PhysicsOptions::try_from(Unchecked { gravity: [0.0; 3], ..Unchecked::default() })?;
    World::from_mjcf(&format!("{before}{body}</worldbody>{after}"), &options)
}
