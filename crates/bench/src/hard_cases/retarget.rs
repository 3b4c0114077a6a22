//! Retargeting: invalid hands, jumps, hands out of reach, and forces of any size.

use egotac::error::Result;
use egotac::hand::{HandModel, N_BETAS, N_KEYPOINTS, Side};
use egotac::retarget::{Input, Retargeter, Robot, Status, Touch};
use egotac::sim::rig::{HandRig, HingeMotion};
use glam::{DQuat, DVec3};

use super::{Family, HardCase, Outcome};

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
        "a robot whose targets are three times as far as it can reach",
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
/// Time between frames, s.
const DT: f64 = 1.0 / 30.0;
/// Frames of a run.
const FRAMES: usize = 60;
/// Frame that is changed.
const CHANGED: usize = 40;

type Keypoints = [DVec3; N_KEYPOINTS];

/// Motion of a hand whose fingers bend and stretch.
struct FingerMotion(HandRig);

impl FingerMotion {
    fn new() -> Result<Self> {
        Ok(Self(HandRig::new(HandModel::builtin(Side::Right), [0.0; N_BETAS])?))
    }

    /// Returns the keypoints at a time, s; fingers bend by `bend` on average and swing by `swing` around it, rad.
    fn at(&self, seconds: f64, bend: f64, swing: f64) -> Keypoints {
        let angle = |hinge: &egotac::sim::rig::Hinge| {
            let wave = bend + swing * (2.0 * seconds + 0.3 * hinge.joint as f64).sin();
            // A thumb that bends as far as the fingers would pass through them.
            let share = if (hinge.joint - 1) / 3 == 4 { 0.5 } else { 1.0 };
            let angle = if hinge.motion == HingeMotion::Flex { share * wave } else { 0.0 };
            angle.clamp(hinge.range[0], hinge.range[1])
        };
        let angles: Vec<f64> = self.0.hinges.iter().map(angle).collect();
        let params = self.0.params(DVec3::new(0.1, 0.0, 0.4), DQuat::IDENTITY, &angles);
        egotac::retarget::human::Hand::of_model(&self.0.model, &params)
    }

    fn usual(&self, frame: usize) -> Keypoints {
        self.at(frame as f64 * DT, 0.5, 0.35)
    }
}

fn robot() -> Result<Retargeter> {
    Retargeter::new(Robot::load(ROBOT, None)?)
}

/// Returns the largest difference of two poses, rad; NaN if a value is NaN.
fn apart(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, |most, off| if off >= most { off } else { most.max(off) })
}

/// Follows the hand with one changed frame. Returns the largest deviation of the joints from the clean run, from the third
/// frame after the change, and the report about the frame.
fn off_after(change: impl Fn(&mut Keypoints)) -> Result<(f64, String)> {
    let hand = FingerMotion::new()?;
    let (mut clean, mut changed) = (robot()?, robot()?);
    let (mut off, mut report) = (0.0f64, String::new());
    for frame in 0..FRAMES {
        let mut keypoints = hand.usual(frame);
        clean.push(&Input::new(keypoints, frame as f64 * DT))?;
        if frame == CHANGED {
            change(&mut keypoints);
        }
        match changed.push(&Input::new(keypoints, frame as f64 * DT)) {
            Err(error) => report = error.to_string(),
            Ok(output) if output.status == Status::Repaired => report = output.status.reason().into(),
            Ok(_) => {}
        }
        if !changed.output().qpos.iter().all(|position| position.is_finite()) {
            off = f64::INFINITY;
        }
        if frame >= CHANGED + 3 {
            off = off.max(apart(&clean.output().qpos, &changed.output().qpos));
        }
    }
    Ok((off, report))
}

/// Returns the worst of several runs; its report is empty if that of any run is.
fn worst(runs: impl IntoIterator<Item = Result<(f64, String)>>) -> Result<(f64, String)> {
    let (mut off, mut report, mut silent) = (0.0, String::new(), false);
    for run in runs {
        let (one, what) = run?;
        silent |= what.is_empty();
        if one >= off {
            (off, report) = (one, what);
        }
    }
    Ok((off, if silent { String::new() } else { report }))
}

fn outcome(error_of: &'static str, tolerance: f64, (off, guard): (f64, String), remedied: f64) -> Outcome {
    Outcome { error_of, tolerance, unguarded: Some(off), guard, remedied, remedied_guard: String::new() }
}

