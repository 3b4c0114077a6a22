//! Minimiser of a [`Problem`] within the bounds of the joints: damped Newton steps, bounds by an active set.
//!
//! Each step minimises the quadratic model g^T p + p^T (H + d I) p / 2 over low <= u + p <= high:
//!
//! - **Active set.** Coordinates whose step leaves the bounds are held at them, the rest is solved again, and held
//!   coordinates whose gradient points inwards are released, until neither happens. So bounds hold exactly and joints at
//!   their limits cost no extra steps.
//! - **Damping d** is 0 where the model is convex and has predicted the last short step well, because Newton's steps
//!   converge quadratically there; it grows where H is indefinite, a step is too long, or the cost did not fall.
//! - **Warm start.** The caller passes the pose of the last frame; most frames then take a few steps. Poor local minima,
//!   which warm starts can't leave, are the business of `search.rs`.
//!
//! The crate `levenberg-marquardt` does not replace this solver: it has no bounds and uses first derivatives only, while
//! bounds and the exact Hessian are what lets this one reach the best known optimum in 3 to 5 steps, 6 to 400 times as fast
//! as dexi-rs, mink and dex-retargeting (measured in `docs/bench/retarget.md`).

use nalgebra::{DMatrix, DVector};

use super::problem::Problem;
use super::robot::coupling::Coupling;
use crate::error::Result;
use crate::mujoco::World;
use crate::mujoco::parts::Parts;

/// Greatest change of a coordinate in a step, rad or m: over longer arcs the quadratic model of joint rotations is wrong.
const MAX_STEP: f64 = 0.35;
/// Length that damping aims at, in [`MAX_STEP`]s. The damping is found by one Newton step, which underestimates it, so the
/// damped step is a little longer than aimed at: with a length of 1 it would exceed [`MAX_STEP`] and be cut after all.
const DAMPED_LENGTH: f64 = 0.7;
/// Length, in [`MAX_STEP`]s, below which a step that brought the predicted gain switches damping off.
const SHORT_LENGTH: f64 = 0.5;
/// Damping, in mean curvatures, at which steps are too short to be worth taking: the search ends.
const MAX_DAMPING: f64 = 1e8;
/// Rounds of the active set in which all coordinates that may leave their bounds are released at once, which settles
/// soonest; after them only the steepest one is, because releasing several may cycle.
const EAGER_ROUNDS: usize = 6;
/// Least slope away from a bound at which a held coordinate is released.
const MIN_RELEASE_SLOPE: f64 = 1e-14;
/// Share of the tolerance below which the last step is not even tried.
const NEGLIGIBLE: f64 = 1e-3;

/// Stopping rule.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stop {
    /// Greatest number of steps.
    pub iterations: usize,
    /// Predicted gain of a step, relative to the cost, below which the solve has converged.
    pub tolerance: f64,
}

impl Default for Stop {
    fn default() -> Self {
        Self { iterations: 30, tolerance: 1e-5 }
    }
}

/// Result of a solve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solved {
    /// Cost at the end.
    pub cost: f64,
    /// Steps taken.
    pub iterations: usize,
    /// True if the tolerance was reached within the allowed steps.
    pub converged: bool,
}

/// Workspace of the solver, allocated once.
#[derive(Debug)]
pub struct Solver {
    gradient: DVector<f64>,
    /// Hessian; only its lower triangle is set.
    hessian: DMatrix<f64>,
    /// Damped Hessian of the coordinates that are not held, with rows of the identity for those that are; its Cholesky
    /// factor after [`Self::solve_free`].
    reduced: DMatrix<f64>,
    step: DVector<f64>,
    /// Hessian times step, without damping.
    hessian_step: DVector<f64>,
    right: DVector<f64>,
    trial: Vec<f64>,
    /// For coordinates that are held at a bound, the step to that bound.
    held: Vec<Option<f64>>,
    /// Held coordinates that are to be released.
    released: Vec<usize>,
    /// Bounds of each coordinate beside those of the joints, rad or m.
    low: Vec<f64>,
    high: Vec<f64>,
}

/// Error of a quadratic model without a minimum.
struct NotConvex;

/// Damping of the steps, in mean curvatures.
#[derive(Debug, Clone, Copy, Default)]
struct Damping {
    now: f64,
    /// Damping of the last step that reduced the cost.
    last_success: f64,
}

impl Damping {
    fn is_exhausted(&self) -> bool {
        self.now > MAX_DAMPING
    }

    fn raise(&mut self) {
        self.now = (self.now * 8.0).max(1e-2);
    }

