//! Motion of a body from its recorded poses: a spline on SE(3), its accelerations, and their uncertainty.

use glam::{DQuat, DVec3};

use super::pose::{Pose, PoseNoise, aligned};
use super::spline::Smoother;
use crate::statistics::median;

/// Largest number of frames that one spline covers, and number of frames that two neighbours share: time and memory per frame
/// do not grow with the recording.
const SEGMENT: usize = 400;
const OVERLAP: usize = 60;
/// Fewest poses that a spline is made from.
const FEWEST: usize = 6;
/// Bandwidth at most, relative to the frame rate, and at least, 1/s.
const MOST_OF_RATE: f64 = 0.3;
const LEAST_BANDWIDTH: f64 = 1.5;
/// Standard deviation of the accelerations from noise that the chosen bandwidth admits, m/s² and rad/s².
const ADMITTED: [f64; 2] = [0.4, 6.0];
/// Ratio of the bandwidths whose difference stands for motion that the smoothing removes.
const COARSER: f64 = 1.5;
/// Acceleration beyond which a change of position counts as a jump of the tracking, m/s² and rad/s².
const JUMP: [f64; 2] = [150.0, 2500.0];
/// Number of standard deviations beyond which a pose counts as a jump.
const JUMP_SIGMAS: f64 = 8.0;

/// Reason why the motion at a frame is not to be trusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MotionFault {
    /// The pose is unknown.
    Gap,
    /// The pose is off the motion before and after it, or the tracking goes on elsewhere.
    Jump,
}

/// Motion of a body at one instant, in the world frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Kinematics {
    /// Smoothed pose of the body.
    pub pose: Pose,
    /// Velocity, m/s, and acceleration, m/s², of the centre of mass.
    pub velocity: DVec3,
    /// Acceleration of the centre of mass, m/s².
    pub acceleration: DVec3,
    /// Angular velocity, rad/s.
    pub angular_velocity: DVec3,
    /// Angular acceleration, rad/s².
    pub angular_acceleration: DVec3,
    /// Standard deviation of the acceleration per axis, from noise and smoothing, m/s².
    pub acceleration_sd: DVec3,
    /// Standard deviation of the angular acceleration per axis, rad/s².
    pub angular_acceleration_sd: DVec3,
    /// Standard deviation of the smoothed position and rotation per axis, m and rad.
    pub pose_sd: PoseNoise,
}

/// Motion of a body over a recording.
#[derive(Debug, Clone)]
pub struct Motion {
    /// Motion at each frame; `None` = unknown.
    pub frames: Vec<Option<Kinematics>>,
    /// Reason of each frame that is not to be trusted.
    pub faults: Vec<Option<MotionFault>>,
    /// Noise of the poses.
    pub noise: PoseNoise,
    /// Smallest bandwidth of the splines, 1/s: a sinusoid of this frequency is halved. 0 = no spline.
    pub bandwidth: f64,
}

impl Motion {
    /// Smooths `poses` at `times`, s, ascending, of a body whose centre of mass lies at `centre` in its frame, m.
    /// `bandwidth`, 1/s: `None` = the largest at which noise stays small in the accelerations.
    pub fn new(times: &[f64], poses: &[Option<Pose>], centre: DVec3, bandwidth: Option<f64>) -> Self {
        let n = times.len().min(poses.len());
        let noise = PoseNoise::estimate(&poses[..n]);
        let mut motion = Self { frames: vec![None; n], faults: vec![None; n], noise, bandwidth: 0.0 };
        let interval = median(times.windows(2).map(|pair| pair[1] - pair[0]));
        let (weights, starts) = motion.jumps(&times[..n], &poses[..n], interval);
        for part in starts.windows(2) {
            let mut from = part[0];
            loop {
                let to = (from + SEGMENT).min(part[1]);
                let known = poses[from..to].iter().zip(&weights[from..to]);
                let known = known.filter(|(pose, weight)| pose.is_some() && **weight > 0.0).count();
                if known >= FEWEST {
                    let (times, poses, weights) = (&times[from..to], &poses[from..to], &weights[from..to]);
                    let keep_from = if from == part[0] { 0 } else { OVERLAP / 2 };
                    motion.segment(from, keep_from, (times, poses, weights), centre, interval, bandwidth);
                }
                if to == part[1] {
                    break;
                }
                from = to - OVERLAP;
            }
        }
        for (index, fault) in motion.faults.iter_mut().enumerate() {
            if poses[index].is_none() {
                *fault = Some(MotionFault::Gap);
            }
        }
        motion
    }

