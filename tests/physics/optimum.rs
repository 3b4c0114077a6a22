//! The convex problem: optimality, balance, and limits.

use egotac::physics::cone::Cone;
use egotac::physics::solve::{Point, solve};
use glam::DVec3;
use nalgebra::{Matrix6, Vector3, Vector6};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn vector(rng: &mut ChaCha8Rng, size: f64) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| rng.random_range(-size..size)))
}

/// A random force of a cone.
fn member(cone: &Cone, rng: &mut ChaCha8Rng) -> DVec3 {
    let normal = rng.random_range(0.0..cone.limit.min(50.0));
    let (angle, share) = (rng.random_range(0.0..std::f64::consts::TAU), rng.random_range(0.0..=1.0));
    DVec3::new(normal, share * cone.friction * normal * angle.cos(), share * cone.friction * normal * angle.sin())
}

fn random_problem(rng: &mut ChaCha8Rng) -> (Vec<Point>, Vector6<f64>, Matrix6<f64>) {
    let n = rng.random_range(1..12);
    let points = (0..n).map(|_| {
        let inward = vector(rng, 1.0).normalize();
        let (t1, t2) = inward.any_orthonormal_pair();
        let cone = Cone { friction: rng.random_range(0.2..1.2), limit: rng.random_range(2.0..60.0) };
        Point::new(vector(rng, 0.05), [inward, t1, t2], vector(rng, 3.0), rng.random_range(0.3..10.0), cone)
    });
    let points = points.collect();
    let wrench = Vector6::from_fn(|row, _| rng.random_range(-1.0..1.0) * if row < 3 { 5.0 } else { 0.1 });
    let sds = Vector6::from_fn(|row, _| rng.random_range(0.01..0.3) * if row < 3 { 1.0 } else { 0.03 });
    (points, wrench, Matrix6::from_diagonal(&sds.component_mul(&sds)))
}

#[test]
fn the_projection_is_the_nearest_force_of_the_cone() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for _ in 0..2000 {
        let cone = Cone { friction: rng.random_range(0.1..1.5), limit: rng.random_range(1.0..20.0) };
        let v = vector(&mut rng, 30.0);
        let (force, derivative) = cone.project(v);
        assert!(force.x >= 0.0 && force.x <= cone.limit * (1.0 + 1e-12));
        assert!(force.y.hypot(force.z) <= cone.friction * force.x + 1e-9);
        // The projection onto a convex set is where the rest makes no acute angle with the set.
        for _ in 0..20 {
            let other = member(&cone, &mut rng);
            assert!((v - force).dot(other - force) <= 1e-9, "{v} -> {force}, but {other}");
        }
        let step = vector(&mut rng, 1.0) * 1e-6;
        let moved = cone.project(v + step).0 - force;
        let kink = (0..3).any(|_| (cone.project(v + 3.0 * step).1 - derivative).x_axis.length() > 1e-3);
        assert!(kink || (moved - derivative * step).length() < 1e-9, "{v}: {moved} against {}", derivative * step);
    }
}

#[test]
fn solutions_satisfy_the_variational_inequality_and_balance() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for _ in 0..500 {
        let (points, wrench, covariance) = random_problem(&mut rng);
        let solved = solve(&points, &wrench, &covariance);
        assert!(solved.converged);
        let sum: Vector6<f64> =
            points.iter().zip(&solved.forces).map(|(p, f)| p.map * Vector3::from(f.to_array())).sum();
        let scale = 1.0 + wrench.norm();
        assert!((wrench - sum - solved.residual).norm() < 1e-4 * scale, "{}", (wrench - sum - solved.residual).norm());
        let pull = covariance.cholesky().unwrap().solve(&solved.residual);
        for (point, force) in points.iter().zip(&solved.forces) {
            let slope = point.precision * (*force - point.expected) - {
                let v = point.map.tr_mul(&pull);
                DVec3::new(v.x, v.y, v.z)
            };
            for _ in 0..20 {
                let other = member(&point.cone, &mut rng);
                let gain = slope.dot(other - *force);
                assert!(gain >= -1e-5 * (1.0 + slope.length()) * (1.0 + other.length()), "{gain}");
            }
        }
    }
}

#[test]
fn no_link_pushes_beyond_the_limit_of_a_hand() {
    let cone = Cone { friction: 1.0, limit: 80.0 };
    let point = Point::new(DVec3::ZERO, [DVec3::Z, DVec3::X, DVec3::Y], DVec3::ZERO, 100.0, cone);
    let heavy = Vector6::new(0.0, 0.0, 180.0, 0.0, 0.0, 0.0);
    let solved = solve(&[point], &heavy, &(Matrix6::identity() * 1e-4));
    assert!((solved.forces[0].x - 80.0).abs() < 1e-6 && (solved.residual[2] - 100.0).abs() < 1e-3);
}
