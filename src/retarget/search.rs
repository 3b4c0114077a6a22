//! Search for the pose with the least cost: from the last pose, and from other starts to leave poor local minima.
//!
//! From frame to frame the optimum moves little, so the solver starts at the last pose (warm start). That can get caught: a
//! finger behind another one, or a thumb on the wrong side, stays there although a better pose exists. So other starts are
//! tried as well: all of them when the hand is new, one per frame after the cost has jumped, and one every
//! [`RETRY_INTERVAL_FRAMES`] frames while the cost is poor. One start per frame bounds the time of a frame.

use super::goal::Goal;
use super::motion_limit::{Basin, MotionLimit};
use super::robot::Robot;
use super::solver::Stop;
use crate::error::Result;

/// Ratio of a frame's cost to the last one's that counts as a jump, beside [`POOR_COST`].
const COST_JUMP_RATIO: f64 = 4.0;
/// Cost above which a pose is poor enough to try other starts, m^2: one fingertip that misses by 48 mm costs that.
const POOR_COST: f64 = 1e-3;
/// Frames between two retries from another start while the cost is poor.
const RETRY_INTERVAL_FRAMES: usize = 3;
/// Greatest number of solver steps of a retry in mid-motion: enough to see that a start is better; the next frames, which
/// start there, complete it.
const RETRY_ITERATIONS: usize = 12;
/// Cost of another pose, relative to the present one's, below which the robot moves there in mid-motion. A smaller gain is
/// not worth the detour.
const SWITCH_COST_RATIO: f64 = 0.7;
/// Share of the way from rest to the middle of the joint ranges at which the half-closed start lies.
const HALF_CLOSED_SHARE: f64 = 0.4;

/// Start of the solver other than the last pose.
#[derive(Debug, Clone, Copy)]
enum Start {
    /// Pose that would be best if links could penetrate each other.
    WithoutGaps,
    /// Rest pose.
    Rest,
    /// Half closed pose.
    HalfClosed,
}

impl Start {
    const ALL: [Start; 3] = [Self::WithoutGaps, Self::Rest, Self::HalfClosed];
}

/// Present state of the robot, from which a pose is searched.
#[derive(Debug, Clone, Copy)]
pub struct Present<'a> {
    /// Free coordinates of the last pose.
    pub u: &'a [f64],
    /// True if that pose has been given out, so that the path from it matters.
    pub is_given_out: bool,
    /// True if the hand may be anywhere, so that the last pose tells nothing.
    pub is_new_hand: bool,
}

/// Result of a search; the pose is [`PoseSearch::pose`].
#[derive(Debug, Clone, Copy)]
pub struct Found {
    /// Solver steps of all starts.
    pub iterations: usize,
    /// True if the solver converged within the allowed steps.
    pub converged: bool,
    /// Basin in which the pose lies.
    pub basin: Basin,
}

/// Searches the pose of each frame.
#[derive(Debug)]
pub struct PoseSearch {
    /// Best pose found.
    pose: Vec<f64>,
    /// Its cost, m^2.
    cost: f64,
    /// Workspace: pose found from another start.
    other: Vec<f64>,
    /// Starts still to be tried since the cost jumped, one per frame.
    pending_starts: usize,
    /// Frames with a poor cost, modulo one round of retries.
    poor_frames: usize,
}

impl PoseSearch {
    /// Creates a search that begins at a robot's rest pose.
    pub fn new(robot: &Robot) -> Self {
        Self {
            pose: robot.rest.clone(),
            cost: f64::INFINITY,
            other: robot.rest.clone(),
            pending_starts: 0,
            poor_frames: 0,
        }
    }

    /// Replaces the best pose found by `u`.
    pub fn start_at(&mut self, u: &[f64]) {
        self.pose.copy_from_slice(u);
    }

    /// Free coordinates of the best pose found, rad or m.
    pub fn pose(&self) -> &[f64] {
        &self.pose
    }

    /// Cost of that pose, m^2.
    pub fn cost(&self) -> f64 {
        self.cost
    }

    /// Finds the best pose for the goal's targets.
    ///
    /// # Errors
    /// If a target is not finite.
    pub fn run(
        &mut self,
        robot: &mut Robot,
        goal: &mut Goal,
        limit: &mut MotionLimit,
        stop: Stop,
        present: Present,
    ) -> Result<Found> {
        self.pose.copy_from_slice(present.u);
        let solved = goal.solve(robot, stop, f64::INFINITY, &mut self.pose)?;
        let mut found = Found { iterations: solved.iterations, converged: solved.converged, basin: Basin::Present };
        let mut best = solved.cost;
        if best > COST_JUMP_RATIO * self.cost + POOR_COST {
            self.pending_starts = Start::ALL.len();
        }
        let is_lost = present.is_new_hand || self.pending_starts > 0;
        let starts = self.next_starts(present.is_new_hand, best);
        let max_iterations = if present.is_new_hand { usize::MAX } else { RETRY_ITERATIONS };
        let stop = Stop { iterations: stop.iterations.min(max_iterations), ..stop };
        for start in &Start::ALL[starts] {
            self.set_start(*start, robot, goal, stop)?;
            let max_cost = if is_lost { 1.0 } else { SWITCH_COST_RATIO } * best;
            let solved = goal.solve(robot, stop, max_cost, &mut self.other)?;
            found.iterations += solved.iterations;
            // A new hand is elsewhere anyway, and before the first pose there is none to move from.
            let needs_path = present.is_given_out && !present.is_new_hand;
            if solved.cost < max_cost && (!needs_path || limit.path_is_free(robot, goal, present.u, &self.other)) {
                best = solved.cost;
                found.converged = solved.converged;
                found.basin = Basin::Other;
                self.pose.copy_from_slice(&self.other);
            }
        }
        self.cost = best;
        Ok(found)
    }

    /// Returns the starts to try in this frame, as a range of [`Start::ALL`].
    fn next_starts(&mut self, is_new_hand: bool, cost: f64) -> std::ops::Range<usize> {
        let all = Start::ALL.len();
        if is_new_hand {
            self.pending_starts = 0;
            return 0..all;
        }
        if self.pending_starts > 0 {
            let start = all - self.pending_starts;
            self.pending_starts -= 1;
            return start..start + 1;
        }
        if cost > POOR_COST {
            self.poor_frames = (self.poor_frames + 1) % (RETRY_INTERVAL_FRAMES * all);
            if self.poor_frames.is_multiple_of(RETRY_INTERVAL_FRAMES) {
                let start = self.poor_frames / RETRY_INTERVAL_FRAMES;
                return start..start + 1;
            }
        }
        0..0
    }

    /// Sets `other` to a start.
    fn set_start(&mut self, start: Start, robot: &mut Robot, goal: &mut Goal, stop: Stop) -> Result<()> {
        match start {
            Start::WithoutGaps => {
                self.other.copy_from_slice(&self.pose);
                goal.solve_without_gaps(robot, stop, &mut self.other)?;
            }
            Start::Rest => self.other.copy_from_slice(&robot.rest),
            Start::HalfClosed => {
                for (k, other) in self.other.iter_mut().enumerate() {
                    let middle = 0.5 * (robot.coupling.low[k] + robot.coupling.high[k]);
                    *other = robot.rest[k] + HALF_CLOSED_SHARE * (middle - robot.rest[k]);
                }
            }
        }
        Ok(())
    }
}
