//! Retargeting: hands that are none, that jump, that robots can't follow, and forces of any size.

use glam::{DQuat, DVec3};

use super::{Family, HardCase, Outcome};
use crate::error::Result;
use crate::hand::{HandModel, N_BETAS, N_KEYPOINTS, Side};
use crate::retarget::{Input, Retargeter, Robot, Status, Touch};
use crate::sim::rig::{HandRig, Motion};

pub(super) const CASES: &[HardCase] = &[
    Family::Retargeting.case(
        "keypoint_not_a_number",
        "NaN, infinity or 1e9 m in each of a hand's 21 keypoints, one frame long",
        "keypoints in metres",
        no_numbers,
    ),
    Family::Retargeting.case(
        "no_hand",
        "a frame of zeros, of points on a line, and of the mirrored hand",
        "a frame of the hand as before",
        no_hand,
    ),
    Family::Retargeting.case(
        "spike",
        "a keypoint that is 100 mm off in one frame",
        "none needed: it is replaced",
        spike,
    ),
    Family::Retargeting.case("gap", "no frame for a second, then the hand is elsewhere", "none needed", gap),
    Family::Retargeting.case(
        "straight_fingers",
        "fingers that go through straight, where the targets' derivatives vanish",
        "none needed",
        straight,
    ),
    Family::Retargeting.case("any_wrist", "the wrist turned upside down and 5 m away", "none needed", any_wrist),
    Family::Retargeting.case("half_size", "a hand of half the size", "none needed: scale is the hand's own", half_size),
    Family::Retargeting.case(
        "out_of_reach",
        "a robot told to reach three times as far as it can",
        "scale: auto",
        out_of_reach,
    ),
    Family::Retargeting.case(
        "force_1e4",
        "forces of 0 and of 1e4 N on all fingertips",
        "forces that the robot can hold",
        huge_forces,
    ),
];

const ROBOT: &str = "four_finger";
const DT: f64 = 1.0 / 30.0;
const FRAMES: usize = 60;
/// The frame in which something happens.
const BAD: usize = 40;

type Keypoints = [DVec3; N_KEYPOINTS];

/// A hand whose fingers bend and stretch.
struct Motions(HandRig);

impl Motions {
    fn new() -> Result<Self> {
        Ok(Self(HandRig::new(HandModel::builtin(Side::Right), [0.0; N_BETAS])?))
    }

    /// Keypoints at a time, s, with fingers bent by `bend` on average and `swing` around it, rad.
    fn at(&self, seconds: f64, bend: f64, swing: f64) -> Keypoints {
        let angle = |hinge: &crate::sim::rig::Hinge| {
            let wave = bend + swing * (2.0 * seconds + 0.3 * hinge.joint as f64).sin();
            // A thumb that bends as much as the fingers would go through them.
            let share = if (hinge.joint - 1) / 3 == 4 { 0.5 } else { 1.0 };
            let angle = if hinge.motion == Motion::Flex { share * wave } else { 0.0 };
            angle.clamp(hinge.range[0], hinge.range[1])
        };
        let angles: Vec<f64> = self.0.hinges.iter().map(angle).collect();
        let params = self.0.params(DVec3::new(0.1, 0.0, 0.4), DQuat::IDENTITY, &angles);
        crate::retarget::human::Hand::of_model(&self.0.model, &params)
    }

    fn usual(&self, frame: usize) -> Keypoints {
        self.at(frame as f64 * DT, 0.5, 0.35)
    }
}

fn robot() -> Result<Retargeter> {
    Retargeter::new(Robot::load(ROBOT, None)?)
}

/// Largest difference of two poses, rad; infinite where one is no number.
fn apart(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, |most, off| if off >= most { off } else { most.max(off) })
}

