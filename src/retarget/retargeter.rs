//! Retargeter: follows one human hand with one robot hand, frame by frame.

use std::time::Instant;

use super::filter::HandFilter;
use super::goal::{Goal, HandObservation};
use super::human::Hand;
use super::input::Input;
use super::motion_limit::{Basin, MotionLimit, Step};
use super::object::{ObjectPose, ObjectTracker};
use super::output::{Output, Status};
use super::robot::Robot;
use super::search::{PoseSearch, Present};
use super::solver::Stop;
use super::touch::{TouchTransfer, TransferInput};
use crate::error::{Error, Result};
use crate::hand::Side;
use crate::mujoco::parts::Motion;

/// Greatest time between two outputs that speed limits allow motion for, s: after a longer silence the robot must not jump.
const MAX_STEP_SECS: f64 = 0.5;
/// Time that speed limits assume before the first good frame, s: one frame at 60 Hz.
const FIRST_STEP_SECS: f64 = 1.0 / 60.0;

/// Options of a retargeter beside the robot's own file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Side of the human hand; None = the robot's.
    pub side: Option<Side>,
    /// Stopping rule of the solver.
    pub stop: Stop,
}

impl Default for Options {
    fn default() -> Self {
        Self { side: None, stop: Stop { iterations: 20, tolerance: 1e-4 } }
    }
}

/// Follows a human hand with a robot hand.
///
/// ```
/// use egotac::hand::{HandModel, HandParams, Side};
/// use egotac::retarget::human::Hand;
/// use egotac::retarget::{Input, Retargeter, Robot, Status, Touch};
///
/// # fn main() -> egotac::Result<()> {
/// let mut retargeter = Retargeter::new(Robot::load("four_finger", None)?)?;
/// let keypoints = Hand::of_model(&HandModel::builtin(Side::Right), &HandParams::default()); // (21), m
/// let mut input = Input::new(keypoints, 0.0); // s
/// input.touch = Some(Touch { tip_contact: [0.0; 5], ..Touch::default() });
/// let output = retargeter.push(&input)?;
/// assert_eq!(output.status, Status::Solved);
/// assert_eq!(output.qpos.len(), 16); // rad
/// assert!(output.expected_touch.links.iter().all(|link| link.normal_force == 0.0)); // N
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Retargeter {
    robot: Robot,
    options: Options,
    filter: HandFilter,
    object: ObjectTracker,
    goal: Goal,
    search: PoseSearch,
    limit: MotionLimit,
    transfer: TouchTransfer,
    /// Free coordinates of the pose given out last, rad or m.
    u: Vec<f64>,
    /// Time of the last good frame, s.
    frame_time: Option<f64>,
    /// Time of the last output, s; also if the pose was held.
    output_time: Option<f64>,
    /// True if a pose has been given out: before, the robot may jump to the first one.
    has_given_out: bool,
    output: Output,
}

impl Retargeter {
    /// Creates a retargeter that starts in the robot's rest pose.
    ///
    /// # Errors
    /// Never with the built-in hand.
    pub fn new(robot: Robot) -> Result<Self> {
        Self::with_options(robot, Options::default())
    }

