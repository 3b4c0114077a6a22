//! The objectives of dex-retargeting and its kin (vector, position, DexPilot), to compare optima like for like.
//!
//! Each is a mean of smooth-L1 losses of lengths, plus 4e-3 |q - q_last|². In `position` the loss is of each point's
//! distance, where the original takes each coordinate by itself (equal within the Huber length, up to a factor), and the
//! wrist stays where it is.

use glam::DVec3;

use super::problem::{Problem, Vector};
use super::robot::Robot;
use super::robot::lookup::body;
use super::solver::{Solved, Solver, Stop};
use crate::error::Result;

/// Weight of the distance to the last pose.
const NORM_DELTA: f64 = 4e-3;
/// Pairs of fingertips closer than this are closed in DexPilot, m (given human vectors).
const PROJECT: f64 = 0.03;
/// And open again beyond this.
const ESCAPE: f64 = 0.05;
/// Targets of closed pairs with the thumb, and without, m.
const CLOSED: [f64; 2] = [1e-4, 3e-2];

/// Which objective.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Vectors from the wrist to points.
    Vector,
    /// Points.
    Position,
    /// Vectors from the wrist to fingertips and between them; close ones close.
    DexPilot,
}

/// A peer's objective on a robot.
#[derive(Debug)]
pub struct Peer {
    /// What is made small.
    pub problem: Problem,
    kind: Kind,
    fingers: usize,
    scale: f64,
    /// Which pairs are closed.
    closed: Vec<bool>,
    solver: Solver,
    /// The last pose, as free coordinates.
    pub u: Vec<f64>,
}

impl Peer {
    /// `wrist` and `tips` are bodies of the model; of DexPilot the first tip is the thumb's.
    ///
    /// # Errors
    /// If a body is not in the model.
    pub fn new(robot: &Robot, kind: Kind, wrist: &str, tips: &[&str], scale: f64) -> Result<Self> {
        let mut problem = Problem::new(&robot.world, &robot.parts, &robot.coupling);
        let mut points = vec![problem.add_point(body(&robot.parts, wrist)?, DVec3::ZERO)];
        for tip in tips {
            points.push(problem.add_point(body(&robot.parts, tip)?, DVec3::ZERO));
        }
        let huber = if kind == Kind::DexPilot { 0.03 } else { 0.02 };
        let mut add = |from: Option<usize>, to: usize| {
            problem.vectors.push(Vector { from, to, target: DVec3::ZERO, weight: 0.0, huber });
        };
        let mut pairs = 0;
        if kind == Kind::DexPilot {
            for i in 1..points.len() {
                for j in i + 1..points.len() {
                    add(Some(points[j]), points[i]);
                    pairs += 1;
                }
            }
        }
        for tip in &points[1..] {
            add((kind != Kind::Position).then_some(points[0]), *tip);
        }
        let n = robot.coupling.len();
        problem.neutral_weight = vec![2.0 * NORM_DELTA; n];
        let middle = |k: usize| 0.5 * (robot.coupling.low[k] + robot.coupling.high[k]);
        Ok(Self {
            problem,
            kind,
            fingers: tips.len(),
            scale,
            closed: vec![false; pairs],
            solver: Solver::new(n),
            u: (0..n).map(middle).collect(),
        })
    }

    /// Vectors that a frame has.
    pub fn count(&self) -> usize {
        self.problem.vectors.len()
    }

    /// Sets a frame's human vectors, m, in the robot's frame: between tips first for DexPilot, then wrist to tips (for
    /// `position`: the tips' places).
    pub fn aim(&mut self, targets: &[DVec3]) {
        let count = self.count() as f64;
        let huber = self.problem.vectors.first().map_or(1.0, |vector| vector.huber);
        let pairs = self.closed.len();
        let with_thumb = self.fingers.saturating_sub(1).min(pairs);
        for (k, target) in targets.iter().enumerate().take(with_thumb) {
            let length = target.length();
            self.closed[k] = length < PROJECT || (self.closed[k] && length <= ESCAPE);
        }
        let mut k = with_thumb;
        for i in 0..with_thumb {
            for j in i + 1..with_thumb {
                self.closed[k] = self.closed[i] && self.closed[j] && targets[k].length() <= 0.03;
                k += 1;
            }
        }
        for (k, (vector, target)) in self.problem.vectors.iter_mut().zip(targets).enumerate() {
            let is_pair = k < pairs;
            let is_closed = is_pair && self.closed[k];
            let has_thumb = k < with_thumb;
            vector.target = match is_closed {
                true => *target / (target.length() + 1e-6) * CLOSED[usize::from(!has_thumb)],
                false => *target * if self.kind == Kind::Position { 1.0 } else { self.scale },
            };
            let share = match (is_pair, is_closed, has_thumb) {
                (true, true, true) => 200.0,
                (true, true, false) => 400.0,
                (true, false, _) => 1.0,
                // As many as there are vectors between tips, and fingers.
                (false, ..) if self.kind == Kind::DexPilot => (pairs + self.fingers) as f64,
                (false, ..) => 1.0,
            };
            vector.weight = share / (count * huber);
        }
        self.problem.neutral.copy_from_slice(&self.u);
    }

    /// Finds the pose from the last one; it becomes the last one.
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

    /// Cost of the last pose of [`Self::aim`]'s targets, from another start; leaves the last pose as it is.
    ///
    /// # Errors
    /// As [`Self::solve`].
    pub fn solve_from(&mut self, robot: &mut Robot, stop: Stop, u: &mut [f64]) -> Result<Solved> {
        let Robot { world, parts, coupling, .. } = robot;
        self.solver.solve(&mut self.problem, world, parts, coupling, stop, u)
    }
}