/// Follows the hand with a frame changed; how far joints are off the clean run from the third frame after it on, and what
/// is said of the frame.
fn off_after(change: impl Fn(&mut Keypoints)) -> Result<(f64, String)> {
    let hand = Motions::new()?;
    let (mut clean, mut changed) = (robot()?, robot()?);
    let (mut off, mut said) = (0.0f64, String::new());
    for frame in 0..FRAMES {
        let mut keypoints = hand.usual(frame);
        clean.push(&Input::new(keypoints, frame as f64 * DT))?;
        if frame == BAD {
            change(&mut keypoints);
        }
        match changed.push(&Input::new(keypoints, frame as f64 * DT)) {
            Err(error) => said = error.to_string(),
            Ok(output) if output.status == Status::Repaired => said = output.status.reason().into(),
            Ok(_) => {}
        }
        if !changed.output().qpos.iter().all(|position| position.is_finite()) {
            off = f64::INFINITY;
        }
        if frame >= BAD + 3 {
            off = off.max(apart(&clean.output().qpos, &changed.output().qpos));
        }
    }
    Ok((off, said))
}

/// The worst of several; silent if one was.
fn worst(runs: impl IntoIterator<Item = Result<(f64, String)>>) -> Result<(f64, String)> {
    let (mut off, mut said, mut silent) = (0.0, String::new(), false);
    for run in runs {
        let (one, what) = run?;
        silent |= what.is_empty();
        if one >= off {
            (off, said) = (one, what);
        }
    }
    Ok((off, if silent { String::new() } else { said }))
}

fn outcome(error_of: &'static str, tolerance: f64, (off, guard): (f64, String), remedied: f64) -> Outcome {
    Outcome { error_of, tolerance, unguarded: Some(off), guard, remedied, remedied_guard: String::new() }
}

const LATER: &str = "joints off the clean run three frames later, rad";

fn no_numbers() -> Result<Outcome> {
    let values = [f64::NAN, f64::INFINITY, 1e9];
    let each = (0..N_KEYPOINTS).flat_map(|point| values.map(|value| (point, value)));
    let off = worst(each.map(|(point, value)| off_after(|keypoints| keypoints[point].y = value)))?;
    Ok(outcome(LATER, 0.02, off, off_after(|_| {})?.0))
}

fn no_hand() -> Result<Outcome> {
    let changes: [fn(&mut Keypoints); 3] = [
        |keypoints| *keypoints = [DVec3::ZERO; N_KEYPOINTS],
        |keypoints| keypoints.iter_mut().enumerate().for_each(|(i, point)| *point = 0.01 * i as f64 * DVec3::X),
        |keypoints| keypoints.iter_mut().for_each(|point| point.x = -point.x),
    ];
    Ok(outcome(LATER, 0.02, worst(changes.map(off_after))?, off_after(|_| {})?.0))
}

fn spike() -> Result<Outcome> {
    let off = off_after(|keypoints| keypoints[8].y += 0.1)?;
    Ok(outcome(LATER, 0.02, (off.0, off.1), off.0))
}

/// After the gap the robot must be where one is that has seen nothing else.
fn gap() -> Result<Outcome> {
    let hand = Motions::new()?;
    let (mut paused, mut fresh) = (robot()?, robot()?);
    for frame in 0..BAD {
        paused.push(&Input::new(hand.usual(frame), frame as f64 * DT))?;
    }
    let mut off = 0.0;
    for frame in 0..10 {
        let time = BAD as f64 * DT + 1.0 + frame as f64 * DT;
        let elsewhere = hand.at(0.0, 1.0, 0.0);
        fresh.push(&Input::new(elsewhere, time))?;
        paused.push(&Input::new(elsewhere, time))?;
        if frame >= 3 {
            off = f64::max(off, apart(&paused.output().qpos, &fresh.output().qpos));
        }
    }
    Ok(outcome("joints off those without the past, rad", 0.02, (off, String::new()), off))
}

fn straight() -> Result<Outcome> {
    let hand = Motions::new()?;
    let mut follower = robot()?;
    let mut last: Option<Vec<f64>> = None;
    let mut step = 0.0f64;
    for frame in 0..2 * FRAMES {
        // From bent to bent a little to the back, by way of straight.
        let bend = 0.6 - 0.7 * frame as f64 / (2 * FRAMES) as f64;
        let output = follower.push(&Input::new(hand.at(0.0, bend, 0.0), frame as f64 * DT))?;
        if let Some(last) = &last {
            step = step.max(apart(last, &output.qpos));
        }
        last = Some(output.qpos.clone());
    }
    Ok(outcome("largest step of a joint in a frame, rad", 0.1, (step, String::new()), step))
}