    /// Marks jumps; returns the weight of each pose, and the starts of the parts between jumps, with the end.
    fn jumps(&mut self, times: &[f64], poses: &[Option<Pose>], interval: f64) -> (Vec<f64>, Vec<usize>) {
        let n = poses.len();
        let mut weights: Vec<f64> = poses.iter().map(|pose| f64::from(u8::from(pose.is_some()))).collect();
        let mut starts = vec![0];
        let square = interval * interval;
        let most = [
            (JUMP_SIGMAS * self.noise.position).max(JUMP[0] * square),
            (JUMP_SIGMAS * self.noise.rotation).max(JUMP[1] * square).min(1.5),
        ];
        let step =
            |a: Pose, b: Pose| [b.position - a.position, (b.orientation * a.orientation.inverse()).to_scaled_axis()];
        let is_more = |v: [DVec3; 2]| v[0].length() > most[0] || v[1].length() > most[1];
        let at = |index: usize| poses.get(index).copied().flatten();
        let mut index = 1;
        while index < n {
            // A long gap ends a part: a spline across it is a guess.
            let gap = times[index] - times[index - 1] > 4.0 * interval;
            let (Some(before), Some(here)) = (at(index - 1), at(index)) else {
                if gap {
                    starts.push(index);
                }
                index += 1;
                continue;
            };
            let moved = step(before, here);
            // A pose that jumped tells nothing of the usual step.
            let earlier = index.checked_sub(2).filter(|earlier| self.faults[*earlier].is_none());
            let usual = match (earlier.and_then(at), at(index + 1)) {
                (Some(earlier), _) => step(earlier, before),
                (None, Some(later)) => step(here, later),
                _ => [DVec3::ZERO; 2],
            };
            let off = is_more([moved[0] - usual[0], moved[1] - usual[1]]);
            let returns = off
                && at(index + 1).is_some_and(|later| {
                    let over = step(before, later);
                    !is_more([over[0] - usual[0] * 2.0, over[1] - usual[1] * 2.0])
                });
            if returns {
                weights[index] = 0.0;
                self.faults[index] = Some(MotionFault::Jump);
                index += 2; // the step back is not a second jump
                continue;
            }
            if off || gap {
                starts.push(index);
                for edge in [index - 1, index] {
                    self.faults[edge] = Some(MotionFault::Jump);
                }
                index += 2;
                continue;
            }
            index += 1;
        }
        starts.push(n);
        (weights, starts)
    }

