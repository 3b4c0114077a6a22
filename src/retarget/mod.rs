//! From a human hand to a robot hand: the pose as joint commands, the touch as forces that each link is to feel.
//!
//! ```no_run
//! use egotac::retarget::{Input, Retargeter, Robot};
//!
//! # fn main() -> egotac::Result<()> {
//! # let keypoints = [glam::DVec3::ZERO; 21];
//! let robot = Robot::load("four_finger", None)?;
//! let mut retargeter = Retargeter::new(robot)?;
//! let output = retargeter.push(&Input::new(keypoints, 0.0))?; // metres, seconds
//! println!("{:?}", output.qpos);
//! # Ok(())
//! # }
//! ```
//!
//! A frame passes [`human`] (checks, wrist frame), [`filter`] (outliers, smoothing in seconds), [`goal`] (what the robot
//! shall do), [`solver`] (joint positions), the velocity limit, and [`touch`] (forces). Smoothing comes before solving, so
//! that limits, couplings, touch and distances hold in what comes out.

pub mod file;
pub mod filter;
pub mod goal;
pub mod human;
mod motion_limit;
pub mod object;
pub mod problem;
pub mod robot;
pub mod solver;
pub mod touch;

use std::time::Instant;

use glam::DVec3;

pub use self::object::Pose as ObjectPose;
pub use self::robot::Robot;
pub use self::touch::{Feel, Pool, Touch};

use self::filter::{Gate, Passed, SizeEstimate, Smoother};
use self::goal::{Goal, Seen};
use self::human::Hand;
use self::motion_limit::speeds;
use self::object::Follower;
use self::solver::{Solver, Stop};
use self::touch::Transfer;
use crate::error::{Error, Result};
use crate::hand::{N_KEYPOINTS, Side};
use crate::mujoco::parts::Motion;

/// Silence after which a hand may be anywhere, s.
const GAP: f64 = 0.5;
/// Smoothing of the bones' directions over that of the fingertips: bones are short, keypoints jitter.
const CALM: f64 = 1.5;
/// A cost that rises by this factor and amount (m²) within a frame is looked at from other starts.
const JUMP: f64 = 4.0;
const WORTH: f64 = 1e-3;
/// A cost above that amount is looked at from one other start in so many frames: the pose may be caught behind a link.
const PATROL: usize = 3;
/// Steps of the solver from another start in mid-motion.
const LOOK: usize = 12;
/// Another pose is moved to in mid-motion where it costs less than this share.
const BETTER: f64 = 0.7;

/// One frame.
#[derive(Debug, Clone)]
pub struct Input {
    /// Wrist, then thumb, index, middle, ring, little, each from base to tip, m.
    pub keypoints: [DVec3; N_KEYPOINTS],
    /// Seconds.
    pub time: f64,
    /// What the hand touches; without it, fingers that are close count as touching.
    pub touch: Option<Touch>,
    /// Where the object is that the robot was loaded with; None = nowhere near.
    pub object: Option<ObjectPose>,
}

impl Input {
    /// A frame without touch.
    pub fn new(keypoints: [DVec3; N_KEYPOINTS], time: f64) -> Self {
        Self { keypoints, time, touch: None, object: None }
    }
}

/// How a frame went.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Status {
    /// Solved.
    #[default]
    Solved = 0,
    /// Solved, with keypoints replaced that could not be where they seemed.
    Repaired = 1,
    /// A joint could not move as fast as it should, or links would have run into each other.
    Limited = 2,
    /// The solver stopped at its cap of iterations.
    Capped = 3,
    /// The frame was bad; the last good pose is held.
    Held = 4,
}

impl Status {
    /// All, by their codes.
    pub const ALL: [Status; 5] = [Self::Solved, Self::Repaired, Self::Limited, Self::Capped, Self::Held];

    /// What it means, in words.
    pub fn reason(self) -> &'static str {
        match self {
            Self::Solved => "solved",
            Self::Repaired => "outlying keypoints replaced",
            Self::Limited => "joints too slow, or links in the way",
            Self::Capped => "iteration cap reached",
            Self::Held => "bad input, last good pose held",
        }
    }
}

