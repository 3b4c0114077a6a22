//! Motion of a live robot: velocity and acceleration are bounded, and the way to brake is always free.
//!
//! Each step of one command period goes from position and velocity to those at its end. A step is taken only if full braking
//! from its end stays within joint limits and moves no link into another. If no such step is found, the robot brakes: the way
//! to brake was checked with the step before. So every command keeps the limits, whatever the hand does.

use super::goal::Goal;
use super::motion_limit::{Basin, MAX_PENETRATION, MotionLimit, Step, penetration};
use super::robot::Robot;
use crate::error::{Error, Result};

/// Shares of the wanted change of motion that are tried in turn, against full braking.
const SHARES: [f64; 3] = [1.0, 0.5, 0.25];
/// Time at full speed within which the first intermediate target around a link lies, s.
const REACH_SECS: f64 = 0.05;
/// Greatest number of times that this is halved while links stay in the way.
const MAX_HALVINGS: u32 = 4;
/// Greatest number of poses at which one way to brake is checked; at 60 Hz each is that of a command.
const MAX_BRAKE_POSES: u32 = 24;
/// Time at full speed between two poses at which a step is checked, s: 0.05 rad at 10 rad/s.
const CHECK_SECS: f64 = 0.005;
/// Distance (rad or m) and velocity (per second) below which a coordinate counts as arrived.
const ARRIVED: [f64; 2] = [1e-9, 1e-6];
/// Share of the reach at which an intermediate target counts as passed.
const PASSED: f64 = 0.1;

/// Limits of the motion of a live robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LiveOptions {
    /// Greatest acceleration of a hinge, rad/s^2; a slide's is a tenth of it in m/s^2.
    pub acceleration: f64,
    /// Time in which the velocity limit grows from 0 to its full value after a start, s.
    pub ramp_secs: f64,
    /// Time between two commands, s: no command moves farther than the robot can in this time.
    pub period: f64,
}

impl LiveOptions {
    fn check(&self) -> Result<()> {
        for (name, value, low, high) in [
            ("acceleration", self.acceleration, 1e-3, 1e6),
            ("ramp_secs", self.ramp_secs, 0.0, 3600.0),
            ("period", self.period, 1e-6, 10.0),
        ] {
            if !(low..=high).contains(&value) {
                return Err(Error::value(name, format!("{low} to {high}"), value));
            }
        }
        Ok(())
    }
}

/// State of motion of a live robot.
#[derive(Debug)]
pub struct LiveMotion {
    options: LiveOptions,
    /// Velocity limit of each free coordinate, rad/s or m/s.
    speed: Vec<f64>,
    /// Acceleration limit of each free coordinate, rad/s^2 or m/s^2.
    acceleration: Vec<f64>,
    /// Present velocity, rad/s or m/s.
    pub velocity: Vec<f64>,
    /// Mean acceleration of the last step, rad/s^2 or m/s^2.
    pub last_acceleration: Vec<f64>,
    /// Time since the last start, s.
    since_start: f64,
    /// Number of steps that links were in the way of, less the number of free ones since.
    blocked_steps: u32,
    /// True if the solver knows no way around the links.
    has_given_up: bool,
    /// Intermediate target on the way to the pose, if there is one.
    waypoint: Option<Vec<f64>>,
    /// Workspace: position and velocity at the end of a step, and a pose on the way.
    next: Vec<f64>,
    next_velocity: Vec<f64>,
    between: Vec<f64>,
}

impl LiveMotion {
    /// Creates the motion of a robot at rest.
    ///
    /// # Errors
    /// If an option is not finite or out of range.
    pub fn new(robot: &Robot, limit: &MotionLimit, options: LiveOptions) -> Result<Self> {
        options.check()?;
        let n = robot.coupling.len();
        let per_speed = options.acceleration / robot.spec.limits.velocity;
        Ok(Self {
            options,
            speed: limit.speed().to_vec(),
            acceleration: limit.speed().iter().map(|speed| per_speed * speed).collect(),
            velocity: vec![0.0; n],
            last_acceleration: vec![0.0; n],
            since_start: 0.0,
            blocked_steps: 0,
            has_given_up: false,
            waypoint: None,
            next: vec![0.0; n],
            next_velocity: vec![0.0; n],
            between: robot.rest.clone(),
        })
    }

    /// Time between two commands, s.
    pub fn period(&self) -> f64 {
        self.options.period
    }

    /// Sets all velocities to 0, for a robot that stands still.
    pub fn stand(&mut self) {
        self.velocity.fill(0.0);
        self.last_acceleration.fill(0.0);
        self.blocked_steps = 0;
        self.waypoint = None;
    }

