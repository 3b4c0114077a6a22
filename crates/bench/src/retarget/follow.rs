//! A robot that follows a recorded hand: errors, limits, contacts and times along the way.

use egotac::error::Result;
use egotac::retarget::goal::Goal;
use egotac::retarget::{ExpectedTouch, Input, Retargeter, Robot, Touch};
use egotac::sim::budget::clock::Stopwatch;
use egotac::statistics::{median, percentile};
use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::trajectory::{RATE, Trajectory};

/// Depth from which links count as colliding, mm.
const COLLIDING_MM: f64 = 0.5;
/// Gap up to which thumb and finger count as closed, m.
const CLOSED_M: f64 = 1e-3;
/// Sum of the fingertips' forces, and force of one fingertip, above which errors of forces count, N.
const LEAST_FORCE: f64 = 0.1;

/// Measurements of a robot that followed a trajectory.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Followed {
    /// Frames.
    pub frames: usize,
    /// Processor time per frame, median, microseconds.
    pub median_us: f64,
    /// Processor time per frame, 99th percentile, microseconds.
    pub p99_us: f64,
    /// Mean distance of fingertips from their targets, mm.
    pub tip_error_mm: f64,
    /// Largest violation of a joint limit or a coupling, rad.
    pub limit_violation: f64,
    /// Speed of the fastest joint over its velocity limit.
    pub speed_share: f64,
    /// Largest depth of links in each other, mm.
    pub deepest_mm: f64,
    /// Share of frames with links more than 0.5 mm in each other.
    pub colliding: f64,
    /// Share of the frames with a pinch in which thumb and finger are within 1 mm.
    pub pinch_closed: f64,
    /// Share of the first frames after a release in which thumb and finger are more than 1 mm apart.
    pub pinch_opened: f64,
    /// Share of pairs of thumb and finger that touch although the human's do not.
    pub false_contacts: f64,
    /// Mean error of the net force, over the sum of the fingertips' forces.
    pub net_force_error: f64,
    /// Mean error of the net torque about the middle of the touch, over the sum of the fingertips' forces times their mean
    /// distance from it.
    pub net_torque_error: f64,
    /// Mean angle between a fingertip's force and the one asked for, degrees.
    pub force_angle_deg: f64,
    /// True if a fingertip has no shape, so that it meets others in a point.
    #[serde(default)]
    pub meets_in_points: bool,
    /// Root mean square of the third derivative of the joints, rad/s³.
    pub jerk: f64,
    /// Joint positions, frame by frame.
    #[serde(skip)]
    pub qpos: Vec<Vec<f64>>,
}

/// Lets a robot follow a trajectory and measures each frame.
///
/// # Errors
/// If the robot's poses can't be taken.
pub fn follow(robot: Robot, trajectory: &Trajectory, with_touch: bool) -> Result<Followed> {
    let mut retargeter = Retargeter::new(robot)?;
    let mut seen = Followed { frames: trajectory.keypoints.len(), ..Followed::default() };
    seen.meets_in_points = retargeter.robot_and_goal_mut().0.fingers.iter().any(|finger| finger.pad_geoms.is_empty());
    let mut times = Vec::with_capacity(seen.frames);
    let mut pinches = Pinches::default();
    let mut forces = Forces::default();
    let mut tip_error = Mean::default();
    for frame in 0..seen.frames {
        let mut input = Input::new(trajectory.keypoints[frame], frame as f64 / RATE);
        if with_touch {
            let (tip_contact, tip_force) = (trajectory.tip_contact[frame], trajectory.tip_force[frame]);
            input.touch = Some(Touch { tip_contact, tip_force: Some(tip_force), segments: None });
        }
        let stopwatch = Stopwatch::start();
        retargeter.push(&input)?;
        times.push(1e6 * stopwatch.seconds());
        let output = retargeter.output().clone();
        let (robot, goal) = retargeter.robot_and_goal_mut();
        for finger in 0..robot.fingers.len() {
            tip_error.add(1e3 * goal.tip_error(robot, finger));
        }
        pinches.add(robot, goal, trajectory, frame);
        let deepest = 1e3 * goal.deepest(robot).max(0.0);
        seen.deepest_mm = seen.deepest_mm.max(deepest);
        seen.colliding += f64::from(u8::from(deepest > COLLIDING_MM)) / seen.frames as f64;
        let violation = robot.coupling.violation(&robot.parts, robot.world.qpos());
        seen.limit_violation = seen.limit_violation.max(violation);
        if let Some(last) = seen.qpos.last() {
            let most = robot.spec.limits.velocity / RATE;
            let fastest = output.qpos.iter().zip(last).map(|(a, b)| (a - b).abs() / most).fold(0.0, f64::max);
            seen.speed_share = seen.speed_share.max(fastest);
        }
        if with_touch {
            forces.add(robot, &output.expected_touch, &trajectory.tip_force[frame]);
        }
        debug_assert!(robot.fingers.iter().all(|finger| finger.tip_position(&robot.world).is_finite()));
        seen.qpos.push(output.qpos);
    }
    (seen.median_us, seen.p99_us) = (median(times.iter().copied()), percentile(times, 0.99));
    seen.tip_error_mm = tip_error.value();
    seen.pinch_closed = pinches.closed.value();
    seen.pinch_opened = pinches.opened.value();
    seen.false_contacts = pinches.false_contacts.value();
    seen.net_force_error = forces.net.value();
    seen.net_torque_error = forces.torque.value();
    seen.force_angle_deg = forces.angle.value();
    seen.jerk = jerk(&seen.qpos);
    Ok(seen)
}

