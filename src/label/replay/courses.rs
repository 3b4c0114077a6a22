//! Motion of a run of frames: places, velocities and accelerations of everything that a replay drives.

use std::mem::discriminant;
use std::ops::Range;

use glam::{DQuat, DVec3};

use super::angles::HandAngles;
use super::stage::Stage;
use crate::dataset::zarr::{OBJECT_POSE, TIMESTAMPS};
use crate::error::{Error, Result};
use crate::hand::{HandParams, Side};
use crate::physics::motion::Motion;
use crate::physics::spline::Smoother;
use crate::physics::{Pose, Take, Tracked};

/// Bandwidth of the splines, relative to the frame rate.
const BANDWIDTH: f64 = 0.3;

/// Motion over a run of frames: values with two derivatives of each servo of both hands, and of each object, at each frame.
pub(super) struct Courses {
    /// By side, frame and servo; None = the hand is absent or unknown.
    pub servos: [Option<Vec<Vec<[f64; 3]>>>; 2],
    /// By side, true if the recording does not tell whether and where the hand is.
    pub unknown: [bool; 2],
    /// By object and frame; None = the pose or the shape is unknown.
    pub objects: Vec<Option<Vec<ObjectState>>>,
    /// Sum of the rotations that hinges miss of recorded joints, rad, and their number.
    pub missed_rotation: (f64, u32),
}

/// State of an object at a frame, in the stage.
#[derive(Clone, Copy)]
pub(super) struct ObjectState {
    pub pose: Pose,
    /// Velocity, m/s, and acceleration, m/s², of its origin.
    pub linear: [DVec3; 2],
    /// Velocity, rad/s, and acceleration, rad/s².
    pub angular: [DVec3; 2],
}

/// Splits an episode into the longest runs of frames in which the same hands and objects are known, and the same hands absent.
pub(super) fn runs(take: &Take) -> Vec<Range<usize>> {
    let known = |frame: usize| {
        let hands = take.hands.each_ref().map(|hand| hand.get(frame).map(discriminant));
        let objects = take.poses.iter().map(|poses| poses.get(frame).is_some_and(Option::is_some));
        (hands, objects.collect::<Vec<bool>>())
    };
    let mut starts: Vec<usize> = (0..take.times.len()).filter(|i| *i == 0 || known(*i) != known(i - 1)).collect();
    starts.push(take.times.len());
    starts.windows(2).map(|pair| pair[0]..pair[1]).collect()
}

impl Courses {
    /// Differentiates the poses of a run of frames, which know the same hands and objects.
    ///
    /// # Errors
    /// If times are not ascending, or a motion is not smooth enough for a spline.
    pub fn new(stage: &Stage, take: &Take, run: Range<usize>) -> Result<Self> {
        let times = &take.times[run.clone()];
        let span = times.last().copied().unwrap_or(0.0) - times.first().copied().unwrap_or(0.0);
        let interval = span / (times.len().max(2) - 1) as f64;
        let smoother = Smoother::new(times, &vec![1.0; times.len()], interval, BANDWIDTH / interval);
        let Some(smoother) = smoother else {
            return Err(Error::value(TIMESTAMPS, "at least two frames at ascending times", times.len()));
        };
        let unknown = take.hands.each_ref().map(|hand| matches!(hand.get(run.start), Some(Tracked::Unknown)));
        let mut courses = Self { servos: [None, None], unknown, objects: Vec::new(), missed_rotation: (0.0, 0) };
        for side in Side::BOTH {
            let present = |tracked: &Tracked| match tracked {
                Tracked::Present(params) => Some((**params).clone()),
                Tracked::Absent | Tracked::Unknown => None,
            };
            let poses: Option<Vec<HandParams>> = take.hands[side as usize][run.clone()].iter().map(present).collect();
            if let Some((poses, hand)) = poses.zip(stage.hands[side as usize].as_ref()) {
                let rig = &stage.rigs[side as usize];
                let mut angles = HandAngles::new(rig, hand.wrist, hand.orientation);
                let placed = poses.iter().map(|pose| placed(pose, rig.joints[0], &stage.placing));
                let rows: Vec<Vec<f64>> = placed.map(|pose| angles.of(&pose)).collect();
                courses.missed_rotation.0 += angles.missed.0;
                courses.missed_rotation.1 += angles.missed.1;
                courses.servos[side as usize] = Some(derivatives(&smoother, times, &rows));
            }
        }
        for (index, poses) in take.poses.iter().enumerate() {
            let known = stage.objects.get(index).is_some_and(Option::is_some);
            let poses: Option<Vec<Pose>> = poses[run.clone()].iter().map(|pose| pose.filter(|_| known)).collect();
            let Some(poses) = poses else {
                courses.objects.push(None);
                continue;
            };
            let poses: Vec<Option<Pose>> = poses.iter().map(|pose| Some(stage.placing.of(pose))).collect();
            let motion = Motion::new(times, &poses, DVec3::ZERO, Some(BANDWIDTH / interval));
            let states = poses.iter().zip(&motion.frames).map(|(pose, state)| {
                let (pose, state) = pose.zip(*state)?;
                Some(ObjectState {
                    pose,
                    linear: [state.velocity, state.acceleration],
                    angular: [state.angular_velocity, state.angular_acceleration],
                })
            });
            let Some(states) = states.collect::<Option<Vec<ObjectState>>>() else {
                let got = format!("{} poses that jump, or too few of them", poses.len());
                return Err(Error::value(OBJECT_POSE, format!("a smooth motion of object {index}"), got));
            };
            courses.objects.push(Some(states));
        }
        Ok(courses)
    }
}

/// Returns value, velocity and acceleration of each column of `rows` at each time.
fn derivatives(smoother: &Smoother, times: &[f64], rows: &[Vec<f64>]) -> Vec<Vec<[f64; 3]>> {
    let column = |index: usize| rows.iter().map(|row| row[index]).collect::<Vec<f64>>();
    let columns: Vec<Vec<f64>> = (0..rows.first().map_or(0, Vec::len)).map(column).collect();
    let fits: Vec<Vec<f64>> = columns.iter().map(|column| smoother.fit(column)).collect();
    let at_frame = |(at, time): (usize, &f64)| {
        let of = |(fit, column): (&Vec<f64>, &Vec<f64>)| {
            let [_, velocity, acceleration] = smoother.at(fit, *time);
            // The recorded place itself: depth of contacts is what turns into force.
            [column[at], velocity, acceleration]
        };
        fits.iter().zip(&columns).map(of).collect()
    };
    times.iter().enumerate().map(at_frame).collect()
}

/// Moves a hand's pose into the stage. `root`: rest position of the wrist, about which the pose turns, m.
fn placed(pose: &HandParams, root: DVec3, placing: &Pose) -> HandParams {
    let wrist = placing.point(root + pose.transl.as_dvec3());
    let turn = placing.orientation * DQuat::from_scaled_axis(pose.global_orient.as_dvec3());
    HandParams { transl: (wrist - root).as_vec3(), global_orient: turn.to_scaled_axis().as_vec3(), ..pose.clone() }
}
