//! Damped Newton steps within a box, the box kept exactly by an active set.

use nalgebra::{Cholesky, DMatrix, DVector};

use super::problem::Problem;
use super::robot::coupling::Coupling;
use crate::error::Result;
use crate::mujoco::World;
use crate::mujoco::parts::Parts;

/// Longest change of a coordinate in a step, rad or m.
const LONGEST: f64 = 0.35;

/// When to stop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stop {
    /// Steps at most.
    pub iterations: usize,
    /// Share of the cost that a step must promise to be worth taking another.
    pub tolerance: f64,
}

impl Default for Stop {
    fn default() -> Self {
        Self { iterations: 30, tolerance: 1e-5 }
    }
}

/// How a solve ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solved {
    /// Cost at the end.
    pub cost: f64,
    /// Steps taken.
    pub iterations: usize,
    /// Whether the tolerance was reached before the cap.
    pub converged: bool,
}

/// The solver's memory; made once, nothing is allocated while it works.
#[derive(Debug)]
pub struct Solver {
    gradient: DVector<f64>,
    hessian: DMatrix<f64>,
    /// Of the coordinates that are free to move; rows of the others are those of the identity.
    reduced: DMatrix<f64>,
    step: DVector<f64>,
    right: DVector<f64>,
    trial: Vec<f64>,
    /// Coordinates held at a bound, with the step that brings them there.
    held: Vec<Option<f64>>,
    /// What each coordinate may be at least and at most, within the joints' own bounds.
    low: Vec<f64>,
    high: Vec<f64>,
}

/// What the quadratic model cannot be solved for.
struct NotConvex;

impl Solver {
    /// For `n` coordinates.
    pub fn new(n: usize) -> Self {
        Self {
            gradient: DVector::zeros(n),
            hessian: DMatrix::zeros(n, n),
            reduced: DMatrix::zeros(n, n),
            step: DVector::zeros(n),
            right: DVector::zeros(n),
            trial: vec![0.0; n],
            held: vec![None; n],
            low: vec![f64::NEG_INFINITY; n],
            high: vec![f64::INFINITY; n],
        }
    }

    /// Keeps the coordinates within `reach` of `centre`, beside the joints' own bounds, until [`Self::widen`].
    pub fn narrow(&mut self, centre: &[f64], reach: &[f64]) {
        for (k, (centre, reach)) in centre.iter().zip(reach).enumerate() {
            (self.low[k], self.high[k]) = (centre - reach, centre + reach);
        }
    }

    /// Lets the joints' own bounds alone count again.
    pub fn widen(&mut self) {
        self.low.fill(f64::NEG_INFINITY);
        self.high.fill(f64::INFINITY);
    }

    /// Least and greatest value of a coordinate.
    fn bounds(&self, coupling: &Coupling, k: usize) -> (f64, f64) {
        let low = coupling.low[k].max(self.low[k]);
        (low, coupling.high[k].min(self.high[k]).max(low))
    }

    /// Improves `u` until nothing is left to gain; the robot is left in the pose found.
    ///
    /// # Errors
    /// If the problem holds a value that is not finite.
    pub fn solve(
        &mut self,
        problem: &mut Problem,
        world: &mut World,
        parts: &Parts,
        coupling: &Coupling,
        stop: Stop,
        u: &mut [f64],
    ) -> Result<Solved> {
        for (k, u) in u.iter_mut().enumerate() {
            let (low, high) = self.bounds(coupling, k);
            *u = u.clamp(low, high);
        }
        let mut cost = problem.cost(world, parts, coupling, u)?;
        let mut damping = 0.0;
        let mut solved = Solved { cost, iterations: 0, converged: u.is_empty() };
        let (mut is_fresh, mut went_astray) = (false, false);
        while solved.iterations < stop.iterations && !solved.converged {
            solved.iterations += 1;
            if !is_fresh {
                problem.derivatives(world, u, &mut self.gradient, &mut self.hessian);
                is_fresh = true;
            }
            let scale = self.scale();
            let Ok(gain) = self.plan(u, coupling, damping * scale) else {
                damping = raised(damping);
                continue;
            };
            // Far from here the model tells nothing; a long step may end in another valley.
            if self.step.amax() > LONGEST && damping < 1e6 {
                damping = raised(damping);
                solved.iterations -= 1;
                continue;
            }
            if gain <= stop.tolerance * cost + f64::MIN_POSITIVE {
                solved.converged = true;
                // Too little to look twice at, but not nothing.
                if gain <= 1e-3 * stop.tolerance * cost {
                    break;
                }
            }
            for (trial, (u, step)) in self.trial.iter_mut().zip(u.iter().zip(self.step.iter())) {
                *trial = u + step;
            }
            // What is held at a bound is at it, whatever the rounding of u + (bound - u).
            for k in 0..u.len() {
                let (low, high) = self.bounds(coupling, k);
                self.trial[k] = self.trial[k].clamp(low, high);
            }
            let next = problem.cost(world, parts, coupling, &self.trial)?;
            if next < cost {
                // A step that brings what it promised needs less damping.
                damping = if cost - next > 0.5 * gain { lowered(damping) } else { damping };
                if cost - next < 0.1 * gain {
                    damping = raised(damping);
                }
                u.copy_from_slice(&self.trial);
                cost = next;
                (is_fresh, went_astray) = (false, false);
            } else {
                went_astray = true;
                if solved.converged || damping > 1e8 {
                    solved.converged = true;
                    break;
                }
                damping = raised(damping);
            }
        }
        if went_astray {
            // The last pose tried was no better: go back to the best one.
            problem.cost(world, parts, coupling, u)?;
        }
        solved.cost = cost;
        Ok(solved)
    }

