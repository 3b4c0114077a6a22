//! Inverse kinematics of a hand: pads to points, by damped least squares on the engine's Jacobians.

use glam::DVec3;
use nalgebra::{DMatrix, DVector};
use parry3d::math::Pose;
use parry3d::shape::SharedShape;

use super::convex;
use super::rig::{HandRig, Pad};
use crate::mujoco::World;
use crate::mujoco::world::{Body, Servo};

/// One degree of freedom that may move, with what holds it back.
#[derive(Debug, Clone, Copy)]
pub struct Freedom {
    /// The joint.
    pub servo: Servo,
    /// Position it prefers, m or rad.
    pub rest: f64,
    /// Deviation from `rest` that counts as much as a millimetre of a pad's error.
    pub slack: f64,
    /// Limits.
    pub range: [f64; 2],
}

/// A pad that shall be at a point and face against a normal.
#[derive(Debug, Clone, Copy)]
pub struct Reach {
    /// Body of the pad's link.
    pub body: Body,
    /// The pad.
    pub pad: Pad,
    /// Where it shall be, m.
    pub point: DVec3,
    /// Outward unit normal of the surface there.
    pub normal: DVec3,
}

/// Links of a hand, kept above a height, out of obstacles, and out of each other.
pub struct Clearance<'a> {
    /// The hand.
    pub rig: &'a HandRig,
    /// Its links' bodies.
    pub links: &'a [Body],
    /// Pairs of links that may meet.
    pub pairs: Vec<(usize, usize)>,
    /// Lowest height allowed, m.
    pub height: f64,
    /// The obstacles, in the world frame.
    pub obstacles: Vec<(SharedShape, Pose)>,
    /// Distance that links keep from the obstacles, m.
    pub margin: f64,
    /// Links whose pads have goals.
    pub pads: Vec<usize>,
    /// Distance that those keep from the obstacles, m.
    pub pad_margin: f64,
}

/// Error of a pad's place that counts 1, m.
const POINT_SLACK: f64 = 1e-3;
/// Error of a pad's direction that counts 1, as the length of the difference of unit vectors.
const NORMAL_SLACK: f64 = 0.35;

/// Gap that fingers keep from each other, m.
const FINGER_GAP: f64 = 1.5e-3;

/// Moves `freedoms` until the pads reach; returns their positions, which are also left in `world`.
///
/// Levenberg-Marquardt: minimises squared errors of points, facing, clearance and deviation from rest.
pub fn solve(
    world: &mut World,
    freedoms: &[Freedom],
    reaches: &[Reach],
    clearance: &Clearance,
    iterations: usize,
) -> Vec<f64> {
    let mut positions: Vec<f64> =
        freedoms.iter().map(|f| world.joint_position(f.servo).clamp(f.range[0], f.range[1])).collect();
    let place = |world: &mut World, positions: &[f64]| {
        for (freedom, position) in freedoms.iter().zip(positions) {
            world.set_joint_position(freedom.servo, *position);
        }
        world.kinematics();
    };
    place(world, &positions);
    let (mut residual, mut jacobian) = linearise(world, freedoms, &positions, reaches, clearance);
    let mut damping = 1e-2;
    for _ in 0..iterations {
        let gradient = jacobian.tr_mul(&residual);
        let mut normal = jacobian.tr_mul(&jacobian);
        for i in 0..freedoms.len() {
            normal[(i, i)] *= 1.0 + damping;
            normal[(i, i)] += 1e-9;
        }
        let Some(factor) = normal.cholesky() else { break };
        let step = factor.solve(&gradient);
        let trial: Vec<f64> = positions
            .iter()
            .zip(freedoms)
            .zip(step.iter())
            .map(|((q, freedom), dq)| (q - dq).clamp(freedom.range[0], freedom.range[1]))
            .collect();
        place(world, &trial);
        let (new_residual, new_jacobian) = linearise(world, freedoms, &trial, reaches, clearance);
        let (old, new) = (residual.norm_squared(), new_residual.norm_squared());
        if new < old {
            (positions, residual, jacobian) = (trial, new_residual, new_jacobian);
            damping = f64::max(damping * 0.3, 1e-9);
            if old - new < 1e-9 * old {
                break;
            }
        } else {
            damping *= 8.0;
            if damping > 1e8 {
                break;
            }
        }
    }
    place(world, &positions);
    positions
}

