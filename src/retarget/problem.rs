//! What the solver makes small: lengths and directions between points of the robot, distances of its links, joints off
//! their neutral positions.
//!
//! cost(u) = sum of weight * huber(|to - from - target|) + 1/2 weight (distance - target)^2 + 1/2 weight (u - neutral)^2

use glam::DVec3;
use nalgebra::{DMatrix, DVector};

use super::robot::coupling::{Coupling, Driven};
use crate::error::Result;
use crate::mujoco::World;
use crate::mujoco::parts::{Motion, Parts};

/// A point fixed to a body.
#[derive(Debug, Clone)]
pub struct Point {
    body: usize,
    local: DVec3,
    /// The free coordinates that move it, from root to tip, each once.
    support: Vec<usize>,
    /// Joints that move it, from root to tip.
    joints: Vec<Mover>,
}

/// A joint that moves a point.
#[derive(Debug, Clone, Copy)]
struct Mover {
    joint: usize,
    /// Position of its coordinate in the point's support.
    slot: usize,
    ratio: f64,
    is_hinge: bool,
}

/// One vector to match: from one point (or the world's origin) to another.
#[derive(Debug, Clone)]
pub struct Vector {
    /// The point at its beginning; None = the origin of the world.
    pub from: Option<usize>,
    /// The point at its end.
    pub to: usize,
    /// What it shall be, m.
    pub target: DVec3,
    /// Weight; 0 = it does not count.
    pub weight: f64,
    /// Length of error from which on it counts linearly, m.
    pub huber: f64,
}

/// Two sets of geoms that shall have a distance.
#[derive(Debug, Clone)]
pub struct Gap {
    /// The two sides.
    pub sides: [Side; 2],
    /// Distance of the surfaces, m; negative = inside each other.
    pub target: f64,
    /// Weight; 0 = it does not count.
    pub weight: f64,
    /// Whether more distance is as good.
    pub at_least: bool,
    /// Bodies that move the two sides, for the Jacobian.
    movers: [usize; 2],
    distance: f64,
    /// Share of the sideways motion that counts like that along the normal: all of it for points that are to meet, where
    /// the normal may have any direction; 0 for surfaces, whose curvature is not known.
    sideways: f64,
    normal: DVec3,
    points: [DVec3; 2],
}

/// One side of a gap: geoms, or where there are none a sphere about a point.
#[derive(Debug, Clone)]
pub enum Side {
    /// Geoms of one part.
    Geoms {
        /// The body that stands for the part.
        body: usize,
        /// The geoms.
        geoms: Vec<usize>,
    },
    /// A sphere about a point.
    Sphere {
        /// The point.
        point: usize,
        /// Radius, m.
        radius: f64,
    },
}

/// All that counts, with room for its derivatives; nothing is allocated after it is made.
#[derive(Debug)]
pub struct Problem {
    /// Points that vectors run between.
    pub points: Vec<Point>,
    /// Vectors to match.
    pub vectors: Vec<Vector>,
    /// Distances to keep.
    pub gaps: Vec<Gap>,
    /// The gaps that count, by their index.
    pub active: Vec<usize>,
    /// Position each free coordinate leans to.
    pub neutral: Vec<f64>,
    /// How strongly.
    pub neutral_weight: Vec<f64>,
    /// World position of each point.
    places: Vec<DVec3>,
    /// Velocity of each point per unit of each coordinate of its support.
    columns: Vec<Vec<DVec3>>,
    /// Anchor and axis of each joint.
    axes: Vec<(DVec3, DVec3)>,
    /// For each body, the joints that move it as (joint, coordinate, ratio, is a hinge), from the root.
    chains: Vec<Vec<(usize, usize, f64, bool)>>,
    /// Radius of the sphere about each geom, m.
    radii: Vec<f64>,
    qpos: Vec<f64>,
    /// Velocity of a gap's one side against the other per unit of each coordinate.
    apart: Vec<DVec3>,
}