    /// Fills the frames from `start` + `keep_from` on from one spline.
    fn segment(
        &mut self,
        start: usize,
        keep_from: usize,
        (times, poses, weights): (&[f64], &[Option<Pose>], &[f64]),
        centre: DVec3,
        interval: f64,
        bandwidth: Option<f64>,
    ) {
        let middle = times[times.len() / 2];
        let noise = self.noise;
        let noise_centre = noise.position.hypot(noise.rotation * centre.length());
        let most = MOST_OF_RATE / interval;
        let mut chosen = bandwidth.unwrap_or(most).min(most);
        if bandwidth.is_none() {
            while chosen > LEAST_BANDWIDTH {
                let Some(smoother) = Smoother::new(times, weights, interval, chosen) else { return };
                let gain = smoother.noise_gain(middle)[2];
                if gain * noise_centre <= ADMITTED[0] && gain * noise.rotation <= ADMITTED[1] {
                    break;
                }
                chosen = (chosen * 0.85).max(LEAST_BANDWIDTH);
            }
        }
        let [fine, coarse] = [chosen, chosen / COARSER].map(|bandwidth| {
            let smoother = Smoother::new(times, weights, interval, bandwidth)?;
            Some(Curve::fit(smoother, poses, centre))
        });
        let (Some(fine), Some(coarse)) = (fine, coarse) else { return };
        self.bandwidth = if self.bandwidth > 0.0 { self.bandwidth.min(chosen) } else { chosen };
        for (index, time) in times.iter().copied().enumerate().skip(keep_from) {
            let (state, smoother) = (fine.at(time, centre), coarse.at(time, centre));
            let gain = fine.smoother.noise_gain(time);
            let lost = 0.5 * (state.acceleration - smoother.acceleration).abs();
            let angular_lost = 0.5 * (state.angular_acceleration - smoother.angular_acceleration).abs();
            let together = |sd: f64, lost: DVec3| lost.to_array().map(|lost| lost.hypot(sd)).into();
            self.frames[start + index] = Some(Kinematics {
                acceleration_sd: together(gain[2] * noise_centre, lost),
                angular_acceleration_sd: together(gain[2] * noise.rotation, angular_lost),
                pose_sd: PoseNoise { position: gain[0] * noise.position, rotation: gain[0] * noise.rotation },
                ..state
            });
        }
    }
}

/// Spline on SE(3): one in space for the centre of mass, and one in the quaternions, projected to unit length.
struct Curve {
    smoother: Smoother,
    /// Coefficients of the centre of mass, then of the quaternion (x, y, z, w).
    coefficients: [Vec<f64>; 7],
}

impl Curve {
    fn fit(smoother: Smoother, poses: &[Option<Pose>], centre: DVec3) -> Self {
        let mut values: [Vec<f64>; 7] = std::array::from_fn(|_| vec![0.0; poses.len()]);
        let mut last: Option<DQuat> = None;
        for (index, pose) in poses.iter().enumerate() {
            let Some(pose) = pose else { continue };
            let turn = last.map_or(pose.orientation, |last| aligned(pose.orientation, last));
            last = Some(turn);
            let place = pose.point(centre).to_array().into_iter().chain(turn.to_array());
            place.zip(&mut values).for_each(|(value, row)| row[index] = value);
        }
        let coefficients = values.map(|row| smoother.fit(&row));
        Self { smoother, coefficients }
    }

    fn at(&self, time: f64, centre: DVec3) -> Kinematics {
        let channels = self.coefficients.each_ref().map(|row| self.smoother.at(row, time));
        let vector = |k: usize| DVec3::new(channels[0][k], channels[1][k], channels[2][k]);
        let raw = |k: usize| DQuat::from_xyzw(channels[3][k], channels[4][k], channels[5][k], channels[6][k]);
        let length = raw(0).length().max(1e-9);
        let orientation = raw(0) / length;
        let back = orientation.conjugate();
        // With s = n q: ω = 2 Im(s' q⁻¹) / n and α = 2 Im(s'' q⁻¹ - 2 n' q' q⁻¹) / n.
        let first = (raw(1) * back) / length;
        let second = (raw(2) * back) / length;
        let growth = orientation.dot(raw(1)) / length;
        let angular_velocity = 2.0 * first.xyz();
        let angular_acceleration = 2.0 * second.xyz() - 2.0 * growth * angular_velocity;
        let pose = Pose { position: vector(0) - orientation * centre, orientation };
        Kinematics {
            pose,
            velocity: vector(1),
            acceleration: vector(2),
            angular_velocity,
            angular_acceleration,
            acceleration_sd: DVec3::ZERO,
            angular_acceleration_sd: DVec3::ZERO,
            pose_sd: PoseNoise::default(),
        }
    }
}