/// Stacks the weighted errors and their derivatives by the freedoms.
fn linearise(
    world: &World,
    freedoms: &[Freedom],
    positions: &[f64],
    reaches: &[Reach],
    clearance: &Clearance,
) -> (DVector<f64>, DMatrix<f64>) {
    let servos: Vec<Servo> = freedoms.iter().map(|f| f.servo).collect();
    let mut errors: Vec<f64> = Vec::new();
    let mut rows: Vec<Vec<f64>> = Vec::new();
    let mut push = |error: DVec3, columns: &[DVec3], slack: f64| {
        for axis in 0..3 {
            errors.push(error[axis] / slack);
            rows.push(columns.iter().map(|c| c[axis] / slack).collect());
        }
    };
    for reach in reaches {
        let turn = world.orientation(reach.body);
        let point = world.position(reach.body) + turn * reach.pad.position;
        push(point - reach.point, &world.jacobian(reach.body, point, &servos), POINT_SLACK);
        let facing = turn * reach.pad.normal;
        let spins = world.angular_jacobian(reach.body, &servos);
        let columns: Vec<DVec3> = spins.iter().map(|omega| omega.cross(facing)).collect();
        push(facing + reach.normal, &columns, NORMAL_SLACK);
    }
    let mut push_out = |depth: f64, columns: Vec<f64>| {
        errors.push(-depth / POINT_SLACK);
        rows.push(columns.into_iter().map(|c| c / POINT_SLACK).collect());
    };
    let rig = clearance.rig;
    let poses: Vec<Pose> =
        clearance.links.iter().map(|link| convex::pose(world.position(*link), world.orientation(*link))).collect();
    for (link, body) in clearance.links.iter().enumerate() {
        let margin = if clearance.pads.contains(&link) { clearance.pad_margin } else { clearance.margin };
        for (shape, pose) in &clearance.obstacles {
            if let Some(hit) = convex::overlap((rig.shape(link), &poses[link]), (shape, pose), margin) {
                push_out(hit.depth, world.jacobian(*body, hit.point, &servos).iter().map(|c| c.dot(hit.out)).collect());
            }
        }
        let (origin, turn) = (world.position(*body), world.orientation(*body));
        let corners = rig.hulls[link].iter().map(|corner| origin + turn * *corner);
        let Some(lowest) = corners.min_by(|a, b| a.z.total_cmp(&b.z)) else { continue };
        if lowest.z < clearance.height {
            let columns = world.jacobian(*body, lowest, &servos);
            push_out(clearance.height - lowest.z, columns.iter().map(|c| c.z).collect());
        }
    }
    for &(a, b) in &clearance.pairs {
        if let Some(hit) = convex::overlap((rig.shape(a), &poses[a]), (rig.shape(b), &poses[b]), FINGER_GAP) {
            let of_a = world.jacobian(clearance.links[a], hit.point, &servos);
            let of_b = world.jacobian(clearance.links[b], hit.point, &servos);
            push_out(hit.depth, of_a.iter().zip(of_b).map(|(a, b)| (*a - b).dot(hit.out)).collect());
        }
    }
    for (i, (freedom, position)) in freedoms.iter().zip(positions).enumerate() {
        errors.push((position - freedom.rest) / freedom.slack);
        rows.push((0..freedoms.len()).map(|j| if i == j { 1.0 / freedom.slack } else { 0.0 }).collect());
    }
    let jacobian = DMatrix::from_fn(rows.len(), freedoms.len(), |r, c| rows[r][c]);
    (DVector::from_vec(errors), jacobian)
}