/// What comes out.
#[derive(Debug, Clone, Default)]
pub struct Output {
    /// Position of every hinge and slide, rad or m, as [`Robot::joint_names`].
    pub qpos: Vec<f64>,
    /// What the drivers get, as [`robot::commands::Commands::names`].
    pub ctrl: Vec<f64>,
    /// Cost of the pose, m².
    pub objective: f64,
    /// Time from input to output, s.
    pub solve_secs: f64,
    /// Steps of the solver.
    pub iterations: usize,
    /// How it went.
    pub status: Status,
    /// What the robot is to feel.
    pub feel: Feel,
}

/// What can be chosen beside the robot's own file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Which human hand comes in; None = the robot's own side.
    pub side: Option<Side>,
    /// When the solver stops.
    pub stop: Stop,
}

impl Default for Options {
    fn default() -> Self {
        Self { side: None, stop: Stop { iterations: 20, tolerance: 1e-4 } }
    }
}

/// Where the solver begins when the last pose may lead into a corner.
#[derive(Debug, Clone, Copy)]
enum Start {
    /// Where the robot would be if links could pass through each other.
    Open,
    /// At rest.
    Rest,
    /// Half closed.
    HalfClosed,
}

impl Start {
    const ALL: [Start; 3] = [Self::Open, Self::Rest, Self::HalfClosed];
}

/// Where the pose lies that was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Way {
    /// Downhill from the present one.
    Near,
    /// Elsewhere: what is best within reach does not lead there.
    Far,
}

/// Follows a human hand with a robot's.
#[derive(Debug)]
pub struct Retargeter {
    robot: Robot,
    options: Options,
    goal: Goal,
    solver: Solver,
    transfer: Transfer,
    gate: Gate,
    smoother: Smoother,
    /// For the directions of bones.
    calm: Smoother,
    object: Follower,
    size: SizeEstimate,
    /// Free coordinates of the pose that was given out last.
    u: Vec<f64>,
    next: Vec<f64>,
    other: Vec<f64>,
    between: Vec<f64>,
    /// Most change of each free coordinate until now.
    reach: Vec<f64>,
    /// Most change of each free coordinate per second.
    speed: Vec<f64>,
    time: Option<f64>,
    /// When a pose was given out last, held or not, s.
    given_at: Option<f64>,
    /// Whether anything came out yet.
    gave_out: bool,
    cost: f64,
    /// Starts that are still to be tried since the cost jumped.
    lost: usize,
    /// Counts the frames in which the cost is worth a look from another start.
    patrol: usize,
    output: Output,
}

impl Retargeter {
    /// Follows with a robot, at first in its rest pose.
    ///
    /// # Errors
    /// If the robot's rest pose can't be taken.
    pub fn new(robot: Robot) -> Result<Self> {
        Self::with_options(robot, Options::default())
    }