    /// Raises the damping of a model that is not convex. The damping of the last success is nearer to the one needed than
    /// the first value from 0 is.
    fn raise_until_convex(&mut self) {
        let known = lowered(self.last_success);
        if self.now < known {
            self.now = known;
        } else {
            self.raise();
        }
    }

    /// Adapts the damping to a step that reduced the cost. `kept`: actual over predicted gain; `length`: of the step
    /// before it was cut, in [`MAX_STEP`]s.
    fn after_success(&mut self, kept: f64, length: f64) {
        self.last_success = self.now;
        if kept > 0.75 && length < SHORT_LENGTH {
            self.now = 0.0;
        } else if kept > 0.5 {
            self.now = lowered(self.now);
        } else if kept < 0.1 {
            self.raise();
        }
    }
}

fn lowered(damping: f64) -> f64 {
    if damping < 1e-4 { 0.0 } else { damping * 0.1 }
}

impl Solver {
    /// Allocates a workspace for `n` free coordinates.
    pub fn new(n: usize) -> Self {
        Self {
            gradient: DVector::zeros(n),
            hessian: DMatrix::zeros(n, n),
            reduced: DMatrix::zeros(n, n),
            step: DVector::zeros(n),
            hessian_step: DVector::zeros(n),
            right: DVector::zeros(n),
            trial: vec![0.0; n],
            held: vec![None; n],
            released: Vec::with_capacity(n),
            low: vec![f64::NEG_INFINITY; n],
            high: vec![f64::INFINITY; n],
        }
    }

    /// Bounds each coordinate to `centre` +- `reach`, beside the bounds of the joints, until [`Self::widen`].
    pub fn narrow(&mut self, centre: &[f64], reach: &[f64]) {
        for (k, (centre, reach)) in centre.iter().zip(reach).enumerate() {
            (self.low[k], self.high[k]) = (centre - reach, centre + reach);
        }
    }

    /// Removes the bounds of [`Self::narrow`].
    pub fn widen(&mut self) {
        self.low.fill(f64::NEG_INFINITY);
        self.high.fill(f64::INFINITY);
    }

