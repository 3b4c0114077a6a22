//! Objective of dex-retargeting's `vector` optimizer, solved by our solver, so that optima are compared like for like.
//!
//! The objective is the mean of the smooth-L1 losses of the vectors from the wrist to the fingertips, plus
//! 4e-3 |q - q_last|².

use egotac::error::Result;
use egotac::retarget::Robot;
use egotac::retarget::problem::{Problem, Vector};
use egotac::retarget::robot::lookup::body;
use egotac::retarget::solver::{Solved, Solver, Stop};
use glam::DVec3;

/// Weight of the squared distance to the last pose, 1/rad².
const NORM_DELTA: f64 = 4e-3;
/// Length at which the smooth-L1 loss goes over from quadratic to linear, m.
const HUBER: f64 = 0.02;

/// The `vector` objective of dex-retargeting on a robot.
#[derive(Debug)]
pub struct VectorObjective {
    problem: Problem,
    /// Robot metres per human metre.
    scale: f64,
    solver: Solver,
    /// The last pose, as free coordinates, rad.
    pub u: Vec<f64>,
}

impl VectorObjective {
    /// Creates the objective for the bodies `wrist` and `tips` of the robot's model; the last pose is the middle of the
    /// joints' ranges.
    ///
    /// # Errors
    /// If a body is not in the model.
    pub fn new(robot: &Robot, wrist: &str, tips: &[&str], scale: f64) -> Result<Self> {
        let mut problem = Problem::new(&robot.world, &robot.parts, &robot.coupling);
        let wrist = problem.add_point(body(&robot.parts, wrist)?, DVec3::ZERO);
        for tip in tips {
            let to = problem.add_point(body(&robot.parts, tip)?, DVec3::ZERO);
            problem.vectors.push(Vector { from: Some(wrist), to, target: DVec3::ZERO, weight: 0.0, huber: HUBER });
        }
        let n = robot.coupling.len();
        problem.neutral_weight = vec![2.0 * NORM_DELTA; n];
        let middle = |k: usize| 0.5 * (robot.coupling.low[k] + robot.coupling.high[k]);
        Ok(Self { problem, scale, solver: Solver::new(n), u: (0..n).map(middle).collect() })
    }

    /// Sets the human vectors of a frame, from the wrist to each fingertip, in the robot's frame, m.
    pub fn set_targets(&mut self, targets: &[DVec3]) {
        let count = self.problem.vectors.len() as f64;
        for (vector, target) in self.problem.vectors.iter_mut().zip(targets) {
            vector.target = *target * self.scale;
            vector.weight = 1.0 / (count * HUBER);
        }
        self.problem.neutral.copy_from_slice(&self.u);
    }

    /// Finds the best pose from the last one, and makes it the last one.
    ///
    /// # Errors
    /// If a target is not finite.
    pub fn solve(&mut self, robot: &mut Robot, stop: Stop) -> Result<Solved> {
        let Robot { world, parts, coupling, .. } = robot;
        let mut u = std::mem::take(&mut self.u);
        let solved = self.solver.solve(&mut self.problem, world, parts, coupling, stop, &mut u);
        self.u = u;
        solved
    }

    /// Finds the best pose for the same targets and last pose from the start `u`; leaves the last pose as it is.
    ///
    /// # Errors
    /// As [`Self::solve`].
    pub fn solve_from(&mut self, robot: &mut Robot, stop: Stop, u: &mut [f64]) -> Result<Solved> {
        let Robot { world, parts, coupling, .. } = robot;
        self.solver.solve(&mut self.problem, world, parts, coupling, stop, u)
    }
}
