//! Damped Newton steps within a box, the box kept exactly by an active set.

use nalgebra::{DMatrix, DVector};

use super::problem::Problem;
use super::robot::coupling::Coupling;
use crate::error::Result;
use crate::mujoco::World;
use crate::mujoco::parts::Parts;

/// Longest change of a coordinate in a step, rad or m.
const LONGEST: f64 = 0.35;
/// Share of it that a damped step is to have: damping for the whole of it would fall short again, by a little.
const DAMPED: f64 = 0.7;
/// Share of it at which the quadratic model has become good enough to do without damping.
const SHORT: f64 = 0.5;
/// Damping, in mean curvatures, at which no step is worth another look.
const MOST_DAMPING: f64 = 1e8;
/// Rounds in which all coordinates that want to leave their bounds inwards do so at once; in later ones, one does.
const EAGER: usize = 6;

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
    /// Change of the slopes by the step, without damping: the Hessian times the step.
    bent: DVector<f64>,
    right: DVector<f64>,
    trial: Vec<f64>,
    /// Coordinates held at a bound, with the step that brings them there.
    held: Vec<Option<f64>>,
    /// Those among them that are to be let go.
    let_go: Vec<usize>,
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
            bent: DVector::zeros(n),
            right: DVector::zeros(n),
            trial: vec![0.0; n],
            held: vec![None; n],
            let_go: Vec::with_capacity(n),
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
        let (mut damping, mut worked) = (0.0, 0.0);
        // Less is lost in the rounding of the cost at the start: targets that can be met exactly have no end otherwise.
        let floor = f64::EPSILON * cost + f64::MIN_POSITIVE;
        let mut solved = Solved { cost, iterations: 0, converged: u.is_empty() };
        let (mut is_fresh, mut is_damped, mut went_astray) = (false, false, false);
        while solved.iterations < stop.iterations && !solved.converged {
            solved.iterations += 1;
            if !is_fresh {
                problem.derivatives(world, u, &mut self.gradient, &mut self.hessian);
                is_fresh = true;
            }
            let scale = self.scale();
            let Ok(mut gain) = self.plan(u, coupling, damping * scale) else {
                // Not a step: a few are often enough to leave a pose where the model is not convex, and are to be taken.
                solved.iterations -= 1;
                if damping > MOST_DAMPING {
                    break;
                }
                // What the last step needed is nearer to what this one needs than a fresh start would be.
                damping = if damping < lowered(worked) { lowered(worked) } else { raised(damping) };
                continue;
            };
            // Far from here the model tells nothing; a long step may end in another valley. Damping turns it to where
            // the cost falls, but is worth one factorisation, not several.
            let excess = self.step.amax() / LONGEST;
            if excess > 1.0 && !is_damped {
                is_damped = true;
                damping += self.lacking() / scale;
                solved.iterations -= 1;
                continue;
            }
            is_damped = false;
            if excess > 1.0 {
                self.step /= excess;
                self.bent /= excess;
                gain = self.gain(damping * scale);
            }
            if gain <= stop.tolerance * cost + floor {
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
                // A step that brings what it promised needs less damping; one that was short besides, none.
                let kept = (cost - next) / gain;
                worked = damping;
                damping = if kept > 0.75 && excess < SHORT {
                    0.0
                } else if kept > 0.5 {
                    lowered(damping)
                } else if kept < 0.1 {
                    raised(damping)
                } else {
                    damping
                };
                u.copy_from_slice(&self.trial);
                cost = next;
                (is_fresh, went_astray) = (false, false);
            } else {
                went_astray = true;
                if solved.converged || damping > MOST_DAMPING {
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

    /// Finds the step that makes the quadratic model least within the box; gives what it is to bring.
    #[allow(clippy::needless_range_loop)] // Positions, bounds, slopes and steps run beside each other.
    fn plan(&mut self, u: &[f64], coupling: &Coupling, damping: f64) -> std::result::Result<f64, NotConvex> {
        let n = u.len();
        for k in 0..n {
            let (low, high) = self.bounds(coupling, k);
            let is_low = u[k] <= low && self.gradient[k] > 0.0;
            let is_high = u[k] >= high && self.gradient[k] < 0.0;
            self.held[k] = (is_low || is_high || low >= high).then_some(0.0);
        }
        for round in 0..=2 * n {
            self.solve_free(damping)?;
            self.let_go.clear();
            let (mut went_out, mut inmost) = (false, 1e-14);
            for k in 0..n {
                let (low, high) = self.steps(coupling, u, k);
                let Some(at) = self.held[k] else {
                    if !(low..=high).contains(&self.step[k]) {
                        self.held[k] = Some(self.step[k].clamp(low, high));
                        went_out = true;
                    }
                    continue;
                };
                let inwards = self.slope(k, damping) * if at <= low { -1.0 } else { 1.0 };
                if low >= high || inwards <= inmost {
                    continue;
                }
                // All at once settles soonest, but may go round in circles.
                if round >= EAGER {
                    inmost = inwards;
                    self.let_go.clear();
                }
                self.let_go.push(k);
            }
            if !went_out && self.let_go.is_empty() {
                break;
            }
            if round < EAGER || !went_out {
                self.let_go.iter().for_each(|k| self.held[*k] = None);
            }
        }
        let gain = self.gain(damping);
        if gain >= 0.0 { Ok(gain) } else { Err(NotConvex) }
    }

    /// What the step is to bring, as the quadratic model has it.
    fn gain(&self, damping: f64) -> f64 {
        -self.gradient.dot(&self.step) - 0.5 * (self.bent.dot(&self.step) + damping * self.step.norm_squared())
    }

    /// Damping that the free coordinates' step lacks to be short enough: a step of Newton's method on one over its
    /// length (Moré, Sorensen 1983).
    fn lacking(&mut self) -> f64 {
        for (right, (step, held)) in self.right.iter_mut().zip(self.step.iter().zip(&self.held)) {
            *right = if held.is_some() { 0.0 } else { *step };
        }
        let (squared, excess) = (self.right.norm_squared(), self.right.amax() / (DAMPED * LONGEST) - 1.0);
        // With L of the factorisation: |p|^2 / |L^-1 p|^2 is the slope of the length.
        let is_solved = self.reduced.solve_lower_triangular_mut(&mut self.right);
        let lacking = excess * squared / self.right.norm_squared();
        if is_solved && lacking.is_finite() { lacking.max(0.0) } else { 0.0 }
    }

    /// Least and greatest step of a coordinate.
    fn steps(&self, coupling: &Coupling, u: &[f64], k: usize) -> (f64, f64) {
        let (low, high) = self.bounds(coupling, k);
        (low - u[k], high - u[k])
    }

    /// Slope of the model at the step, along a coordinate.
    fn slope(&self, k: usize, damping: f64) -> f64 {
        self.gradient[k] + damping * self.step[k] + self.bent[k]
    }

    /// The step of the free coordinates, those held staying where they are held.
    fn solve_free(&mut self, damping: f64) -> std::result::Result<(), NotConvex> {
        let n = self.step.len();
        self.reduced.copy_from(&self.hessian);
        self.step.copy_from(&self.gradient);
        self.step.neg_mut();
        for (k, held) in self.held.iter().enumerate() {
            self.reduced[(k, k)] += damping;
            let Some(at) = held else { continue };
            for other in 0..n {
                let (row, col) = (other.max(k), other.min(k));
                self.step[other] -= self.hessian[(row, col)] * at;
                self.reduced[(row, col)] = 0.0;
            }
            self.reduced[(k, k)] = 1.0;
        }
        for (step, held) in self.step.iter_mut().zip(&self.held) {
            *step = held.unwrap_or(*step);
        }
        factorise(&mut self.reduced)?;
        let is_solved = self.reduced.solve_lower_triangular_mut(&mut self.step)
            && self.reduced.tr_solve_lower_triangular_mut(&mut self.step);
        self.bent.sygemv(1.0, &self.hessian, &self.step, 0.0);
        if is_solved { Ok(()) } else { Err(NotConvex) }
    }
}

/// Cholesky's factor in the lower triangle, in place. Joints of different fingers mostly have no curvature in common:
/// what is zero is passed over, and a hand is factorised finger by finger.
fn factorise(matrix: &mut DMatrix<f64>) -> std::result::Result<(), NotConvex> {
    let n = matrix.nrows();
    for j in 0..n {
        let (done, rest) = matrix.as_mut_slice().split_at_mut(j * n);
        let column = &mut rest[j..n];
        for before in done.chunks_exact(n) {
            let share = before[j];
            if share != 0.0 {
                column.iter_mut().zip(&before[j..]).for_each(|(entry, before)| *entry -= share * before);
            }
        }
        if column[0].is_nan() || column[0] <= 0.0 {
            return Err(NotConvex);
        }
        let root = column[0].sqrt();
        column.iter_mut().for_each(|entry| *entry /= root);
    }
    Ok(())
}

fn raised(damping: f64) -> f64 {
    (damping * 8.0).max(1e-2)
}

fn lowered(damping: f64) -> f64 {
    if damping < 1e-4 { 0.0 } else { damping * 0.1 }
}
