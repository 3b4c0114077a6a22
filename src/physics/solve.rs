//! Forces at contact points that explain a wrench: a strictly convex problem, solved in its six dual variables.
//!
//! ```text
//! minimise  ½ (w - Σ Gᵢ fᵢ)ᵀ C⁻¹ (w - Σ Gᵢ fᵢ) + Σ ½ dᵢ |fᵢ - pᵢ|²    with fᵢ in its cone
//! ```
//!
//! The wrench has six numbers, whatever the number of points. For a multiplier λ of the balance, each force is the projection
//! of `pᵢ + Gᵢᵀ λ / dᵢ` onto its cone, and the residual is `C λ`: Newton's method on the six equations converges in a few
//! steps of 6 x 6 algebra.

use glam::{DMat3, DVec3};
use nalgebra::{Matrix6, SMatrix, Vector3, Vector6};

use super::cone::Cone;

/// Largest number of Newton steps. 5 to 15 are usual; some tenths of a percent of random problems zigzag between cones for 60 and
/// more.
const MAX_STEPS: usize = 250;
/// Decrement at which the dual objective has converged, relative to its size.
const TOLERANCE: f64 = 1e-12;

/// Contact point on a body, as the problem sees it.
#[derive(Debug, Clone, Copy)]
pub struct Point {
    /// Maps a force in the contact frame, N, to the wrench on the body: force, N, and moment about its centre of mass, N m.
    pub map: SMatrix<f64, 6, 3>,
    /// Expected force in the contact frame, N.
    pub expected: DVec3,
    /// Inverse variance of the expectation, 1/N².
    pub precision: f64,
    /// Possible forces.
    pub cone: Cone,
}

impl Point {
    /// Creates a point at `arm`, m, from the centre of mass, with the unit axes of its contact frame: normal into the body,
    /// two tangents.
    pub fn new(arm: DVec3, axes: [DVec3; 3], expected: DVec3, sd: f64, cone: Cone) -> Self {
        let mut map = SMatrix::zeros();
        for (column, axis) in axes.into_iter().enumerate() {
            let moment = arm.cross(axis);
            for row in 0..3 {
                map[(row, column)] = axis[row];
                map[(row + 3, column)] = moment[row];
            }
        }
        Self { map, expected, precision: 1.0 / (sd * sd), cone }
    }

    fn force(&self, multiplier: &Vector6<f64>) -> (DVec3, DMat3, DVec3) {
        let pull = self.map.tr_mul(multiplier);
        let pull = DVec3::new(pull.x, pull.y, pull.z);
        let (force, derivative) = self.cone.project(self.expected + pull / self.precision);
        (force, derivative, pull)
    }
}

/// Forces that explain a wrench.
#[derive(Debug, Clone)]
pub struct Forces {
    /// Force at each point in its contact frame, N.
    pub forces: Vec<DVec3>,
    /// Part of the wrench that the points do not explain: force, N, and moment, N m.
    pub residual: Vector6<f64>,
    /// True if the optimum was reached.
    pub converged: bool,
}

/// Returns the forces at `points` that explain `wrench` within its covariance `covariance`, which is positive definite.
pub fn solve(points: &[Point], wrench: &Vector6<f64>, covariance: &Matrix6<f64>) -> Forces {
    let mut multiplier = Vector6::zeros();
    let mut state = State::at(points, wrench, covariance, &multiplier);
    let mut converged = false;
    for _ in 0..MAX_STEPS {
        let Some(factor) = state.hessian.cholesky() else { break };
        let step = factor.solve(&state.gradient);
        let decrement = state.gradient.dot(&step);
        if decrement <= TOLERANCE * (1.0 + state.objective.abs()) {
            converged = true;
            break;
        }
        let mut scale = 1.0;
        let next = loop {
            let trial = multiplier + step * scale;
            let next = State::at(points, wrench, covariance, &trial);
            if next.objective >= state.objective + 1e-4 * scale * decrement || scale < 1e-8 {
                multiplier = trial;
                break next;
            }
            scale *= 0.5;
        };
        let stalled = scale < 1e-8;
        state = next;
        if stalled {
            converged = decrement <= 1e-8 * (1.0 + state.objective.abs());
            break;
        }
    }
    let forces = points.iter().map(|point| point.force(&multiplier).0).collect();
    Forces { forces, residual: covariance * multiplier, converged }
}

/// Dual objective with its derivatives.
struct State {
    objective: f64,
    gradient: Vector6<f64>,
    /// Negative second derivative.
    hessian: Matrix6<f64>,
}

impl State {
    fn at(points: &[Point], wrench: &Vector6<f64>, covariance: &Matrix6<f64>, multiplier: &Vector6<f64>) -> Self {
        let explained = covariance * multiplier;
        let mut state = Self {
            objective: multiplier.dot(wrench) - 0.5 * multiplier.dot(&explained),
            gradient: wrench - explained,
            hessian: *covariance,
        };
        for point in points {
            let (force, derivative, pull) = point.force(multiplier);
            state.objective -= pull.dot(force) - 0.5 * point.precision * force.distance_squared(point.expected);
            state.gradient -= point.map * Vector3::from(force.to_array());
            let derivative = nalgebra::Matrix3::from_column_slice(&derivative.to_cols_array());
            state.hessian += point.map * (derivative / point.precision) * point.map.transpose();
        }
        state
    }
}

/// Ratio of the variance that the wrench leaves to the one of the expectation, for a sum of force components: 0 = determined
/// by the wrench, 1 = not seen by it. `weights` are per point, in the contact frame; forces at a bound are not free to move.
pub fn remaining_variance(points: &[Point], weights: &[DVec3], covariance: &Matrix6<f64>) -> f64 {
    let mut spread = *covariance;
    let (mut before, mut seen) = (0.0, Vector6::zeros());
    for (point, weight) in points.iter().zip(weights) {
        spread += point.map * point.map.transpose() / point.precision;
        before += weight.length_squared() / point.precision;
        seen += point.map * Vector3::from(weight.to_array()) / point.precision;
    }
    match spread.cholesky() {
        Some(factor) if before > 0.0 => (1.0 - seen.dot(&factor.solve(&seen)) / before).clamp(0.0, 1.0),
        _ => 1.0,
    }
}
