//! Cost of a pose, which the solver minimises over the free coordinates u.
//!
//! ```text
//! cost(u) =   sum_vectors w huber(|to(u) - from(u) - target|)
//!           + sum_gaps    w/2 (distance(u) - target)^2
//!           + sum_k       w_k/2 (u_k - neutral_k)^2
//! huber(e) = e^2 / 2 for e <= h,  h (e - h/2) beyond
//! ```
//!
//! Positions are in the world, m. The Huber function bounds the pull of a target that is out of reach.

mod gap;

use glam::DVec3;
use nalgebra::{DMatrix, DVector};

pub use self::gap::{Gap, GapSide};

use super::robot::coupling::Coupling;
use super::robot::kinematics::{ChainJoint, chain, point_velocity};
use crate::error::Result;
use crate::mujoco::World;
use crate::mujoco::parts::Parts;

/// Point fixed to a body.
#[derive(Debug, Clone)]
struct Point {
    body: usize,
    /// Position in the body's frame, m.
    local: DVec3,
    /// Free coordinates that move it, from root to tip, each once.
    support: Vec<usize>,
    /// Joints that move it, from root to tip.
    movers: Vec<Mover>,
}

/// Joint that moves a point.
#[derive(Debug, Clone, Copy)]
struct Mover {
    joint: usize,
    /// Index of its coordinate in the point's support.
    slot: usize,
    /// Joint position per unit of the coordinate.
    ratio: f64,
    is_hinge: bool,
}

/// Vector from one point of the robot, or the origin of the world, to another, with its target.
#[derive(Debug, Clone)]
pub struct Vector {
    /// Point at its beginning; None = the origin of the world.
    pub from: Option<usize>,
    /// Point at its end.
    pub to: usize,
    /// Wanted vector, m.
    pub target: DVec3,
    /// Weight; 0 = not part of the cost.
    pub weight: f64,
    /// Error beyond which the cost grows linearly, m.
    pub huber: f64,
}

/// Terms of the cost with a workspace for their derivatives; nothing is allocated after the terms are added.
#[derive(Debug)]
pub struct Problem {
    /// Vectors to match.
    pub vectors: Vec<Vector>,
    /// Distances to keep.
    pub gaps: Vec<Gap>,
    /// Indices of the gaps with a weight above 0.
    pub active: Vec<usize>,
    /// Neutral position of each free coordinate, rad or m.
    pub neutral: Vec<f64>,
    /// Weight of each free coordinate's distance from its neutral position.
    pub neutral_weight: Vec<f64>,
    points: Vec<Point>,
    /// World position of each point, m.
    positions: Vec<DVec3>,
    /// Velocity of each point per unit of each coordinate of its support.
    columns: Vec<Vec<DVec3>>,
    /// Anchor and axis of each joint, in the world.
    axes: Vec<(DVec3, DVec3)>,
    /// For each body, the joints that move it, from the root.
    chains: Vec<Vec<ChainJoint>>,
    /// Radius of each geom's bounding sphere, m.
    radii: Vec<f64>,
    qpos: Vec<f64>,
    /// Velocity of a gap's second side relative to its first per unit of each coordinate.
    relative_velocity: Vec<DVec3>,
}

impl Problem {
    /// Creates a problem without terms for a robot.
    pub fn new(world: &World, parts: &Parts, coupling: &Coupling) -> Self {
        let chains = (0..parts.bodies.len()).map(|body| chain(parts, coupling, body)).collect();
        let n = coupling.len();
        Self {
            vectors: Vec::new(),
            gaps: Vec::new(),
            active: Vec::new(),
            neutral: vec![0.0; n],
            neutral_weight: vec![0.0; n],
            points: Vec::new(),
            positions: Vec::new(),
            columns: Vec::new(),
            axes: vec![(DVec3::ZERO, DVec3::Z); parts.joints.len()],
            chains,
            radii: parts.geoms.iter().map(|geom| geom.radius).collect(),
            qpos: world.qpos().to_vec(),
            relative_velocity: vec![DVec3::ZERO; n],
        }
    }