/// Error of the cases that change one frame.
const LATER: &str = "deviation of the joints from the clean run three frames later, rad";

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

/// Compares the robot after the gap with one that has seen only the frames after it.
fn gap() -> Result<Outcome> {
    let hand = FingerMotion::new()?;
    let (mut paused, mut fresh) = (robot()?, robot()?);
    for frame in 0..CHANGED {
        paused.push(&Input::new(hand.usual(frame), frame as f64 * DT))?;
    }
    let mut off = 0.0;
    for frame in 0..10 {
        let time = CHANGED as f64 * DT + 1.0 + frame as f64 * DT;
        let elsewhere = hand.at(0.0, 1.0, 0.0);
        fresh.push(&Input::new(elsewhere, time))?;
        paused.push(&Input::new(elsewhere, time))?;
        if frame >= 3 {
            off = f64::max(off, apart(&paused.output().qpos, &fresh.output().qpos));
        }
    }
    Ok(outcome("deviation of the joints from a run without the past, rad", 0.02, (off, String::new()), off))
}

fn straight() -> Result<Outcome> {
    let hand = FingerMotion::new()?;
    let mut follower = robot()?;
    let mut last: Option<Vec<f64>> = None;
    let mut step = 0.0f64;
    for frame in 0..2 * FRAMES {
        // From bent through straight to bent a little backwards.
        let bend = 0.6 - 0.7 * frame as f64 / (2 * FRAMES) as f64;
        let output = follower.push(&Input::new(hand.at(0.0, bend, 0.0), frame as f64 * DT))?;
        if let Some(last) = &last {
            step = step.max(apart(last, &output.qpos));
        }
        last = Some(output.qpos.clone());
    }
    Ok(outcome("largest step of a joint in a frame, rad", 0.1, (step, String::new()), step))
}

/// Returns the largest deviation of the joints, rad, if every frame of the hand is changed.
fn same_joints(change: impl Fn(&Keypoints) -> Keypoints) -> Result<f64> {
    let hand = FingerMotion::new()?;
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
    Ok(outcome("deviation of the joints from those of the unchanged hand, rad", 1e-6, (off, String::new()), off))
}

fn half_size() -> Result<Outcome> {
    let off = same_joints(|keypoints| keypoints.map(|point| 0.5 * point))?;
    Ok(outcome("deviation of the joints from those of the full-size hand, rad", 0.2, (off, String::new()), off))
}

/// Returns the largest violation of a joint limit, rad.
fn beyond_limits(scale: Option<f64>) -> Result<f64> {
    let mut robot = Robot::load(ROBOT, None)?;
    robot.scale = [scale; 5];
    let mut follower = Retargeter::new(robot)?;
    let hand = FingerMotion::new()?;
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

/// Returns the largest torque beyond what a servo can hold, N m, and the report.
fn beyond_servos(size: f64) -> Result<(f64, String)> {
    /// Largest torque of a servo of `four_finger.xml`, N m.
    const SERVO: f64 = 1.2;
    let hand = FingerMotion::new()?;
    let mut follower = robot()?;
    let (mut beyond, mut report) = (0.0f64, String::new());
    for frame in 0..FRAMES {
        let keypoints = hand.usual(frame);
        let seen = egotac::retarget::human::Hand::new(&keypoints, Side::Right)?;
        let force = |finger| -size * (seen.axes * egotac::retarget::human::pad_normal(&seen.points, finger));
        let touch = Touch { tip_contact: [1.0; 5], tip_force: Some(std::array::from_fn(force)), segments: None };
        let feel =
            &follower.push(&Input { touch: Some(touch), ..Input::new(keypoints, frame as f64 * DT) })?.expected_touch;
        for torque in &feel.torque {
            beyond = beyond.max(if torque.is_finite() { torque.abs() - SERVO } else { f64::INFINITY });
        }
        if feel.clipped {
            report = "forces reduced to what the joints can hold (`clipped`)".into();
        }
    }
    Ok((beyond, report))
}

fn huge_forces() -> Result<Outcome> {
    let (none, huge) = (beyond_servos(0.0)?, beyond_servos(1e4)?);
    let off = (none.0.max(huge.0), huge.1);
    let (remedied, remedied_guard) = beyond_servos(1.0)?;
    Ok(Outcome { remedied_guard, ..outcome("torque beyond the servos', N m", 1e-3, off, remedied) })
}