    /// Creates a retargeter with options.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_options(robot: Robot, options: Options) -> Result<Self> {
        let transfer = TouchTransfer::new(&robot);
        let output = Output {
            qpos: vec![0.0; robot.output_joints().count()],
            ctrl: vec![0.0; robot.commands.names.len()],
            expected_touch: transfer.no_touch(),
            ..Output::default()
        };
        let mut retargeter = Self {
            options,
            filter: HandFilter::new(&robot.spec.filter),
            object: ObjectTracker::new(robot.spec.filter.time_constant),
            goal: Goal::new(&robot)?,
            search: PoseSearch::new(&robot),
            limit: MotionLimit::new(&robot),
            transfer,
            u: robot.rest.clone(),
            frame_time: None,
            output_time: None,
            has_given_out: false,
            output,
            robot,
        };
        retargeter.write_pose();
        Ok(retargeter)
    }

    /// The robot.
    pub fn robot(&self) -> &Robot {
        &self.robot
    }

    /// Returns the robot in its present pose, and the goal of the last frame, to measure the one against the other.
    pub fn robot_and_goal_mut(&mut self) -> (&mut Robot, &mut Goal) {
        (&mut self.robot, &mut self.goal)
    }

    /// The last output.
    pub fn output(&self) -> &Output {
        &self.output
    }

    /// Forgets all past input, but keeps the pose: the next frame may have any time and show any hand.
    pub fn reset(&mut self) {
        (self.frame_time, self.output_time) = (None, None);
        self.filter = HandFilter::new(&self.robot.spec.filter);
        self.object.reset();
    }

    /// Moves on towards the pose of the last good frame, as far as joints can by `now`, s; once there, holds it.
    ///
    /// For drivers that need commands more often than frames come, or while none come.
    ///
    /// # Errors
    /// If the time is not finite.
    pub fn advance(&mut self, now: f64) -> Result<&Output> {
        if !now.is_finite() {
            return Err(Error::value("time", "finite seconds", now));
        }
        // The best pose within reach is solved for when a frame comes. Between frames each joint just moves on.
        let is_limited = self.move_towards_pose(now, Basin::Other)?;
        self.write_pose();
        self.mark_output(now);
        if is_limited {
            self.output.status = Status::Limited;
        }
        Ok(&self.output)
    }

    /// Holds the pose for a frame at `time`, s, whose input could not be read.
    pub fn hold(&mut self, time: f64) {
        self.mark_output(time);
        self.output.status = Status::Held;
        (self.output.iterations, self.output.solve_secs) = (0, 0.0);
    }

    /// Follows a frame: returns joint positions, commands and expected touch.
    ///
    /// # Errors
    /// If the frame is not a hand (the error names the keypoint), is not later than the last one, or has a touch or an
    /// object pose that is not finite. The last good pose is then held, and [`Self::output`] says so.
    pub fn push(&mut self, input: &Input) -> Result<&Output> {
        self.push_at(input, input.time)
    }

    /// Follows a frame, with joints that move by a clock of their own, to `now`, s; [`Self::advance`] uses the same clock.
    /// Frames may come late and at uneven times while commands do not.
    ///
    /// # Errors
    /// As [`Self::push`].
    pub fn push_at(&mut self, input: &Input, now: f64) -> Result<&Output> {
        let began = Instant::now();
        let result = self.follow(input, now);
        self.mark_output(now);
        if result.is_err() {
            self.output.status = Status::Held;
            self.output.iterations = 0;
        }
        self.output.solve_secs = began.elapsed().as_secs_f64();
        result.map(|()| &self.output)
    }

    fn follow(&mut self, input: &Input, now: f64) -> Result<()> {
        let dt = self.time_since_last_frame(input.time, now)?;
        let (hand, object) = self.check(input)?;
        let is_new_hand = HandFilter::is_new_hand(dt);
        if is_new_hand {
            self.filter.forget_pose();
            self.object.reset();
        }
        let filtered = self.filter.push(&hand.points, dt)?;
        let bases = self.goal.bases(&self.robot, &filtered.points);
        self.object.push(&mut self.robot, &hand, object, dt, bases);
        let observation = HandObservation {
            hand: &hand,
            points: &filtered.points,
            direction_points: &filtered.direction_points,
            size: self.filter.size(),
            touch: input.touch.as_ref(),
        };
        self.goal.aim(&mut self.robot, &observation, &self.u);
        let present = Present { u: &self.u, is_given_out: self.has_given_out, is_new_hand };
        let stop = self.options.stop;
        let found = self.search.run(&mut self.robot, &mut self.goal, &mut self.limit, stop, present)?;
        let is_limited = self.move_towards_pose(now, found.basin)?;
        self.write_pose();
        if let Some(touch) = &input.touch {
            let pinches = self.goal.pinch_points(&mut self.robot, &filtered.points, touch);
            let transfer = TransferInput { hand: &hand, points: &filtered.points, touch, pinches: &pinches };
            self.transfer.transfer(&self.robot, &transfer, &mut self.output.expected_touch);
        } else {
            self.output.expected_touch.clear();
        }
        self.frame_time = Some(input.time);
        self.output.objective = self.search.cost();
        self.output.iterations = found.iterations;
        self.output.status = match (found.converged, is_limited, filtered.replaced) {
            (false, ..) => Status::Capped,
            (_, true, _) => Status::Limited,
            (.., 1..) => Status::Repaired,
            _ => Status::Solved,
        };
        Ok(())
    }

    /// Returns the seconds since the last good frame, infinite for the first one.
    fn time_since_last_frame(&self, time: f64, now: f64) -> Result<f64> {
        if !time.is_finite() || !now.is_finite() {
            return Err(Error::value("timestamp", "finite seconds", if now.is_finite() { time } else { now }));
        }
        match self.frame_time {
            Some(last) if time <= last => {
                Err(Error::value("timestamp", format!("later than the last one, {last} s"), time))
            }
            Some(last) => Ok(time - last),
            None => Ok(f64::INFINITY),
        }
    }

    /// Validates a frame.
    fn check(&self, input: &Input) -> Result<(Hand, Option<ObjectPose>)> {
        let side = self.options.side.unwrap_or(self.robot.side());
        let hand = Hand::new(&input.keypoints, side)?;
        if let Some(touch) = &input.touch {
            touch.check()?;
        }
        Ok((hand, self.object.check(&self.robot, side, input.object)?))
    }

    /// Moves `u` to the pose found, or as near as limits allow by `now`, s; returns true if a limit shortened the step.
    fn move_towards_pose(&mut self, now: f64, basin: Basin) -> Result<bool> {
        if !self.has_given_out {
            self.u.copy_from_slice(self.search.pose());
            return Ok(false);
        }
        let dt = self.output_time.map_or(FIRST_STEP_SECS, |last| (now - last).clamp(0.0, MAX_STEP_SECS));
        let step = Step { target: self.search.pose(), basin, dt, stop: self.options.stop };
        self.limit.advance(&mut self.robot, &mut self.goal, step, &mut self.u)
    }

    /// Notes that a pose is given out at `time`, s.
    fn mark_output(&mut self, time: f64) {
        self.has_given_out = true;
        if time.is_finite() && self.output_time.is_none_or(|last| time > last) {
            self.output_time = Some(time);
        }
    }

    /// Brings the robot to the pose `u`, and writes joint positions and commands.
    fn write_pose(&mut self) {
        self.robot.set_pose(&self.u);
        let Robot { world, parts, commands, .. } = &mut self.robot;
        let joints = parts.joints.iter().filter(|joint| joint.motion != Motion::Other);
        for (position, joint) in self.output.qpos.iter_mut().zip(joints) {
            // The arithmetic of couplings may exceed a limit by its rounding.
            *position = world.qpos()[joint.qpos].clamp(joint.range[0], joint.range[1]);
        }
        commands.write(world, &mut self.output.ctrl);
    }
}