/// Mean of values, NaN without any.
#[derive(Debug, Clone, Copy, Default)]
struct Mean {
    sum: f64,
    count: f64,
}

impl Mean {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1.0;
    }

    /// Adds 1 if `holds`, else 0: the mean is the share of cases that hold.
    fn add_case(&mut self, holds: bool) {
        self.add(f64::from(u8::from(holds)));
    }

    fn value(self) -> f64 {
        if self.count > 0.0 { self.sum / self.count } else { f64::NAN }
    }
}

/// Shares of pairs of thumb and finger that are closed, opened or falsely closed.
#[derive(Debug, Clone, Copy, Default)]
struct Pinches {
    /// Share of closed pairs in the frames in which the human's thumb and finger touch.
    closed: Mean,
    /// Share of open pairs in the first frames after a release.
    opened: Mean,
    /// Share of closed pairs in the frames in which the human's thumb and finger do not touch.
    false_contacts: Mean,
}

impl Pinches {
    fn add(&mut self, robot: &mut Robot, goal: &Goal, trajectory: &Trajectory, frame: usize) {
        for index in 0..robot.fingers.len() {
            let Some(gap) = goal.gap_to_thumb(robot, index) else { continue };
            let human = robot.fingers[index].human;
            let touches = |frame: usize| {
                let contact = trajectory.tip_contact[frame];
                contact[0] > 0.5 && contact[human] > 0.5
            };
            if touches(frame) {
                self.closed.add_case(gap.abs() <= CLOSED_M);
            } else {
                self.false_contacts.add_case(gap <= CLOSED_M);
            }
            if frame > 0 && touches(frame - 1) && !touches(frame) {
                self.opened.add_case(gap > CLOSED_M);
            }
        }
    }
}

/// Errors of the expected forces against those asked for.
#[derive(Debug, Clone, Copy, Default)]
struct Forces {
    /// Error of the net force over the sum of the fingertips' forces.
    net: Mean,
    /// Error of the net torque over the sum of the fingertips' forces times their mean distance from the middle.
    torque: Mean,
    /// Angle of each fingertip's force, degrees.
    angle: Mean,
}

impl Forces {
    fn add(&mut self, robot: &Robot, feel: &ExpectedTouch, tip_force: &[DVec3; 5]) {
        let pressed: f64 = tip_force.iter().map(|force| force.length()).sum();
        if pressed <= LEAST_FORCE {
            return;
        }
        let sum: DVec3 = feel.links.iter().map(|link| link.force).sum();
        self.net.add((sum - feel.net_force).length() / pressed);
        let touched: Vec<_> = feel.links.iter().filter(|link| link.contact > 0.0).collect();
        let count = touched.len().max(1) as f64;
        let middle = touched.iter().map(|link| link.position).sum::<DVec3>() / count;
        let spread = touched.iter().map(|link| link.position.distance(middle)).sum::<f64>() / count;
        let moment: DVec3 = touched.iter().map(|link| (link.position - middle).cross(link.force)).sum();
        // Fingertips that meet in a point hold no torque: the millimetre keeps their ratio finite.
        self.torque.add((moment - feel.net_torque).length() / (pressed * spread.max(1e-3)));
        for (human, asked) in tip_force.iter().enumerate() {
            let has_finger = robot.fingers.iter().any(|finger| finger.human == human);
            let expected = feel.tip_force[human];
            if has_finger && asked.length() > LEAST_FORCE && expected.length() > 0.0 {
                self.angle.add(expected.angle_between(*asked).to_degrees());
            }
        }
    }
}

/// Computes the root mean square of the third derivative over frames and joints, rad/s³. The first ten frames, in which
/// the robot comes from its initial pose, do not count.
pub fn jerk(qpos: &[Vec<f64>]) -> f64 {
    let mut sum = 0.0;
    let mut count = 0.0;
    for four in qpos.windows(4).skip(10) {
        for (k, first) in four[0].iter().enumerate() {
            let third = (four[3][k] - 3.0 * four[2][k] + 3.0 * four[1][k] - first) * RATE.powi(3);
            sum += third * third;
            count += 1.0;
        }
    }
    f64::sqrt(sum / f64::max(count, 1.0))
}

/// Computes the delay of the run `late` behind `reference`, s: the shift of least squared difference, interpolated
/// between frames by a parabola.
pub fn lag(reference: &[Vec<f64>], late: &[Vec<f64>]) -> f64 {
    let off = |shift: usize| -> f64 {
        let pairs = reference.iter().zip(late.iter().skip(shift));
        let sum: f64 =
            pairs.clone().skip(10).map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>()).sum();
        sum / pairs.count().max(1) as f64
    };
    let errors: Vec<f64> = (0..8).map(off).collect();
    let best = (0..errors.len()).min_by(|a, b| errors[*a].total_cmp(&errors[*b])).unwrap_or(0);
    let (left, right) = (errors.get(best.wrapping_sub(1)), errors.get(best + 1));
    let shift = match (left, right) {
        (Some(a), Some(c)) if a + c - 2.0 * errors[best] > 0.0 => 0.5 * (a - c) / (a + c - 2.0 * errors[best]),
        _ => 0.0,
    };
    (best as f64 + shift) / RATE
}
