//! Inverse kinematics of a hand: moves pads to points by damped least squares on the engine's Jacobians.

use glam::DVec3;
use nalgebra::{DMatrix, DVector};
use parry3d::math::Pose;
use parry3d::shape::SharedShape;

use super::convex;
use super::rig::{HandRig, Pad};
use crate::mujoco::World;
use crate::mujoco::world::{Body, Servo};

/// Joint that may move, with its preferred position.
#[derive(Debug, Clone, Copy)]
pub struct JointVariable {
    /// Servo of the joint.
    pub servo: Servo,
    /// Preferred position, m or rad.
    pub rest: f64,
    /// Deviation from `rest` that weighs as much as a millimetre of a pad's error, m or rad.
    pub slack: f64,
    /// Limits, m or rad.
    pub range: [f64; 2],
}

/// Target of a pad: a point, and a normal that the pad faces.
#[derive(Debug, Clone, Copy)]
pub struct PadTarget {
    /// Body of the pad's link.
    pub body: Body,
    /// Pad.
    pub pad: Pad,
    /// Target position, m.
    pub point: DVec3,
    /// Outward unit normal of the surface.
    pub normal: DVec3,
}

/// Constraints that keep a hand's links above a height, out of obstacles, and out of each other.
pub struct Clearance<'a> {
    /// Rig of the hand.
    pub rig: &'a HandRig,
    /// Bodies of its links.
    pub links: &'a [Body],
    /// Pairs of links that can collide.
    pub pairs: Vec<(usize, usize)>,
    /// Smallest height, m.
    pub height: f64,
    /// Obstacles in the world frame.
    pub obstacles: Vec<(SharedShape, Pose)>,
    /// Distance between links and obstacles, m.
    pub margin: f64,
    /// Links whose pads have targets.
    pub pads: Vec<usize>,
    /// Distance between those links and obstacles, m.
    pub pad_margin: f64,
}

/// Error of a pad's position with weight 1, m.
const POINT_SLACK: f64 = 1e-3;
/// Error of a pad's direction with weight 1, as the length of the difference of unit vectors.
const NORMAL_SLACK: f64 = 0.35;

/// Distance between fingers, m.
const FINGER_GAP: f64 = 1.5e-3;