    /// Mean curvature, which damping is measured in.
    fn scale(&self) -> f64 {
        let n = self.gradient.len().max(1);
        (0..self.gradient.len()).map(|k| self.hessian[(k, k)].abs()).sum::<f64>() / n as f64
    }

    /// Finds the step that makes the quadratic model least within the box; returns the gain it promises.
    #[allow(clippy::needless_range_loop)] // Positions, bounds, slopes and steps run beside each other.
    fn plan(&mut self, u: &[f64], coupling: &Coupling, damping: f64) -> std::result::Result<f64, NotConvex> {
        let n = u.len();
        for k in 0..n {
            let (low, high) = self.bounds(coupling, k);
            let is_low = u[k] <= low && self.gradient[k] > 0.0;
            let is_high = u[k] >= high && self.gradient[k] < 0.0;
            self.held[k] = (is_low || is_high || low >= high).then_some(0.0);
        }
        for _ in 0..=2 * n {
            self.solve_free(damping)?;
            let mut went_out = false;
            for k in 0..n {
                let (low, high) = self.steps(coupling, u, k);
                if self.held[k].is_none() && !(low..=high).contains(&self.step[k]) {
                    self.held[k] = Some(self.step[k].clamp(low, high));
                    went_out = true;
                }
            }
            if went_out {
                continue;
            }
            // All within: let go of the coordinate that wants most to leave its bound inwards.
            let mut worst = (0.0, None);
            for k in 0..n {
                let Some(at) = self.held[k] else { continue };
                let slope = self.slope(k, damping);
                let (low, high) = self.steps(coupling, u, k);
                let inwards = if at <= low && low < high { -slope } else { 0.0 };
                let inwards = if at >= high && low < high { slope } else { inwards };
                if inwards > worst.0 + 1e-12 * slope.abs() && inwards > 1e-14 {
                    worst = (inwards, Some(k));
                }
            }
            match worst.1 {
                Some(k) => self.held[k] = None,
                None => break,
            }
        }
        let linear = self.gradient.dot(&self.step);
        let gain =
            -linear - 0.5 * (0..n).map(|k| self.step[k] * (self.slope(k, damping) - self.gradient[k])).sum::<f64>();
        if gain.is_finite() && gain >= 0.0 { Ok(gain) } else { Err(NotConvex) }
    }

    /// Least and greatest step of a coordinate.
    fn steps(&self, coupling: &Coupling, u: &[f64], k: usize) -> (f64, f64) {
        let (low, high) = self.bounds(coupling, k);
        (low - u[k], high - u[k])
    }

    /// Slope of the model at the step, along a coordinate.
    fn slope(&self, k: usize, damping: f64) -> f64 {
        let mut slope = self.gradient[k] + damping * self.step[k];
        for j in 0..self.step.len() {
            slope += self.hessian[(k.max(j), k.min(j))] * self.step[j];
        }
        slope
    }

    /// The step of the free coordinates, those held staying where they are held.
    fn solve_free(&mut self, damping: f64) -> std::result::Result<(), NotConvex> {
        let n = self.step.len();
        for col in 0..n {
            let is_held = self.held[col].is_some();
            for row in col..n {
                let both_free = !is_held && self.held[row].is_none();
                self.reduced[(row, col)] = if both_free { self.hessian[(row, col)] } else { 0.0 };
            }
            self.reduced[(col, col)] = if is_held { 1.0 } else { self.hessian[(col, col)] + damping };
        }
        for row in 0..n {
            self.right[row] = match self.held[row] {
                Some(at) => at,
                None => {
                    let mut right = -self.gradient[row];
                    for (col, held) in self.held.iter().enumerate() {
                        if let Some(at) = held {
                            right -= self.hessian[(row.max(col), row.min(col))] * at;
                        }
                    }
                    right
                }
            };
        }
        // The factorisation takes the matrix and gives its memory back.
        let matrix = std::mem::replace(&mut self.reduced, DMatrix::zeros(0, 0));
        match Cholesky::new(matrix) {
            Some(factor) => {
                factor.solve_mut(&mut self.right);
                self.reduced = factor.unpack_dirty();
                self.step.copy_from(&self.right);
                Ok(())
            }
            None => {
                self.reduced = DMatrix::zeros(n, n);
                Err(NotConvex)
            }
        }
    }
}

fn raised(damping: f64) -> f64 {
    (damping * 8.0).max(1e-4)
}

fn lowered(damping: f64) -> f64 {
    if damping < 1e-6 { 0.0 } else { damping * 0.1 }
}