    /// Adds a point fixed to a body, m in the body's frame, and returns its index.
    pub fn add_point(&mut self, body: usize, local: DVec3) -> usize {
        let mut support: Vec<usize> = Vec::new();
        let mut movers = Vec::new();
        for ChainJoint { joint, coordinate, ratio, is_hinge } in self.chains[body].iter().copied() {
            let slot = support.iter().position(|c| *c == coordinate).unwrap_or(support.len());
            if slot == support.len() {
                support.push(coordinate);
            }
            movers.push(Mover { joint, slot, ratio, is_hinge });
        }
        self.columns.push(vec![DVec3::ZERO; support.len()]);
        self.positions.push(DVec3::ZERO);
        self.points.push(Point { body, local, support, movers });
        self.points.len() - 1
    }

    /// Adds a gap without weight and returns its index.
    pub fn add_gap(&mut self, sides: [GapSide; 2], at_least: bool) -> usize {
        let bodies = [0, 1].map(|k| match &sides[k] {
            GapSide::Geoms { body, .. } => *body,
            GapSide::Sphere { point, .. } => self.points[*point].body,
        });
        self.gaps.push(Gap::new(sides, bodies, at_least));
        // Room for all gaps, so that `weigh` never allocates.
        self.active.reserve(self.gaps.len());
        self.gaps.len() - 1
    }

    /// Returns the world position of a point in the pose of the last [`Self::cost`], m.
    pub fn position(&self, point: usize) -> DVec3 {
        self.positions[point]
    }

    /// Sets the weight of a gap; 0 = not part of the cost.
    pub fn weigh(&mut self, gap: usize, weight: f64) {
        let before = std::mem::replace(&mut self.gaps[gap].weight, weight) > 0.0;
        match (before, weight > 0.0) {
            (false, true) => self.active.push(gap),
            (true, false) => self.active.retain(|active| *active != gap),
            _ => {}
        }
    }

    /// Returns the cost of a pose, and leaves the robot in it.
    ///
    /// # Errors
    /// If a coordinate is not finite.
    pub fn cost(&mut self, world: &mut World, parts: &Parts, coupling: &Coupling, u: &[f64]) -> Result<f64> {
        coupling.expand(parts, u, &mut self.qpos);
        world.set_qpos(&self.qpos)?;
        world.update_poses();
        for (position, point) in self.positions.iter_mut().zip(&self.points) {
            let (origin, rotation) = world.body_pose(point.body);
            *position = origin + rotation * point.local;
        }
        let mut cost = 0.0;
        for vector in self.vectors.iter().filter(|vector| vector.weight > 0.0) {
            let error = self.error(vector).length();
            cost += vector.weight
                * if error <= vector.huber { 0.5 * error * error } else { vector.huber * (error - 0.5 * vector.huber) };
        }
        for index in &self.active {
            let gap = &mut self.gaps[*index];
            gap.measure(world, &self.positions, &self.radii);
            let error = gap.error();
            cost += 0.5 * gap.weight * error * error;
        }
        for ((position, neutral), weight) in u.iter().zip(&self.neutral).zip(&self.neutral_weight) {
            cost += 0.5 * weight * (position - neutral) * (position - neutral);
        }
        Ok(cost)
    }

    /// Computes gradient and Hessian (its lower triangle) in the pose of the last [`Self::cost`].
    ///
    /// The Hessian of vectors is exact, with the second derivatives of the points. That of gaps is the Gauss-Newton one,
    /// which leaves them out: the curvature of surfaces is not known.
    pub fn derivatives(&mut self, world: &World, u: &[f64], gradient: &mut DVector<f64>, hessian: &mut DMatrix<f64>) {
        for (joint, axis) in self.axes.iter_mut().enumerate() {
            *axis = world.joint_axis(joint);
        }
        for (index, point) in self.points.iter().enumerate() {
            let columns = &mut self.columns[index];
            columns.fill(DVec3::ZERO);
            for mover in &point.movers {
                let velocity = point_velocity(mover.is_hinge, self.axes[mover.joint], self.positions[index]);
                columns[mover.slot] += mover.ratio * velocity;
            }
        }
        gradient.fill(0.0);
        hessian.fill(0.0);
        for (k, position) in u.iter().enumerate() {
            gradient[k] = self.neutral_weight[k] * (position - self.neutral[k]);
            hessian[(k, k)] = self.neutral_weight[k];
        }
        for vector in self.vectors.iter().filter(|vector| vector.weight > 0.0) {
            self.add_vector(vector, gradient, hessian);
        }
        for k in 0..self.active.len() {
            let index = self.active[k];
            if self.gaps[index].error() != 0.0 {
                self.add_gap_terms(index, gradient, hessian);
            }
        }
    }

