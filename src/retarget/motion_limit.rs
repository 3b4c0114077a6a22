//! Motion limit: joints move no faster than they may, and no link moves into another.

use super::goal::Goal;
use super::robot::Robot;
use super::robot::coupling::JointDrive;
use super::solver::Stop;
use crate::error::Result;
use crate::mujoco::parts::Motion;

/// Speed limit of a slide in m/s, relative to that of a hinge in rad/s.
const SLIDE_SPEED_RATIO: f64 = 0.1;
/// Poses, its end excluded, at which a path is checked for penetration.
const PATH_STEPS: u32 = 12;
/// Greatest penetration of links in a pose that is given out, m: below it, engine and geoms are not exact.
pub const MAX_PENETRATION: f64 = 5e-4;
/// Least share of a step that is taken if all of it would end in penetration; below it, the robot stays.
const MIN_STEP_SHARE: f64 = 0.1;

/// Basin of attraction of the cost in which a found pose lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Basin {
    /// That of the present pose: descent from there leads to the found pose.
    Present,
    /// Another one: descent from the present pose leads elsewhere.
    Other,
}

/// Step from the present pose towards a found one.
#[derive(Debug, Clone, Copy)]
pub struct Step<'a> {
    /// Free coordinates of the found pose.
    pub target: &'a [f64],
    /// Basin in which it lies.
    pub basin: Basin,
    /// Time for the step, s.
    pub dt: f64,
    /// Stopping rule of the solver.
    pub stop: Stop,
}

/// Limits the motion of a robot.
#[derive(Debug)]
pub struct MotionLimit {
    /// Speed limit of each free coordinate, rad/s or m/s.
    speed: Vec<f64>,
    /// Workspace: greatest change of each free coordinate in the step, rad or m.
    reach: Vec<f64>,
    /// Workspace: a pose on the way.
    between: Vec<f64>,
}

impl MotionLimit {
    /// Derives the speed limits of a robot's free coordinates from those of all joints that they drive.
    pub fn new(robot: &Robot) -> Self {
        let n = robot.coupling.len();
        let mut speed = vec![f64::INFINITY; n];
        for (joint, drive) in robot.parts.joints.iter().zip(&robot.coupling.joints) {
            let JointDrive::Coupled { coordinate, ratio, .. } = *drive else { continue };
            let share = if joint.motion == Motion::Slide { SLIDE_SPEED_RATIO } else { 1.0 };
            speed[coordinate] = speed[coordinate].min(share * robot.spec.limits.velocity / ratio.abs());
        }
        Self { speed, reach: vec![0.0; n], between: robot.rest.clone() }
    }

    /// Speed limit of each free coordinate, rad/s or m/s.
    pub fn speed(&self) -> &[f64] {
        &self.speed
    }

    /// True if no link penetrates another on the straight path between two poses.
    pub fn path_is_free(&mut self, robot: &mut Robot, goal: &Goal, from: &[f64], to: &[f64]) -> bool {
        (1..PATH_STEPS).all(|step| {
            let share = f64::from(step) / f64::from(PATH_STEPS);
            for (k, position) in self.between.iter_mut().enumerate() {
                *position = from[k] + share * (to[k] - from[k]);
            }
            penetration(robot, goal, &self.between) <= MAX_PENETRATION
        })
    }

    /// Moves the present pose `u` towards a found one, as far as speed limits and links allow. Returns true if a limit
    /// shortened the step.
    ///
    /// # Errors
    /// If a target of the goal is not finite.
    pub fn advance(&mut self, robot: &mut Robot, goal: &mut Goal, step: Step, u: &mut [f64]) -> Result<bool> {
        let mut is_limited = false;
        for (k, u) in u.iter().enumerate() {
            let reach = self.speed[k] * step.dt;
            let change = step.target[k] - u;
            is_limited |= change.abs() > reach;
            let (low, high) = (robot.coupling.low[k], robot.coupling.high[k]);
            self.reach[k] = reach;
            self.between[k] = (u + change.clamp(-reach, reach)).clamp(low, high);
        }
        if is_limited && step.basin == Basin::Present {
            // Clamping each joint by itself does not give the best pose within reach: solve for that. In another basin the
            // solver would only lead back.
            goal.solve_within(robot, step.stop, [&*u, &self.reach], &mut self.between)?;
        }
        let depth = penetration(robot, goal, &self.between);
        if depth > MAX_PENETRATION {
            is_limited = true;
            if !self.shorten(robot, goal, depth, u) {
                return Ok(true);
            }
        }
        u.copy_from_slice(&self.between);
        Ok(is_limited)
    }

    /// Halves the step from `u` until it ends without penetration, or, if links penetrate in `u` already, with less. Returns
    /// false if too little of it is left.
    fn shorten(&mut self, robot: &mut Robot, goal: &Goal, mut depth: f64, u: &[f64]) -> bool {
        let allowed = penetration(robot, goal, u).max(MAX_PENETRATION);
        let mut share = 1.0;
        while depth > allowed {
            share *= 0.5;
            if share < MIN_STEP_SHARE {
                return false;
            }
            for (position, u) in self.between.iter_mut().zip(u) {
                *position = 0.5 * (*position + u);
            }
            depth = penetration(robot, goal, &self.between);
        }
        true
    }
}

/// Greatest penetration of links in a pose, m; negative = none. Leaves the robot in the pose.
pub fn penetration(robot: &mut Robot, goal: &Goal, u: &[f64]) -> f64 {
    robot.set_pose(u);
    goal.deepest(robot)
}