    /// Minimises the cost from `u`, which becomes the best pose found; the robot is left in it.
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
        // Gains below this are lost in the rounding of the cost. Without it targets that can be met exactly, whose cost
        // tends to 0, would never converge by the relative tolerance.
        let floor = f64::EPSILON * cost + f64::MIN_POSITIVE;
        let mut damping = Damping::default();
        let mut solved = Solved { cost, iterations: 0, converged: u.is_empty() };
        let (mut has_derivatives, mut is_damped_for_length, mut is_at_worse_pose) = (false, false, false);
        while solved.iterations < stop.iterations && !solved.converged {
            if !has_derivatives {
                problem.derivatives(world, u, &mut self.gradient, &mut self.hessian);
                has_derivatives = true;
            }
            let scale = self.mean_curvature();
            // Attempts without a step do not count as iterations: a few are often needed to leave a pose where the model is
            // not convex.
            let Ok(mut gain) = self.plan(u, coupling, damping.now * scale) else {
                if damping.is_exhausted() {
                    break;
                }
                damping.raise_until_convex();
                continue;
            };
            let length = self.step.amax() / MAX_STEP;
            // A step that is too long may end in another valley. Damping bends it towards steepest descent, which cutting
            // does not, but each damping costs a factorisation: damp once, then cut.
            if length > 1.0 && !is_damped_for_length {
                is_damped_for_length = true;
                damping.now += self.missing_damping() / scale;
                continue;
            }
            solved.iterations += 1;
            is_damped_for_length = false;
            if length > 1.0 {
                self.step /= length;
                self.hessian_step /= length;
                gain = self.gain(damping.now * scale);
            }
            if gain <= stop.tolerance * cost + floor {
                solved.converged = true;
                // Above this the last step is still taken, but not followed by another.
                if gain <= NEGLIGIBLE * stop.tolerance * cost {
                    break;
                }
            }
            self.set_trial(u, coupling);
            let next = problem.cost(world, parts, coupling, &self.trial)?;
            is_at_worse_pose = next >= cost || next.is_nan();
            if !is_at_worse_pose {
                damping.after_success((cost - next) / gain, length);
                u.copy_from_slice(&self.trial);
                cost = next;
                has_derivatives = false;
            } else if solved.converged || damping.is_exhausted() {
                solved.converged = true;
                break;
            } else {
                damping.raise();
            }
        }
        if is_at_worse_pose {
            // Return the robot from the last trial to the best pose.
            problem.cost(world, parts, coupling, u)?;
        }
        solved.cost = cost;
        Ok(solved)
    }

    /// Lower and upper bound of a coordinate.
    fn bounds(&self, coupling: &Coupling, k: usize) -> (f64, f64) {
        let low = coupling.low[k].max(self.low[k]);
        (low, coupling.high[k].min(self.high[k]).max(low))
    }

    /// Sets the trial pose to u + step.
    fn set_trial(&mut self, u: &[f64], coupling: &Coupling) {
        for (k, u) in u.iter().enumerate() {
            let (low, high) = self.bounds(coupling, k);
            // Held coordinates are exactly at their bound, whatever u + (bound - u) rounds to.
            self.trial[k] = (u + self.step[k]).clamp(low, high);
        }
    }

    /// Mean curvature, the unit of damping.
    fn mean_curvature(&self) -> f64 {
        let n = self.gradient.len().max(1);
        (0..self.gradient.len()).map(|k| self.hessian[(k, k)].abs()).sum::<f64>() / n as f64
    }

    /// Computes the step that minimises the quadratic model within the bounds; returns the predicted gain.
    ///
    /// # Errors
    /// If the model is not convex in the coordinates that are not held.
    #[allow(clippy::needless_range_loop)] // The loop runs over several vectors at once.
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
            self.released.clear();
            let (mut is_out_of_bounds, mut steepest) = (false, MIN_RELEASE_SLOPE);
            for k in 0..n {
                let (low, high) = self.step_bounds(coupling, u, k);
                let Some(at) = self.held[k] else {
                    if !(low..=high).contains(&self.step[k]) {
                        self.held[k] = Some(self.step[k].clamp(low, high));
                        is_out_of_bounds = true;
                    }
                    continue;
                };
                let inward_slope = self.slope(k, damping) * if at <= low { -1.0 } else { 1.0 };
                if low >= high || inward_slope <= steepest {
                    continue;
                }
                if round >= EAGER_ROUNDS {
                    steepest = inward_slope;
                    self.released.clear();
                }
                self.released.push(k);
            }
            if !is_out_of_bounds && self.released.is_empty() {
                break;
            }
            if round < EAGER_ROUNDS || !is_out_of_bounds {
                self.released.iter().for_each(|k| self.held[*k] = None);
            }
        }
        let gain = self.gain(damping);
        if gain >= 0.0 { Ok(gain) } else { Err(NotConvex) }
    }

    /// Reduction of the cost by the step, as the quadratic model predicts it.
    fn gain(&self, damping: f64) -> f64 {
        -self.gradient.dot(&self.step) - 0.5 * (self.hessian_step.dot(&self.step) + damping * self.step.norm_squared())
    }

    /// Damping that is missing for the step of the coordinates that are not held to be short enough: one step of Newton's
    /// method on 1 / length as a function of the damping, which is nearly linear (Moré, Sorensen 1983).
    fn missing_damping(&mut self) -> f64 {
        for (right, (step, held)) in self.right.iter_mut().zip(self.step.iter().zip(&self.held)) {
            *right = if held.is_some() { 0.0 } else { *step };
        }
        let (squared, excess) = (self.right.norm_squared(), self.right.amax() / (DAMPED_LENGTH * MAX_STEP) - 1.0);
        // With L the Cholesky factor, d|p|/dd = -|L^-1 p|^2 / |p|; Newton's step is (excess) |p|^2 / |L^-1 p|^2.
        let is_solved = self.reduced.solve_lower_triangular_mut(&mut self.right);
        let missing = excess * squared / self.right.norm_squared();
        if is_solved && missing.is_finite() { missing.max(0.0) } else { 0.0 }
    }

    /// Bounds of a coordinate's step.
    fn step_bounds(&self, coupling: &Coupling, u: &[f64], k: usize) -> (f64, f64) {
        let (low, high) = self.bounds(coupling, k);
        (low - u[k], high - u[k])
    }

    /// Slope of the quadratic model along a coordinate, at the end of the step.
    fn slope(&self, k: usize, damping: f64) -> f64 {
        self.gradient[k] + damping * self.step[k] + self.hessian_step[k]
    }

    /// Computes the step of the coordinates that are not held, given the steps of those that are.
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
        self.hessian_step.sygemv(1.0, &self.hessian, &self.step, 0.0);
        if is_solved { Ok(()) } else { Err(NotConvex) }
    }
}

/// Replaces a matrix by its Cholesky factor, in the lower triangle. Joints of different fingers mostly share no curvature:
/// zeros are skipped, so a hand is factorised finger by finger.
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
