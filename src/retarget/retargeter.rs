//! Retargeter: follows one human hand with one robot hand, frame by frame.

use std::time::Instant;

use super::filter::HandFilter;
use super::goal::{Goal, HandObservation};
use super::human::Hand;
use super::input::Input;
use super::live_motion::{LiveMotion, LiveOptions};
use super::motion_limit::{Basin, MotionLimit, Step};
use super::object::{ObjectPose, ObjectTracker};
use super::output::{Output, Status};
use super::robot::Robot;
use super::robot::coupling::JointDrive;
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
    /// Limits of the motion of a live robot; None = velocity limits only, and the first pose is given out at once.
    pub live: Option<LiveOptions>,
}

impl Default for Options {
    fn default() -> Self {
        Self { side: None, stop: Stop { iterations: 20, tolerance: 1e-4 }, live: None }
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
    live: Option<LiveMotion>,
    transfer: TouchTransfer,
    /// Basin of the pose found last.
    basin: Basin,
    /// Free coordinates of the pose given out last, rad or m.
    u: Vec<f64>,
    /// Workspace: pose at which the robot stops if it brakes.
    stop: Vec<f64>,
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

    /// Creates a retargeter with options. A live robot starts at its rest pose, until [`Self::start_from`] gives another.
    ///
    /// # Errors
    /// If an option of live motion is out of range.
    pub fn with_options(robot: Robot, options: Options) -> Result<Self> {
        let transfer = TouchTransfer::new(&robot);
        let joints = robot.output_joints().count();
        let live_joints = if options.live.is_some() { joints } else { 0 };
        let output = Output {
            qpos: vec![0.0; joints],
            qvel: vec![0.0; live_joints],
            qacc: vec![0.0; live_joints],
            stop_qpos: vec![0.0; live_joints],
            ctrl: vec![0.0; robot.commands.names.len()],
            expected_touch: transfer.no_touch(),
            ..Output::default()
        };
        let limit = MotionLimit::new(&robot);
        let mut retargeter = Self {
            live: options.live.map(|live| LiveMotion::new(&robot, &limit, live)).transpose()?,
            options,
            filter: HandFilter::new(&robot.spec.filter),
            object: ObjectTracker::new(robot.spec.filter.time_constant),
            goal: Goal::new(&robot)?,
            search: PoseSearch::new(&robot),
            limit,
            transfer,
            basin: Basin::Present,
            u: robot.rest.clone(),
            stop: robot.rest.clone(),
            frame_time: None,
            output_time: None,
            has_given_out: options.live.is_some(),
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

    /// Starts from the pose of a robot that stands still: `qpos` holds its positions in the order of
    /// [`super::Robot::joint_names`], rad or m. Forgets all past input; the next frame is followed from this pose, with the ramp of
    /// [`LiveOptions`].
    ///
    /// Returns the greatest distance of a joint from the pose that the robot starts at, rad or m: it is above 0 if `qpos` violates
    /// joint limits or couplings.
    ///
    /// # Errors
    /// If the number of positions is wrong, or one is not finite. The pose is then unchanged.
    pub fn start_from(&mut self, qpos: &[f64]) -> Result<f64> {
        if qpos.len() != self.output.qpos.len() {
            return Err(Error::shape("qpos", self.output.qpos.len(), [qpos.len()]));
        }
        if let Some(index) = qpos.iter().position(|position| !position.is_finite()) {
            let name = format!("position of joint {}", self.robot.joint_names()[index]);
            return Err(Error::value(name, "a finite number", qpos[index]));
        }
        self.reset();
        let Robot { world, parts, coupling, .. } = &mut self.robot;
        let joints = parts.joints.iter().filter(|joint| joint.motion != Motion::Other);
        joints.zip(qpos).for_each(|(joint, position)| world.qpos_mut()[joint.qpos] = *position);
        coupling.reduce(parts, world.qpos(), &mut self.u);
        self.search.start_at(&self.u);
        self.has_given_out = true;
        if let Some(live) = &mut self.live {
            live.stand();
            live.begin_ramp();
        }
        self.write_pose();
        Ok(self.output.qpos.iter().zip(qpos).map(|(to, from)| (to - from).abs()).fold(0.0, f64::max))
    }

    /// Lets the velocity limit of a live robot grow from 0 again, for a start after a pause.
    pub fn begin_ramp(&mut self) {
        self.live.iter_mut().for_each(LiveMotion::begin_ramp);
    }

    /// True if a live robot moves at the end of the last step.
    pub fn is_moving(&self) -> bool {
        self.live.as_ref().is_some_and(LiveMotion::is_moving)
    }

    /// Brakes a live robot until `now`, s, and then holds it where it stopped, also if [`Self::advance`] is called later, until
    /// the next frame. Without [`LiveOptions`] this only holds the pose.
    ///
    /// # Errors
    /// If the time is not finite.
    pub fn brake(&mut self, now: f64) -> Result<&Output> {
        if !now.is_finite() {
            return Err(Error::value("time", "finite seconds", now));
        }
        let dt = self.time_since_last_output(now);
        if let Some(live) = &mut self.live {
            live.brake(dt, &mut self.u);
            live.stop(&self.u, &mut self.stop);
            self.search.start_at(&self.stop);
            self.write_pose();
        }
        self.hold(now);
        Ok(&self.output)
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
        // The best pose within reach is solved for when a frame comes. Between frames each joint just moves on, unless a link is
        // in its way.
        if self.live.as_ref().is_some_and(LiveMotion::is_blocked) {
            self.aim_around_links()?;
        }
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
    /// object pose that is not finite. The last good pose is then held (a live robot goes on to it), and [`Self::output`] says
    /// so.
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
        if result.is_err() && self.live.is_some() {
            // A robot in motion can't hold still at once: it goes on to the last good pose.
            self.move_towards_pose(now, Basin::Other)?;
            self.write_pose();
        }
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
        self.basin = found.basin;
        self.aim_around_links()?;
        let is_limited = self.move_towards_pose(now, found.basin)?;
        match self.live {
            // A live robot gets to the pose of this frame later; its touch is that in this pose, whatever the motion does.
            Some(_) => self.robot.set_pose(self.search.pose()),
            None => self.write_pose(),
        }
        if let Some(touch) = &input.touch {
            let pinches = self.goal.pinch_points(&mut self.robot, &filtered.points, touch);
            let transfer = TransferInput { hand: &hand, points: &filtered.points, touch, pinches: &pinches };
            self.transfer.transfer(&self.robot, &transfer, &mut self.output.expected_touch);
        } else {
            self.output.expected_touch.clear();
        }
        if self.live.is_some() {
            self.write_pose();
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

    /// Plans the way of a live robot to the pose found.
    fn aim_around_links(&mut self) -> Result<()> {
        let Some(live) = &mut self.live else { return Ok(()) };
        let step = Step { target: self.search.pose(), basin: self.basin, dt: live.period(), stop: self.options.stop };
        live.aim(&mut self.robot, &mut self.goal, step, &self.u)
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
        let dt = self.time_since_last_output(now);
        if let Some(live) = &mut self.live {
            return Ok(live.advance(&mut self.robot, &self.goal, self.search.pose(), dt, &mut self.u));
        }
        let step = Step { target: self.search.pose(), basin, dt, stop: self.options.stop };
        self.limit.advance(&mut self.robot, &mut self.goal, step, &mut self.u)
    }

    /// Returns the seconds of motion that a step to `now`, s, may take; at most a period for a live robot.
    fn time_since_last_output(&self, now: f64) -> f64 {
        let (first, most) = match &self.live {
            Some(live) => (live.period(), live.period()),
            None => (FIRST_STEP_SECS, MAX_STEP_SECS),
        };
        self.output_time.map_or(first, |last| (now - last).clamp(0.0, most))
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
        self.write_motion();
    }

    /// Writes velocities, accelerations and the stop of a live robot.
    fn write_motion(&mut self) {
        let Some(live) = &self.live else { return };
        self.output.stop_secs = live.stop(&self.u, &mut self.stop);
        for (index, joint) in self.robot.output_joints().enumerate() {
            let [low, high] = self.robot.parts.joints[joint].range;
            let [velocity, acceleration, stop] = match self.robot.coupling.joints[joint] {
                JointDrive::Coupled { coordinate: k, ratio, offset } => {
                    [ratio * live.velocity[k], ratio * live.last_acceleration[k], ratio * self.stop[k] + offset]
                }
                JointDrive::Fixed(position) => [0.0, 0.0, position],
                JointDrive::Free => [0.0, 0.0, self.output.qpos[index]],
            };
            self.output.qvel[index] = velocity;
            self.output.qacc[index] = acceleration;
            self.output.stop_qpos[index] = stop.clamp(low, high);
        }
    }
}
