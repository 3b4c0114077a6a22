//! A robot that follows a recorded hand, and what is seen on the way.

use serde::{Deserialize, Serialize};

use super::trajectory::{RATE, Trajectory};
use crate::bench::sim::clock::Stopwatch;
use crate::error::Result;
use crate::retarget::{Input, Retargeter, Robot, Touch};

/// What was seen while a robot followed.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Followed {
    /// Frames.
    pub frames: usize,
    /// Processor time per frame, median, microseconds.
    pub median_us: f64,
    /// Time per frame that 99 of 100 frames keep, microseconds.
    pub p99_us: f64,
    /// Mean distance of fingertips from where they should be, mm.
    pub tip_error_mm: f64,
    /// Farthest beyond a joint limit or off a coupling, rad.
    pub limit_violation: f64,
    /// Fastest joint over its velocity limit.
    pub speed_share: f64,
    /// Deepest that links were in each other, mm, and the share of frames with more than 0.5 mm.
    pub deepest_mm: f64,
    /// Share of frames with links more than 0.5 mm in each other.
    pub colliding: f64,
    /// Share of touching frames in which thumb and finger are within 1 mm, of those with a pinch.
    pub pinch_closed: f64,
    /// Share of frames after a release in which they are open again.
    pub pinch_opened: f64,
    /// Share of pairs that touch though the human's do not.
    pub false_contacts: f64,
    /// Mean error of the net force, over the sum of the fingertips' forces.
    pub net_force_error: f64,
    /// Mean error of the net torque about the middle of the touch, over the sum of the fingertips' forces times their mean
    /// distance from it.
    pub net_torque_error: f64,
    /// Mean angle between a fingertip's force and the one asked for, degrees.
    pub force_angle_deg: f64,
    /// Whether fingertips meet in points, having no shapes.
    #[serde(default)]
    pub meets_in_points: bool,
    /// Root mean square of the third derivative of the joints, rad/s³.
    pub jerk: f64,
    /// Joint positions, frame by frame.
    #[serde(skip)]
    pub qpos: Vec<Vec<f64>>,
}