impl Problem {
    /// An empty problem on a robot.
    pub fn new(world: &World, parts: &Parts, coupling: &Coupling) -> Self {
        let chains = (0..parts.bodies.len()).map(|body| chain(parts, coupling, body)).collect();
        let n = coupling.len();
        Self {
            points: Vec::new(),
            vectors: Vec::new(),
            gaps: Vec::new(),
            active: Vec::new(),
            neutral: vec![0.0; n],
            neutral_weight: vec![0.0; n],
            places: Vec::new(),
            columns: Vec::new(),
            axes: vec![(DVec3::ZERO, DVec3::Z); parts.joints.len()],
            chains,
            radii: parts.geoms.iter().map(|geom| geom.radius).collect(),
            qpos: world.qpos().to_vec(),
            apart: vec![DVec3::ZERO; n],
        }
    }

    /// Adds a point fixed to a body and returns its index.
    pub fn add_point(&mut self, body: usize, local: DVec3) -> usize {
        let mut support: Vec<usize> = Vec::new();
        let mut joints = Vec::new();
        for (joint, coordinate, ratio, is_hinge) in self.chains[body].iter().copied() {
            let slot = support.iter().position(|c| *c == coordinate).unwrap_or(support.len());
            if slot == support.len() {
                support.push(coordinate);
            }
            joints.push(Mover { joint, slot, ratio, is_hinge });
        }
        self.columns.push(vec![DVec3::ZERO; support.len()]);
        self.places.push(DVec3::ZERO);
        self.points.push(Point { body, local, support, joints });
        self.points.len() - 1
    }

    /// Adds two sides that shall have a distance, without weight, and returns its index.
    pub fn add_gap(&mut self, sides: [Side; 2], at_least: bool) -> usize {
        let movers = [0, 1].map(|k| match &sides[k] {
            Side::Geoms { body, .. } => *body,
            Side::Sphere { point, .. } => self.points[*point].body,
        });
        self.gaps.push(Gap {
            sides,
            target: 0.0,
            weight: 0.0,
            at_least,
            movers,
            distance: f64::INFINITY,
            sideways: 0.0,
            normal: DVec3::Z,
            points: [DVec3::ZERO; 2],
        });
        // Room for all, so that none has to be made later.
        self.active.reserve(self.gaps.len());
        self.gaps.len() - 1
    }

    /// World position of a point as of the last [`Self::cost`].
    pub fn place(&self, point: usize) -> DVec3 {
        self.places[point]
    }

    /// Has a gap count with a weight; 0 = not at all.
    pub fn weigh(&mut self, gap: usize, weight: f64) {
        let before = std::mem::replace(&mut self.gaps[gap].weight, weight) > 0.0;
        match (before, weight > 0.0) {
            (false, true) => self.active.push(gap),
            (true, false) => self.active.retain(|active| *active != gap),
            _ => {}
        }
    }

    /// The cost of a pose; leaves the robot in it.
    ///
    /// # Errors
    /// If a coordinate is not finite.
    pub fn cost(&mut self, world: &mut World, parts: &Parts, coupling: &Coupling, u: &[f64]) -> Result<f64> {
        coupling.expand(parts, u, &mut self.qpos);
        world.set_qpos(&self.qpos)?;
        world.update_poses();
        for (place, point) in self.places.iter_mut().zip(&self.points) {
            let (origin, rotation) = world.body_pose(point.body);
            *place = origin + rotation * point.local;
        }
        let mut cost = 0.0;
        for vector in self.vectors.iter().filter(|vector| vector.weight > 0.0) {
            let error = self.error(vector).length();
            cost += vector.weight
                * if error <= vector.huber { 0.5 * error * error } else { vector.huber * (error - 0.5 * vector.huber) };
        }
        for index in &self.active {
            let gap = &mut self.gaps[*index];
            gap.distance = f64::INFINITY;
            gap.measure(world, &self.places, &self.radii);
            let error = gap.error();
            cost += 0.5 * gap.weight * error * error;
        }
        for ((position, neutral), weight) in u.iter().zip(&self.neutral).zip(&self.neutral_weight) {
            cost += 0.5 * weight * (position - neutral) * (position - neutral);
        }
        Ok(cost)
    }