    /// Difference of a vector from its target, m.
    fn error(&self, vector: &Vector) -> DVec3 {
        let from = vector.from.map_or(DVec3::ZERO, |from| self.positions[from]);
        self.positions[vector.to] - from - vector.target
    }

    fn add_vector(&self, vector: &Vector, gradient: &mut DVector<f64>, hessian: &mut DMatrix<f64>) {
        let error = self.error(vector);
        let length = error.length();
        // Beyond the Huber length the pull has constant size: it curves across the error only, not along it.
        let is_far = length > vector.huber;
        let weight = vector.weight * if is_far { vector.huber / length } else { 1.0 };
        let along = if is_far { error / length } else { DVec3::ZERO };
        let ends = [(Some(vector.to), 1.0), (vector.from, -1.0)];
        let ends = || ends.iter().filter_map(|(point, sign)| Some(((*point)?, *sign)));
        for (a, sign_a) in ends() {
            let point = &self.points[a];
            for (slot, row) in point.support.iter().copied().enumerate() {
                let column = sign_a * self.columns[a][slot];
                gradient[row] += weight * column.dot(error);
                let pulled = weight * (column - along * along.dot(column));
                for (b, sign_b) in ends() {
                    for (other, col) in self.points[b].support.iter().copied().enumerate() {
                        if col <= row {
                            hessian[(row, col)] += sign_b * pulled.dot(self.columns[b][other]);
                        }
                    }
                }
            }
            self.add_curvature(a, sign_a * weight * error, hessian);
        }
    }

    /// Adds the second derivative of a point, along `pull`: for joints i before j, pull . (a_i x (a_j x arm_j)).
    fn add_curvature(&self, index: usize, pull: DVec3, hessian: &mut DMatrix<f64>) {
        let point = &self.points[index];
        for (j, second) in point.movers.iter().enumerate() {
            let velocity = point_velocity(second.is_hinge, self.axes[second.joint], self.positions[index]);
            for (i, first) in point.movers[..=j].iter().enumerate() {
                // Slides turn nothing.
                if !first.is_hinge {
                    continue;
                }
                let value = first.ratio * second.ratio * pull.dot(self.axes[first.joint].1.cross(velocity));
                let (row, col) = (point.support[first.slot], point.support[second.slot]);
                // The pairs (i, j) and (j, i) of one coordinate meet in one entry, those of two coordinates in two.
                hessian[(row.max(col), row.min(col))] += if i != j && row == col { 2.0 * value } else { value };
            }
        }
    }

    fn add_gap_terms(&mut self, index: usize, gradient: &mut DVector<f64>, hessian: &mut DMatrix<f64>) {
        let gap = &self.gaps[index];
        self.relative_velocity.fill(DVec3::ZERO);
        for (side, sign) in [(0, -1.0), (1, 1.0)] {
            for ChainJoint { joint, coordinate, ratio, is_hinge } in self.chains[gap.bodies[side]].iter().copied() {
                let velocity = point_velocity(is_hinge, self.axes[joint], gap.points[side]);
                self.relative_velocity[coordinate] += sign * ratio * velocity;
            }
        }
        let pull = gap.weight * gap.error();
        let moving = self.relative_velocity.iter().enumerate().filter(|(_, velocity)| **velocity != DVec3::ZERO);
        for (row, velocity) in moving {
            let slope = velocity.dot(gap.normal);
            gradient[row] += pull * slope;
            let lateral = gap.lateral_curvature;
            let pulled = gap.weight * (lateral * *velocity + (1.0 - lateral) * slope * gap.normal);
            for (col, other) in self.relative_velocity[..=row].iter().enumerate() {
                hessian[(row, col)] += pulled.dot(*other);
            }
        }
    }
}

impl Vector {
    /// Creates a vector without weight.
    pub fn idle(from: Option<usize>, to: usize, huber: f64) -> Self {
        Self { from, to, target: DVec3::ZERO, weight: 0.0, huber }
    }
}
