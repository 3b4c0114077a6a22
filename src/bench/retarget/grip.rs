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
use crate::retarget::goal::pad_normal;
use crate::retarget::human::{Hand, keypoint};
use crate::retarget::{Input, Retargeter, Robot, Touch};

/// Our own robot of joints with a position servo each.
const ROBOT: &str = "four_finger";
const MODEL: &str = include_str!("../../../sim/robots/four_finger.xml");
/// Its servos' stiffness, N m/rad.
const STIFFNESS: f64 = 4.0;
/// Distance of human tips that hold something, m.
const APART: std::ops::RangeInclusive<f64> = 0.025..=0.07;
/// Cosine of the angle between a pad and the line to the other one from which on they face each other.
const FACING: f64 = 0.75;
/// Frames until the robot stands still, and steps until the ball does.
const SETTLE: (usize, usize) = (40, 500);

/// How grips went.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Grips {
    /// Grips tried.
    pub count: usize,
    /// Balls that were not held.
    pub lost: usize,
    /// Difference of the measured from the expected force over the expected one, of both fingers of those held.
    pub error_median: f64,
    /// Likewise, what nine of ten keep.
    pub error_p90: f64,
}

/// Grips balls at poses of a trajectory, `most` at most.
///
/// # Errors
/// If the model can't be simulated.
pub fn measure(trajectory: &Trajectory, most: usize) -> Result<Grips> {
    let mut grips = Grips::default();
    let mut errors = Vec::new();
    for (frame, keypoints) in trajectory.keypoints.iter().enumerate().step_by(7) {
        let hand = Hand::new(keypoints, Side::Right)?;
        for finger in (1..4).filter(|finger| holds(&hand, *finger)) {
            if grips.count == most {
                break;
            }
            let force = 1.0 + 2.0 * (0.37 * frame as f64).sin().abs();
            let Some(measured) = grip(keypoints, finger, force)? else { continue };
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

/// Measured and expected force of thumb and finger, N; None where the robot has no room for a ball.
fn grip(keypoints: &[DVec3; N_KEYPOINTS], finger: usize, force: f64) -> Result<Option<[(f64, f64); 2]>> {
    let line = (keypoints[keypoint(0, 3)] - keypoints[keypoint(finger, 3)]).normalize_or_zero();
    let mut touch = Touch { tip_contact: [0.0; 5], tip_force: Some([DVec3::ZERO; 5]), slots: None };
    for (finger, force) in [(0, force * line), (finger, -force * line)] {
        touch.tip_contact[finger] = 1.0;
        touch.tip_force.iter_mut().for_each(|forces| forces[finger] = force);
    }
    let mut retargeter = Retargeter::new(Robot::load(ROBOT, None)?)?;
    for frame in 0..SETTLE.0 {
        let time = frame as f64 / RATE;
        retargeter.push(&Input { keypoints: *keypoints, time, touch: Some(touch.clone()) })?;
    }
    let output = retargeter.output().clone();
    let (robot, _) = retargeter.look();
    let tips: Vec<usize> = [0, finger]
        .iter()
        .filter_map(|human| robot.fingers.iter().find(|finger| finger.human == *human))
        .map(|finger| finger.tip_body)
        .collect();
    let [thumb, other] = tips[..] else { return Ok(None) };
    let Some([a, b]) = nearest(robot, thumb, other) else { return Ok(None) };
    // A ball that just fits between the tips.
    let (middle, radius) = (0.5 * (a + b), 0.5 * a.distance(b));
    let mut world = world_with_ball(radius)?;
    let mut qpos = output.qpos.clone();
    qpos.extend([middle.x, middle.y, middle.z, 1.0, 0.0, 0.0, 0.0]);
    world.set_qpos(&qpos)?;
    let mut ctrl = output.ctrl.clone();
    for (joint, torque) in robot.coupling.masters.iter().zip(&output.feel.torque) {
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
    let ball = world.body("ball")?;
    let mut forces = [(0.0, 0.0); 2];
    for (tip, force) in [thumb, other].into_iter().zip(&mut forces) {
        let name = robot.parts.bodies[tip].name.clone();
        let tip = world.body(&name)?;
        let between = |bodies: &[_; 2]| bodies.contains(&ball) && bodies.contains(&tip);
        let measured: DVec3 = world.contacts().filter(|c| between(&c.bodies)).map(|c| c.force).sum();
        let links = output.feel.links.iter().filter(|link| link.name == name);
        let expected: DVec3 = links.map(|link| link.force).sum();
        *force = (measured.length(), expected.length());
    }
    Ok(Some(forces))
}

/// The nearest points of two bodies' shapes, m; None where they are too near for a ball, or too far.
fn nearest(robot: &mut Robot, a: usize, b: usize) -> Option<[DVec3; 2]> {
    const MOST: f64 = 0.08;
    let of = |body: usize| -> Vec<usize> {
        (0..robot.parts.geoms.len())
            .filter(|geom| robot.parts.geoms[*geom].solid && robot.parts.geoms[*geom].body == body)
            .collect()
    };
    let (a, b) = (of(a), of(b));
    let mut best: Option<(f64, [DVec3; 2])> = None;
    for pair in a.iter().flat_map(|a| b.iter().map(move |b| [*a, *b])) {
        if let (distance, Some(points)) = robot.world.geom_distance(pair, MOST)
            && best.is_none_or(|(nearest, _)| distance < nearest)
        {
            best = Some((distance, points));
        }
    }
    best.filter(|(distance, _)| (0.012..MOST).contains(distance)).map(|(_, points)| points)
}

/// The robot without gravity, and a ball that nothing holds.
fn world_with_ball(radius: f64) -> Result<World> {
    let ball = format!(
        r#"<body name="ball"><freejoint/><geom type="sphere" size="{radius}" mass="0.05" friction="0.8 0.005 0.0001"/></body>"#
    );
    let (before, after) = MODEL
        .rsplit_once("</worldbody>")
        .ok_or_else(|| Error::value("four_finger.xml", "a worldbody", "none"))?;
    let options = PhysicsOptions::try_from(Unchecked { gravity: [0.0; 3], ..Unchecked::default() })?;
    World::from_mjcf(&format!("{before}{ball}</worldbody>{after}"), &options)
}