    /// Begins the ramp of the velocity limit.
    pub fn begin_ramp(&mut self) {
        self.since_start = 0.0;
    }

    /// True if a coordinate moves.
    pub fn is_moving(&self) -> bool {
        self.velocity.iter().any(|velocity| *velocity != 0.0)
    }

    /// Returns the time that full braking takes from now, s, and writes where it ends to `stop`.
    pub fn stop(&self, u: &[f64], stop: &mut [f64]) -> f64 {
        for (k, stop) in stop.iter_mut().enumerate() {
            *stop = u[k] + brake_distance(self.velocity[k], self.acceleration[k], f64::INFINITY);
        }
        brake_secs(&self.velocity, &self.acceleration)
    }

    /// True if a link is in the way, so that [`Self::aim`] should look for a way around it again.
    pub fn is_blocked(&self) -> bool {
        self.blocked_steps > 0 && !self.has_given_up
    }

    /// Plans the way to a pose: straight, or, if links were in the way of the last steps, through an intermediate target, because
    /// in the present basin the solver knows a way around them. The more steps were blocked, the nearer is the target.
    ///
    /// # Errors
    /// If a target of the goal is not finite.
    pub fn aim(&mut self, robot: &mut Robot, goal: &mut Goal, step: Step, u: &[f64]) -> Result<()> {
        self.waypoint = None;
        self.has_given_up = false;
        if step.basin == Basin::Present && self.blocked_steps > 0 {
            let reach: Vec<f64> = self.speed.iter().map(|speed| self.reach_secs() * speed).collect();
            let (low, high) = (&robot.coupling.low, &robot.coupling.high);
            let toward = |k: usize| u[k] + (step.target[k] - u[k]).clamp(-reach[k], reach[k]);
            let mut waypoint: Vec<f64> = (0..u.len()).map(|k| toward(k).clamp(low[k], high[k])).collect();
            goal.solve_within(robot, step.stop, [u, &reach], &mut waypoint)?;
            let farthest = waypoint.iter().zip(u).zip(&reach).map(|((x, u), reach)| (x - u).abs() / reach);
            self.has_given_up = farthest.fold(0.0, f64::max) < PASSED;
            self.waypoint = Some(waypoint).filter(|_| !self.has_given_up);
        }
        Ok(())
    }

    /// Time at full speed within which an intermediate target lies, s.
    fn reach_secs(&self) -> f64 {
        REACH_SECS * 0.5f64.powi(self.blocked_steps.saturating_sub(1).min(MAX_HALVINGS) as i32)
    }

    /// Moves `u` towards a pose, for `dt` seconds. Returns true if a limit or a link kept it from getting there.
    pub fn advance(&mut self, robot: &mut Robot, goal: &Goal, pose: &[f64], dt: f64, u: &mut [f64]) -> bool {
        if self.waypoint.as_ref().is_some_and(|waypoint| self.has_passed(waypoint, u)) {
            self.waypoint = None;
        }
        if dt > 0.0 {
            self.since_start += dt;
            let waypoint = self.waypoint.take();
            let target = waypoint.as_deref().unwrap_or(pose);
            if self.is_moving() || target != u {
                self.step(robot, goal, target, dt, u);
            } else {
                self.last_acceleration.fill(0.0);
            }
            self.waypoint = waypoint;
        }
        pose != u
    }

    /// Brakes `u` for `dt` seconds, along the way that was checked before.
    pub fn brake(&mut self, dt: f64, u: &mut [f64]) {
        self.waypoint = None;
        self.blocked_steps = 0;
        if dt > 0.0 {
            self.plan(0.0, u, dt, u);
            self.take(dt, u);
        }
    }

    fn step(&mut self, robot: &mut Robot, goal: &Goal, target: &[f64], dt: f64, u: &mut [f64]) {
        // A robot that starts with links in each other may stay so, but no deeper.
        let allowed = penetration(robot, goal, u).max(MAX_PENETRATION);
        let found = SHARES.iter().position(|share| {
            self.plan(*share, target, dt, u);
            self.is_safe(robot, goal, allowed, dt, u)
        });
        if found.is_none() {
            self.plan(0.0, target, dt, u);
        }
        let is_free = found == Some(0);
        self.blocked_steps = if is_free { self.blocked_steps.saturating_sub(1) } else { self.blocked_steps + 1 };
        for (next, (low, high)) in self.next.iter_mut().zip(robot.coupling.low.iter().zip(&robot.coupling.high)) {
            // Sums may exceed a limit by their rounding.
            *next = next.clamp(*low, *high);
        }
        self.take(dt, u);
    }