/// Moves `variables` until the pads are at their targets; returns their positions, m or rad, which are also set in
/// `world`.
///
/// Minimises the squared errors of points, directions, clearance and deviation from rest by Levenberg-Marquardt. A
/// least squares crate is not a substitute: each residual needs the engine's kinematics, and positions are clamped to
/// their limits.
pub fn solve(
    world: &mut World,
    variables: &[JointVariable],
    targets: &[PadTarget],
    clearance: &Clearance,
    iterations: usize,
) -> Vec<f64> {
    let mut positions: Vec<f64> =
        variables.iter().map(|v| world.joint_position(v.servo).clamp(v.range[0], v.range[1])).collect();
    let place = |world: &mut World, positions: &[f64]| {
        for (variable, position) in variables.iter().zip(positions) {
            world.set_joint_position(variable.servo, *position);
        }
        world.kinematics();
    };
    place(world, &positions);
    let (mut residual, mut jacobian) = linearise(world, variables, &positions, targets, clearance);
    let mut damping = 1e-2;
    for _ in 0..iterations {
        let gradient = jacobian.tr_mul(&residual);
        let mut normal = jacobian.tr_mul(&jacobian);
        for i in 0..variables.len() {
            normal[(i, i)] *= 1.0 + damping;
            normal[(i, i)] += 1e-9;
        }
        let Some(factor) = normal.cholesky() else { break };
        let step = factor.solve(&gradient);
        let trial: Vec<f64> = positions
            .iter()
            .zip(variables)
            .zip(step.iter())
            .map(|((q, variable), dq)| (q - dq).clamp(variable.range[0], variable.range[1]))
            .collect();
        place(world, &trial);
        let (new_residual, new_jacobian) = linearise(world, variables, &trial, targets, clearance);
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

/// Stacks the weighted errors and their derivatives with respect to the variables.
fn linearise(
    world: &World,
    variables: &[JointVariable],
    positions: &[f64],
    targets: &[PadTarget],
    clearance: &Clearance,
) -> (DVector<f64>, DMatrix<f64>) {
    let servos = variables.iter().map(|variable| variable.servo).collect();
    let mut system = LinearSystem { world, servos, errors: Vec::new(), rows: Vec::new() };
    targets.iter().for_each(|target| system.add_target(target));
    system.add_clearance(clearance);
    for (i, (variable, position)) in variables.iter().zip(positions).enumerate() {
        system.errors.push((position - variable.rest) / variable.slack);
        system.rows.push((0..variables.len()).map(|j| if i == j { 1.0 / variable.slack } else { 0.0 }).collect());
    }
    let LinearSystem { errors, rows, .. } = system;
    let jacobian = DMatrix::from_fn(rows.len(), variables.len(), |r, c| rows[r][c]);
    (DVector::from_vec(errors), jacobian)
}

/// Weighted errors, and one row of derivatives for each.
struct LinearSystem<'a> {
    world: &'a World,
    servos: Vec<Servo>,
    errors: Vec<f64>,
    rows: Vec<Vec<f64>>,
}

impl LinearSystem<'_> {
    /// Adds the position and direction errors of a pad.
    fn add_target(&mut self, target: &PadTarget) {
        let world = self.world;
        let turn = world.orientation(target.body);
        let point = world.position(target.body) + turn * target.pad.position;
        let columns = world.jacobian(target.body, point, &self.servos);
        self.push_vector(point - target.point, &columns, POINT_SLACK);
        let facing = turn * target.pad.normal;
        let spins = world.angular_jacobian(target.body, &self.servos);
        let columns: Vec<DVec3> = spins.iter().map(|omega| omega.cross(facing)).collect();
        self.push_vector(facing + target.normal, &columns, NORMAL_SLACK);
    }

    /// Adds the depths of links in obstacles, below the smallest height, and in each other.
    fn add_clearance(&mut self, clearance: &Clearance) {
        let (world, rig) = (self.world, clearance.rig);
        let poses: Vec<Pose> =
            clearance.links.iter().map(|link| convex::pose(world.position(*link), world.orientation(*link))).collect();
        for (link, body) in clearance.links.iter().enumerate() {
            let margin = if clearance.pads.contains(&link) { clearance.pad_margin } else { clearance.margin };
            for (shape, pose) in &clearance.obstacles {
                if let Some(hit) = convex::overlap((rig.shape(link), &poses[link]), (shape, pose), margin) {
                    let columns = world.jacobian(*body, hit.point, &self.servos);
                    self.push_depth(hit.depth, columns.iter().map(|c| c.dot(hit.out)));
                }
            }
            let (origin, turn) = (world.position(*body), world.orientation(*body));
            let corners = rig.hulls[link].iter().map(|corner| origin + turn * *corner);
            let Some(lowest) = corners.min_by(|a, b| a.z.total_cmp(&b.z)) else { continue };
            if lowest.z < clearance.height {
                let columns = world.jacobian(*body, lowest, &self.servos);
                self.push_depth(clearance.height - lowest.z, columns.iter().map(|c| c.z));
            }
        }
        for &(a, b) in &clearance.pairs {
            if let Some(hit) = convex::overlap((rig.shape(a), &poses[a]), (rig.shape(b), &poses[b]), FINGER_GAP) {
                let of_a = world.jacobian(clearance.links[a], hit.point, &self.servos);
                let of_b = world.jacobian(clearance.links[b], hit.point, &self.servos);
                self.push_depth(hit.depth, of_a.iter().zip(of_b).map(|(a, b)| (*a - b).dot(hit.out)));
            }
        }
    }

    /// Adds three errors with the derivatives `columns`, one column per variable.
    fn push_vector(&mut self, error: DVec3, columns: &[DVec3], slack: f64) {
        for axis in 0..3 {
            self.errors.push(error[axis] / slack);
            self.rows.push(columns.iter().map(|c| c[axis] / slack).collect());
        }
    }

    /// Adds a depth, m; `columns` are the derivatives of the motion that reduces it.
    fn push_depth(&mut self, depth: f64, columns: impl Iterator<Item = f64>) {
        self.errors.push(-depth / POINT_SLACK);
        self.rows.push(columns.map(|c| c / POINT_SLACK).collect());
    }
}
