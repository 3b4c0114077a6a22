//! Wrench that the motion of a body, or of bodies on joints together, asks of their contacts.

use glam::{DMat3, DVec3};
use nalgebra::{Matrix6, Vector6};

use super::body::Mass;
use super::motion::Kinematics;

/// Standard deviation of the wrench from what no other term holds, relative and N.
const WRENCH_SD: (f64, f64) = (0.005, 0.01);
/// Lever by which this acts as a moment, m.
const WRENCH_LEVER: f64 = 0.005;

/// Distance from the centre of mass at which rotation counts as speed, m.
pub const SPEED_LEVER: f64 = 0.05;

/// Sum of all contact forces that a motion asks for, and of their moments.
#[derive(Debug, Clone, PartialEq)]
pub struct Demand {
    /// Force, N, and moment about the centre of mass, N m, world frame.
    pub wrench: Vector6<f64>,
    /// Covariance of the wrench, from noise of the motion.
    pub covariance: Matrix6<f64>,
    /// Centre of mass, m, world frame.
    pub centre: DVec3,
    /// Mass, kg.
    pub kilograms: f64,
    /// Weight, N.
    pub weight: f64,
    /// Standard deviation of the mass's logarithm; 0 = known.
    pub relative_sd: f64,
    /// Speed of the centre of mass and of a point [`SPEED_LEVER`] beside it, m/s: the largest that they can add up to.
    pub speed: f64,
}

impl Demand {
    /// Computes what a rigid body's motion asks for: `m (a - g)`, and Euler's equation for the moment.
    pub fn of(mass: &Mass, state: &Kinematics, gravity: DVec3) -> Self {
        let turn = DMat3::from_quat(state.pose.orientation);
        let inertia = turn * mass.inertia * turn.transpose();
        let force = mass.kilograms * (state.acceleration - gravity);
        let spin = state.angular_velocity;
        let moment = inertia * state.angular_acceleration + spin.cross(inertia * spin);
        let mut covariance = Matrix6::zeros();
        let weight = mass.kilograms * gravity.length();
        let other = WRENCH_SD.0 * force.length() + WRENCH_SD.1 * weight.min(1.0);
        for axis in 0..3 {
            let sd = mass.kilograms * state.acceleration_sd[axis];
            covariance[(axis, axis)] = sd * sd + other * other;
        }
        let angular = state.angular_acceleration_sd;
        let moments = inertia * DMat3::from_diagonal(angular * angular) * inertia.transpose();
        for row in 0..3 {
            for column in 0..3 {
                covariance[(3 + row, 3 + column)] = moments.col(column)[row];
            }
            covariance[(3 + row, 3 + row)] += (other * WRENCH_LEVER).powi(2) + 1e-12;
        }
        let [f, m] = [force, moment];
        Self {
            wrench: Vector6::new(f.x, f.y, f.z, m.x, m.y, m.z),
            covariance,
            centre: state.pose.point(mass.centre),
            kilograms: mass.kilograms,
            weight,
            relative_sd: mass.relative_sd,
            speed: state.velocity.length() + SPEED_LEVER * spin.length(),
        }
    }

    /// Adds up the demands of the parts of an articulated object, about their common centre of mass: forces in joints cancel.
    /// `None` without a part.
    pub fn joined(parts: &[Self]) -> Option<Self> {
        let [first, others @ ..] = parts else { return None };
        if others.is_empty() {
            return Some(first.clone());
        }
        let kilograms: f64 = parts.iter().map(|part| part.kilograms).sum();
        let centre = parts.iter().map(|part| part.centre * part.kilograms).sum::<DVec3>() / kilograms;
        let mut sum = Self {
            wrench: Vector6::zeros(),
            covariance: Matrix6::zeros(),
            centre,
            kilograms,
            weight: 0.0,
            relative_sd: 0.0,
            speed: 0.0,
        };
        for part in parts {
            let about_common = shifted(part.centre - centre);
            sum.wrench += about_common * part.wrench;
            sum.covariance += about_common * part.covariance * about_common.transpose();
            sum.weight += part.weight;
            // One class of density errs for all parts alike.
            sum.relative_sd = sum.relative_sd.max(part.relative_sd);
            sum.speed = sum.speed.max(part.speed);
        }
        Some(sum)
    }
}

/// Returns the matrix that moves a wrench from a point to the one that it is `arm`, m, away from: the moment grows by arm x force.
fn shifted(arm: DVec3) -> Matrix6<f64> {
    let mut matrix = Matrix6::identity();
    for (column, axis) in DVec3::AXES.into_iter().enumerate() {
        let moment = arm.cross(axis);
        for row in 0..3 {
            matrix[(3 + row, column)] = moment[row];
        }
    }
    matrix
}