    /// Gradient and Hessian (its lower triangle) at the pose of the last [`Self::cost`]. The curvature of joints' arcs
    /// counts for vectors; for distances only what the distance itself changes by.
    pub fn derivatives(&mut self, world: &World, u: &[f64], gradient: &mut DVector<f64>, hessian: &mut DMatrix<f64>) {
        for (joint, axis) in self.axes.iter_mut().enumerate() {
            *axis = world.joint_axis(joint);
        }
        for (index, point) in self.points.iter().enumerate() {
            let columns = &mut self.columns[index];
            columns.fill(DVec3::ZERO);
            for mover in &point.joints {
                let (anchor, axis) = self.axes[mover.joint];
                let velocity = if mover.is_hinge { axis.cross(self.places[index] - anchor) } else { axis };
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

    fn error(&self, vector: &Vector) -> DVec3 {
        let from = vector.from.map_or(DVec3::ZERO, |from| self.places[from]);
        self.places[vector.to] - from - vector.target
    }

    fn add_vector(&self, vector: &Vector, gradient: &mut DVector<f64>, hessian: &mut DMatrix<f64>) {
        let error = self.error(vector);
        let length = error.length();
        // Beyond the Huber length the pull is constant: it curves sideways only.
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

    /// What a point's second derivative along `pull` adds: for joints i before j, pull . (a_i x (a_j x arm_j)).
    fn add_curvature(&self, index: usize, pull: DVec3, hessian: &mut DMatrix<f64>) {
        let point = &self.points[index];
        for (j, second) in point.joints.iter().enumerate() {
            let (anchor, axis) = self.axes[second.joint];
            let velocity = if second.is_hinge { axis.cross(self.places[index] - anchor) } else { axis };
            for (i, first) in point.joints[..=j].iter().enumerate() {
                if !first.is_hinge || (i == j && !second.is_hinge) {
                    continue;
                }
                let value = first.ratio * second.ratio * pull.dot(self.axes[first.joint].1.cross(velocity));
                let (row, col) = (point.support[first.slot], point.support[second.slot]);
                hessian[(row.max(col), row.min(col))] += if i != j && row == col { 2.0 * value } else { value };
            }
        }
    }

    fn add_gap_terms(&mut self, index: usize, gradient: &mut DVector<f64>, hessian: &mut DMatrix<f64>) {
        let gap = &self.gaps[index];
        self.apart.fill(DVec3::ZERO);
        for (side, sign) in [(0, -1.0), (1, 1.0)] {
            for (joint, coordinate, ratio, is_hinge) in self.chains[gap.movers[side]].iter().copied() {
                let (anchor, axis) = self.axes[joint];
                let velocity = if is_hinge { axis.cross(gap.points[side] - anchor) } else { axis };
                self.apart[coordinate] += sign * ratio * velocity;
            }
        }
        let pull = gap.weight * gap.error();
        for (row, velocity) in self.apart.iter().enumerate().filter(|(_, velocity)| **velocity != DVec3::ZERO) {
            let slope = velocity.dot(gap.normal);
            gradient[row] += pull * slope;
            let counted = gap.weight * (gap.sideways * *velocity + (1.0 - gap.sideways) * slope * gap.normal);
            for (col, other) in self.apart[..=row].iter().enumerate() {
                hessian[(row, col)] += counted.dot(*other);
            }
        }
    }
}

impl Vector {
    /// One that does not count yet.
    pub fn idle(from: Option<usize>, to: usize, huber: f64) -> Self {
        Self { from, to, target: DVec3::ZERO, weight: 0.0, huber }
    }
}

impl Gap {
    /// The geoms of both sides; None where one is a sphere.
    pub fn geoms(&self) -> Option<[&[usize]; 2]> {
        match &self.sides {
            [Side::Geoms { geoms: a, .. }, Side::Geoms { geoms: b, .. }] => Some([a, b]),
            _ => None,
        }
    }

    /// What the distance lacks (negative) or has too much.
    fn error(&self) -> f64 {
        let error = self.distance - self.target;
        match (self.at_least && error > 0.0) || !error.is_finite() {
            true => 0.0,
            false => error,
        }
    }

    /// Finds distance, nearest points and the direction from the first side to the second.
    fn measure(&mut self, world: &mut World, places: &[DVec3], radii: &[f64]) {
        // Distances beyond this make no difference to a term that asks for at least less.
        let most = if self.at_least { self.target + 0.005 } else { 0.3 };
        let ball = |side: &Side| match side {
            Side::Sphere { point, radius } => Some((places[*point], *radius)),
            Side::Geoms { .. } => None,
        };
        if let (Some((a, ra)), Some((b, rb))) = (ball(&self.sides[0]), ball(&self.sides[1])) {
            let line = b - a;
            self.distance = line.length() - ra - rb;
            self.sideways = ((self.distance - self.target) / line.length().max(1e-9)).clamp(0.0, 1.0);
            self.normal = line.try_normalize().unwrap_or(DVec3::Z);
            self.points = [a + ra * self.normal, b - rb * self.normal];
            return;
        }
        let (Side::Geoms { geoms: first, .. }, Side::Geoms { geoms: second, .. }) = (&self.sides[0], &self.sides[1])
        else {
            return;
        };
        for a in first {
            for b in second {
                let limit = most.min(self.distance);
                let apart = world.geom_pose(*a).0.distance(world.geom_pose(*b).0) - radii[*a] - radii[*b];
                if apart > limit {
                    continue;
                }
                let (distance, points) = world.geom_distance([*a, *b], limit);
                let Some(points) = points.filter(|_| distance < self.distance) else { continue };
                self.distance = distance;
                self.points = points;
                // Inside each other the nearest points run the other way.
                let line = points[1] - points[0];
                let direction = if distance < 0.0 { -line } else { line };
                self.normal = direction.try_normalize().unwrap_or_else(|| {
                    (world.geom_pose(*b).0 - world.geom_pose(*a).0).try_normalize().unwrap_or(DVec3::Z)
                });
            }
        }
    }
}

/// Joints that move a body, from the root.
fn chain(parts: &Parts, coupling: &Coupling, body: usize) -> Vec<(usize, usize, f64, bool)> {
    let mut bodies = Vec::new();
    let mut at = body;
    while at != 0 {
        bodies.push(at);
        at = parts.bodies[at].parent;
    }
    let mut chain = Vec::new();
    for body in bodies.into_iter().rev() {
        for (index, joint) in parts.joints.iter().enumerate().filter(|(_, joint)| joint.body == body) {
            if let Driven::By { coordinate, ratio, .. } = coupling.joints[index] {
                chain.push((index, coordinate, ratio, joint.motion == Motion::Hinge));
            }
        }
    }
    chain
}

/// Velocity of a world point of a body per unit of each free coordinate, and the body's rotation, as columns.
pub fn jacobian(
    world: &World,
    parts: &Parts,
    coupling: &Coupling,
    body: usize,
    place: DVec3,
) -> Vec<(usize, DVec3, DVec3)> {
    let column = |(joint, coordinate, ratio, is_hinge): (usize, usize, f64, bool)| {
        let (anchor, axis) = world.joint_axis(joint);
        match is_hinge {
            true => (coordinate, ratio * axis.cross(place - anchor), ratio * axis),
            false => (coordinate, ratio * axis, DVec3::ZERO),
        }
    };
    chain(parts, coupling, body).into_iter().map(column).collect()
}