    /// Takes the planned step.
    fn take(&mut self, dt: f64, u: &mut [f64]) {
        for (k, u) in u.iter_mut().enumerate() {
            self.last_acceleration[k] = (self.next_velocity[k] - self.velocity[k]) / dt;
            self.velocity[k] = self.next_velocity[k];
            *u = self.next[k];
        }
    }

    /// Plans a step: `share` of the way from full braking to the motion that reaches the target soonest.
    fn plan(&mut self, share: f64, target: &[f64], dt: f64, u: &[f64]) {
        let ramp =
            if self.options.ramp_secs > 0.0 { (self.since_start / self.options.ramp_secs).min(1.0) } else { 1.0 };
        for k in 0..u.len() {
            let (v, a) = (self.velocity[k], self.acceleration[k]);
            let braked = v.signum() * (v.abs() - a * dt).max(0.0);
            let braked_at = u[k] + brake_distance(v, a, dt);
            let distance = target[k] - u[k];
            if distance.abs() < ARRIVED[0] && v.abs() < ARRIVED[1] && share == 1.0 {
                (self.next[k], self.next_velocity[k]) = (target[k], 0.0);
                continue;
            }
            let wanted = soonest(distance - 0.5 * v * dt, a, dt).clamp(-ramp * self.speed[k], ramp * self.speed[k]);
            let wanted = wanted.clamp(v - a * dt, v + a * dt);
            let wanted_at = u[k] + 0.5 * (v + wanted) * dt;
            self.next_velocity[k] = braked + share * (wanted - braked);
            self.next[k] = braked_at + share * (wanted_at - braked_at);
        }
    }

    /// True if the planned step, and full braking from its end, stay within joint limits and out of links.
    fn is_safe(&mut self, robot: &mut Robot, goal: &Goal, allowed: f64, dt: f64, u: &[f64]) -> bool {
        let Self { speed, acceleration, next, next_velocity, between, .. } = self;
        let n = u.len();
        let (low, high) = (&robot.coupling.low, &robot.coupling.high);
        let stops_within = (0..n).all(|k| {
            let stop = next[k] + brake_distance(next_velocity[k], acceleration[k], f64::INFINITY);
            (low[k] - ARRIVED[0]..=high[k] + ARRIVED[0]).contains(&stop)
        });
        if !stops_within {
            return false;
        }
        let longest = (0..n).map(|k| (next[k] - u[k]).abs() / (CHECK_SECS * speed[k])).fold(0.0, f64::max);
        let count = longest.ceil().max(1.0) as u32;
        for index in 1..=count {
            let share = f64::from(index) / f64::from(count);
            (0..n).for_each(|k| between[k] = u[k] + share * (next[k] - u[k]));
            if penetration(robot, goal, between) > allowed {
                return false;
            }
        }
        let secs = brake_secs(next_velocity, acceleration);
        // The next commands, if the robot brakes, are at multiples of dt.
        let count = (secs / dt).ceil().min(f64::from(MAX_BRAKE_POSES)) as u32;
        let interval = dt.max(secs / f64::from(MAX_BRAKE_POSES));
        (1..=count).all(|index| {
            let time = interval * f64::from(index);
            (0..n).for_each(|k| between[k] = next[k] + brake_distance(next_velocity[k], acceleration[k], time));
            penetration(robot, goal, between) <= allowed
        })
    }

    /// True if `u` is so near an intermediate target that the robot should no longer slow down for it.
    fn has_passed(&self, waypoint: &[f64], u: &[f64]) -> bool {
        waypoint
            .iter()
            .zip(u)
            .zip(&self.speed)
            .all(|((x, u), speed)| (x - u).abs() <= PASSED * self.reach_secs() * speed)
    }
}

/// Returns the velocity at the end of a step after which braking with acceleration `a` ends at the target. `left`: distance
/// that is left after the step if the velocity at its end is 0, rad or m.
fn soonest(left: f64, a: f64, dt: f64) -> f64 {
    // With v at the end, v dt / 2 of `left` is used up in the step, and v^2 / (2 a) by braking.
    let braking = a * (-0.5 * dt + (0.25 * dt * dt + 2.0 * left.abs() / a).sqrt());
    // Braking takes whole steps, so the last one would end with a rest of velocity: there, stop at the target exactly.
    left.signum() * braking.min(left.abs() / dt)
}

/// Distance covered by full braking from velocity `v` with acceleration `a` within `time`, rad or m.
fn brake_distance(v: f64, a: f64, time: f64) -> f64 {
    let time = time.min(v.abs() / a);
    v.signum() * (v.abs() - 0.5 * a * time) * time
}

/// Time until full braking stops all coordinates, s.
fn brake_secs(velocity: &[f64], acceleration: &[f64]) -> f64 {
    velocity.iter().zip(acceleration).map(|(v, a)| v.abs() / a).fold(0.0, f64::max)
}