    /// Likewise, with options.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_options(mut robot: Robot, options: Options) -> Result<Self> {
        let n = robot.coupling.len();
        let goal = Goal::new(&robot)?;
        let transfer = Transfer::new(&robot);
        let filter = robot.spec.filter.clone();
        let u = robot.rest.clone();
        let speed = speeds(&robot);
        let mut output = Output {
            qpos: vec![0.0; robot.output_joints().count()],
            ctrl: vec![0.0; robot.commands.names.len()],
            feel: transfer.nothing(),
            ..Output::default()
        };
        give_out(&mut robot, &u, &mut output)?;
        Ok(Self {
            options,
            goal,
            transfer,
            solver: Solver::new(n),
            gate: Gate::new(filter.outlier),
            smoother: Smoother::new(filter.time_constant),
            calm: Smoother::new(CALM * filter.time_constant),
            object: Follower::new(filter.time_constant),
            size: SizeEstimate::default(),
            next: u.clone(),
            other: u.clone(),
            between: u.clone(),
            reach: vec![0.0; n],
            u,
            speed,
            time: None,
            given_at: None,
            gave_out: false,
            cost: f64::INFINITY,
            lost: 0,
            patrol: 0,
            output,
            robot,
        })
    }

    /// The robot.
    pub fn robot(&self) -> &Robot {
        &self.robot
    }

    /// The robot in its present pose, and what it was to do.
    pub fn look(&mut self) -> (&mut Robot, &mut Goal) {
        (&mut self.robot, &mut self.goal)
    }

    /// What came out last.
    pub fn output(&self) -> &Output {
        &self.output
    }

    /// Forgets the past, not the pose: the next frame may be anywhere, at any time, of another hand.
    pub fn reset(&mut self) {
        (self.time, self.given_at) = (None, None);
        self.size = SizeEstimate::default();
        self.gate = Gate::new(self.robot.spec.filter.outlier);
        self.smoother.reset();
        self.calm.reset();
        self.object.reset();
    }

    /// Moves on towards the pose of the last good frame, as far as joints may by `now`, s; once there, holds it.
    ///
    /// For drivers that want commands more often than frames come, or while none come.
    ///
    /// # Errors
    /// If the time is not finite, or the pose can't be taken.
    pub fn advance(&mut self, now: f64) -> Result<&Output> {
        if !now.is_finite() {
            return Err(Error::value("time", "finite seconds", now));
        }
        // What is best within reach is found where a frame comes, not between two.
        let limited = self.limit(now, Way::Far)?;
        give_out(&mut self.robot, &self.u, &mut self.output)?;
        self.give(now);
        if limited {
            self.output.status = Status::Limited;
        }
        Ok(&self.output)
    }

    /// Holds the pose for a frame at `time` whose input could not even be read.
    pub fn hold(&mut self, time: f64) {
        self.give(time);
        self.output.status = Status::Held;
        (self.output.iterations, self.output.solve_secs) = (0, 0.0);
    }

    fn give(&mut self, time: f64) {
        self.gave_out = true;
        if time.is_finite() && self.given_at.is_none_or(|given| time > given) {
            self.given_at = Some(time);
        }
    }

    /// Takes a frame and returns joint positions, commands and forces.
    ///
    /// # Errors
    /// If the frame is not a hand (the error names the keypoint), is older than the last one, or has a touch or an object's
    /// pose that is not finite; the last good pose is held, and [`Self::output`] says so.
    pub fn push(&mut self, input: &Input) -> Result<&Output> {
        self.push_at(input, input.time)
    }

    /// Likewise, with joints that move at `now`, s, by a clock of their own, which [`Self::advance`] goes by, too: frames
    /// come late and at uneven times, commands do not.
    ///
    /// # Errors
    /// As [`Self::push`].
    pub fn push_at(&mut self, input: &Input, now: f64) -> Result<&Output> {
        let began = Instant::now();
        let result = self.take(input, now);
        self.give(now);
        if result.is_err() {
            self.output.status = Status::Held;
            self.output.iterations = 0;
        }
        self.output.solve_secs = began.elapsed().as_secs_f64();
        result.map(|()| &self.output)
    }

    fn take(&mut self, input: &Input, now: f64) -> Result<()> {
        let side = self.options.side.unwrap_or(self.robot.side());
        if !input.time.is_finite() || !now.is_finite() {
            return Err(Error::value("timestamp", "finite seconds", if now.is_finite() { input.time } else { now }));
        }
        let dt = match self.time {
            Some(last) if input.time <= last => {
                return Err(Error::value("timestamp", format!("later than the last one, {last} s"), input.time));
            }
            Some(last) => input.time - last,
            None => f64::INFINITY,
        };
        let hand = Hand::new(&input.keypoints, side)?;
        if let Some(touch) = &input.touch {
            touch.check()?;
        }
        let object = self.object.check(&self.robot, side, input.object)?;
        let is_new = dt > GAP;
        if is_new {
            self.gate.forget();
            self.smoother.reset();
            self.calm.reset();
            self.object.reset();
        }
        let (points, replaced) = match self.gate.push(&hand.points, dt.min(GAP)) {
            Passed::Points(points, replaced) => (points, replaced),
            Passed::Mirrored => {
                return Err(Error::value("keypoints", "the hand as before", "its mirror image"));
            }
        };
        if replaced == 0 {
            self.size.push(&points);
        }
        let smooth = self.smoother.push(&points, dt);
        let calm = self.calm.push(&points, dt);
        let bases = self.goal.bases(&self.robot, &smooth);
        self.object.push(&mut self.robot, &hand, object, dt, bases);
        let seen = Seen { hand: &hand, points: &smooth, calm: &calm, size: &self.size, touch: input.touch.as_ref() };
        self.goal.aim(&mut self.robot, &seen, &self.u);
        let (iterations, converged, way) = self.solve(is_new)?;
        let limited = self.limit(now, way)?;
        give_out(&mut self.robot, &self.u, &mut self.output)?;
        if let Some(touch) = &input.touch {
            let meetings = self.goal.meetings(&mut self.robot, &smooth, touch);
            self.transfer.carry(&self.robot, &hand, &smooth, touch, &meetings, &mut self.output.feel);
        } else {
            self.output.feel.clear();
        }
        self.time = Some(input.time);
        self.output.objective = self.cost;
        self.output.iterations = iterations;
        self.output.status = match (converged, limited, replaced) {
            (false, ..) => Status::Capped,
            (_, true, _) => Status::Limited,
            (.., 1..) => Status::Repaired,
            _ => Status::Solved,
        };
        Ok(())
    }

    /// Finds the pose into `next`; returns the steps, whether they sufficed, and where the pose lies.
    fn solve(&mut self, is_new: bool) -> Result<(usize, bool, Way)> {
        self.next.copy_from_slice(&self.u);
        let solved =
            self.goal.solve(&mut self.solver, &mut self.robot, self.options.stop, f64::INFINITY, &mut self.next)?;
        let (mut best, mut iterations, mut converged) = (solved.cost, solved.iterations, solved.converged);
        if best > JUMP * self.cost + WORTH {
            self.lost = Start::ALL.len();
        }
        let mut starts = 0..0;
        let is_lost = is_new || self.lost > 0;
        if is_new {
            (starts, self.lost) = (0..Start::ALL.len(), 0);
        } else if is_lost {
            // One start a frame bounds a frame's time.
            starts = Start::ALL.len() - self.lost..Start::ALL.len() - self.lost + 1;
            self.lost -= 1;
        } else if best > WORTH {
            self.patrol = (self.patrol + 1) % (PATROL * Start::ALL.len());
            if self.patrol.is_multiple_of(PATROL) {
                let start = self.patrol / PATROL;
                starts = start..start + 1;
            }
        }
        let share = if is_lost { 1.0 } else { BETTER };
        let mut way = Way::Near;
        // In mid-motion a look is enough: what promises to be better is found in the next frames.
        let most = if is_new { usize::MAX } else { LOOK };
        let stop = Stop { iterations: self.options.stop.iterations.min(most), ..self.options.stop };
        for start in &Start::ALL[starts] {
            self.begin(*start, stop)?;
            let worth = share * best;
            let solved = self.goal.solve(&mut self.solver, &mut self.robot, stop, worth, &mut self.other)?;
            iterations += solved.iterations;
            // After a silence there is no way to keep: the hand is elsewhere.
            if solved.cost < worth && (is_new || self.way_is_free()) {
                best = solved.cost;
                converged = solved.converged;
                way = Way::Far;
                self.next.copy_from_slice(&self.other);
            }
        }
        self.cost = best;
        Ok((iterations, converged, way))
    }

    /// Puts another start into `other`.
    fn begin(&mut self, start: Start, stop: Stop) -> Result<()> {
        let coupling = &self.robot.coupling;
        match start {
            Start::Open => {
                self.other.copy_from_slice(&self.next);
                self.goal.solve_open(&mut self.solver, &mut self.robot, stop, &mut self.other)?;
            }
            Start::Rest => self.other.copy_from_slice(&self.robot.rest),
            Start::HalfClosed => {
                for (k, other) in self.other.iter_mut().enumerate() {
                    let middle = 0.5 * (coupling.low[k] + coupling.high[k]);
                    *other = self.robot.rest[k] + 0.4 * (middle - self.robot.rest[k]);
                }
            }
        }
        Ok(())
    }
}

/// Brings the robot to a pose and writes it out.
fn give_out(robot: &mut Robot, u: &[f64], output: &mut Output) -> Result<()> {
    let Robot { world, parts, coupling, commands, .. } = robot;
    coupling.expand(parts, u, world.qpos_mut());
    world.update_poses();
    let joints = parts.joints.iter().filter(|joint| joint.motion != Motion::Other);
    for (position, joint) in output.qpos.iter_mut().zip(joints) {
        // What the couplings' arithmetic rounds is not beyond a limit.
        *position = world.qpos()[joint.qpos].clamp(joint.range[0], joint.range[1]);
    }
    commands.write(world, &mut output.ctrl);
    Ok(())
}