/// Joints with a hand that is changed in every frame, against those with the hand as it is.
fn same_joints(change: impl Fn(&Keypoints) -> Keypoints) -> Result<f64> {
    let hand = Motions::new()?;
    let (mut clean, mut changed) = (robot()?, robot()?);
    let mut off = 0.0;
    for frame in 0..FRAMES {
        let keypoints = hand.usual(frame);
        clean.push(&Input::new(keypoints, frame as f64 * DT))?;
        changed.push(&Input::new(change(&keypoints), frame as f64 * DT))?;
        off = f64::max(off, apart(&clean.output().qpos, &changed.output().qpos));
    }
    Ok(off)
}

fn any_wrist() -> Result<Outcome> {
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 0.3, -0.2).normalize(), 3.0);
    let off = same_joints(|keypoints| keypoints.map(|point| turn * point + DVec3::new(5.0, -3.0, 1.0)))?;
    Ok(outcome("joints off those of the hand as it is, rad", 1e-6, (off, String::new()), off))
}

fn half_size() -> Result<Outcome> {
    let off = same_joints(|keypoints| keypoints.map(|point| 0.5 * point))?;
    Ok(outcome("joints off those of the whole hand, rad", 0.2, (off, String::new()), off))
}

/// How far joints are beyond their limits.
fn beyond_limits(scale: Option<f64>) -> Result<f64> {
    let mut robot = Robot::load(ROBOT, None)?;
    robot.scale = [scale; 5];
    let mut follower = Retargeter::new(robot)?;
    let hand = Motions::new()?;
    let mut beyond = 0.0f64;
    for frame in 0..FRAMES {
        follower.push(&Input::new(hand.usual(frame), frame as f64 * DT))?;
        let (robot, output) = (follower.robot(), follower.output());
        for (joint, position) in robot.output_joints().zip(&output.qpos) {
            let [low, high] = robot.parts.joints[joint].range;
            let by = if position.is_finite() { (position - high).max(low - position) } else { f64::INFINITY };
            beyond = beyond.max(by);
        }
    }
    Ok(beyond)
}

fn out_of_reach() -> Result<Outcome> {
    let off = (beyond_limits(Some(3.0))?, String::new());
    Ok(outcome("joints beyond their limits, rad", 0.0, off, beyond_limits(None)?))
}

/// How much more than its servos a joint is asked for, N m, and what is said.
fn beyond_servos(size: f64) -> Result<(f64, String)> {
    const SERVO: f64 = 1.2; // N m, in four_finger.xml
    let hand = Motions::new()?;
    let mut follower = robot()?;
    let (mut beyond, mut said) = (0.0f64, String::new());
    for frame in 0..FRAMES {
        let keypoints = hand.usual(frame);
        let seen = crate::retarget::human::Hand::new(&keypoints, Side::Right)?;
        let force = |finger| -size * (seen.axes * crate::retarget::human::pad_normal(&seen.points, finger));
        let touch = Touch { tip_contact: [1.0; 5], tip_force: Some(std::array::from_fn(force)), segments: None };
        let feel =
            &follower.push(&Input { touch: Some(touch), ..Input::new(keypoints, frame as f64 * DT) })?.expected_touch;
        for torque in &feel.torque {
            beyond = beyond.max(if torque.is_finite() { torque.abs() - SERVO } else { f64::INFINITY });
        }
        if feel.clipped {
            said = "what the joints can hold made forces smaller (`clipped`)".into();
        }
    }
    Ok((beyond, said))
}

fn huge_forces() -> Result<Outcome> {
    let (none, huge) = (beyond_servos(0.0)?, beyond_servos(1e4)?);
    let off = (none.0.max(huge.0), huge.1);
    let (remedied, remedied_guard) = beyond_servos(1.0)?;
    Ok(Outcome { remedied_guard, ..outcome("torque beyond the servos', N m", 1e-3, off, remedied) })
}