/// Follows a trajectory.
///
/// # Errors
/// If the robot's poses can't be taken.
pub fn follow(robot: Robot, trajectory: &Trajectory, with_touch: bool) -> Result<Followed> {
    let mut retargeter = Retargeter::new(robot)?;
    let mut seen = Followed { frames: trajectory.keypoints.len(), ..Followed::default() };
    seen.meets_in_points = retargeter.robot_and_goal_mut().0.fingers.iter().any(|finger| finger.pad_geoms.is_empty());
    let mut times = Vec::with_capacity(seen.frames);
    let (mut tips, mut tip_count) = (0.0, 0.0);
    let (mut closed, mut touching, mut opened, mut released) = (0.0, 0.0, 0.0, 0.0);
    let (mut wrong, mut apart) = (0.0, 0.0);
    let (mut net, mut torque, mut net_count, mut angle, mut angles) = (0.0, 0.0, 0.0, 0.0, 0.0);
    let mut last: Option<Vec<f64>> = None;
    for frame in 0..seen.frames {
        let mut input = Input::new(trajectory.keypoints[frame], frame as f64 / RATE);
        let contact = trajectory.tip_contact[frame];
        if with_touch {
            let force = trajectory.tip_force[frame];
            input.touch = Some(Touch { tip_contact: contact, tip_force: Some(force), segments: None });
        }
        let began = Stopwatch::start();
        retargeter.push(&input)?;
        times.push(1e6 * began.seconds());
        let output = retargeter.output().clone();
        let (robot, goal) = retargeter.robot_and_goal_mut();
        let gaps: Vec<Option<f64>> = (0..robot.fingers.len()).map(|finger| goal.gap_to_thumb(robot, finger)).collect();
        for (index, finger) in robot.fingers.iter().enumerate() {
            tips += 1e3 * goal.tip_error(robot, index);
            tip_count += 1.0;
            let Some(gap) = gaps[index] else { continue };
            let both = contact[0] > 0.5 && contact[finger.human] > 0.5;
            let before = frame > 0 && {
                let contact = trajectory.tip_contact[frame - 1];
                contact[0] > 0.5 && contact[finger.human] > 0.5
            };
            if both {
                touching += 1.0;
                closed += f64::from(u8::from(gap.abs() <= 1e-3));
            } else {
                apart += 1.0;
                wrong += f64::from(u8::from(gap <= 1e-3));
            }
            if before && !both {
                released += 1.0;
                opened += f64::from(u8::from(gap > 1e-3));
            }
        }
        let deepest = 1e3 * goal.deepest(robot).max(0.0);
        seen.deepest_mm = seen.deepest_mm.max(deepest);
        seen.colliding += f64::from(u8::from(deepest > 0.5)) / seen.frames as f64;
        let violation = robot.coupling.violation(&robot.parts, robot.world.qpos());
        seen.limit_violation = seen.limit_violation.max(violation);
        if let Some(last) = &last {
            let most = robot.spec.limits.velocity / RATE;
            let fastest = output.qpos.iter().zip(last).map(|(a, b)| (a - b).abs() / most).fold(0.0, f64::max);
            seen.speed_share = seen.speed_share.max(fastest);
        }
        let pressed: f64 = trajectory.tip_force[frame].iter().map(|force| force.length()).sum();
        if with_touch && pressed > 0.1 {
            let sum: glam::DVec3 = output.expected_touch.links.iter().map(|link| link.force).sum();
            net += (sum - output.expected_touch.net_force).length() / pressed;
            let touched: Vec<_> = output.expected_touch.links.iter().filter(|link| link.contact > 0.0).collect();
            let count = touched.len().max(1) as f64;
            let middle = touched.iter().map(|link| link.position).sum::<glam::DVec3>() / count;
            let spread = touched.iter().map(|link| link.position.distance(middle)).sum::<f64>() / count;
            let moment: glam::DVec3 = touched.iter().map(|link| (link.position - middle).cross(link.force)).sum();
            // Fingertips that meet in a point hold no torque.
            torque += (moment - output.expected_touch.net_torque).length() / (pressed * spread.max(1e-3));
            net_count += 1.0;
            for (human, asked) in trajectory.tip_force[frame].iter().enumerate() {
                let is = robot.fingers.iter().any(|finger| finger.human == human);
                let got = output.expected_touch.tip_force[human];
                if is && asked.length() > 0.1 && got.length() > 0.0 {
                    angle += got.angle_between(*asked).to_degrees();
                    angles += 1.0;
                }
            }
        }
        debug_assert!(robot.fingers.iter().all(|finger| finger.tip_position(&robot.world).is_finite()));
        last = Some(output.qpos.clone());
        seen.qpos.push(output.qpos);
    }
    let ratio = |a: f64, b: f64| if b > 0.0 { a / b } else { f64::NAN };
    (seen.median_us, seen.p99_us) = (percentile(&times, 0.5), percentile(&times, 0.99));
    seen.tip_error_mm = ratio(tips, tip_count);
    seen.pinch_closed = ratio(closed, touching);
    seen.pinch_opened = ratio(opened, released);
    seen.false_contacts = ratio(wrong, apart);
    seen.net_force_error = ratio(net, net_count);
    seen.net_torque_error = ratio(torque, net_count);
    seen.force_angle_deg = ratio(angle, angles);
    seen.jerk = jerk(&seen.qpos);
    Ok(seen)
}

/// The value that a share of all keeps.
pub fn percentile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = (share * (sorted.len() as f64 - 1.0)).round().max(0.0) as usize;
    sorted.get(at).copied().unwrap_or(f64::NAN)
}

/// Root mean square of the third derivative, per joint.
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

/// How much later one run is than another, s: where their difference is least, between whole frames by a parabola.
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
