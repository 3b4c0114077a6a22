//! Distance between two sets of geoms, or two spheres, as a term of the cost.

use glam::DVec3;

use crate::mujoco::World;

/// Distance above its target at which a gap that asks for "at least" its target is no longer measured, m: such a gap costs
/// nothing, and measuring is what takes time.
const AT_LEAST_RANGE: f64 = 0.005;
/// Greatest distance that is measured otherwise, m: more than a hand's width.
const RANGE: f64 = 0.3;

/// Two sides whose distance is part of the cost.
#[derive(Debug, Clone)]
pub struct Gap {
    /// The two sides.
    pub sides: [GapSide; 2],
    /// Wanted distance of the surfaces, m; negative = penetration.
    pub target: f64,
    /// Weight; 0 = not part of the cost.
    pub weight: f64,
    /// True if a greater distance than `target` costs nothing.
    pub at_least: bool,
    /// Body that moves each side, for the Jacobian.
    pub(super) bodies: [usize; 2],
    /// Distance of the surfaces in the last measured pose, m; negative = penetration, infinite = out of range.
    pub(super) distance: f64,
    /// Nearest points of the two sides in the world, m.
    pub(super) points: [DVec3; 2],
    /// Unit direction from the first side to the second, in the world.
    pub(super) normal: DVec3,
    /// Curvature of the distance across `normal`, relative to that along it, 0 to 1. It is 1 for two points that are to
    /// coincide, whose normal may have any direction, and 0 for surfaces, whose curvature is not known.
    pub(super) lateral_curvature: f64,
}

/// Side of a gap.
#[derive(Debug, Clone)]
pub enum GapSide {
    /// Geoms that move together.
    Geoms {
        /// Body that moves them.
        body: usize,
        /// Indices of the geoms.
        geoms: Vec<usize>,
    },
    /// Sphere about a point.
    Sphere {
        /// Index of the point in the problem.
        point: usize,
        /// Radius, m.
        radius: f64,
    },
}

impl Gap {
    /// Creates a gap without weight; `bodies`: those that move the two sides.
    pub(super) fn new(sides: [GapSide; 2], bodies: [usize; 2], at_least: bool) -> Self {
        Self {
            sides,
            target: 0.0,
            weight: 0.0,
            at_least,
            bodies,
            distance: f64::INFINITY,
            points: [DVec3::ZERO; 2],
            normal: DVec3::Z,
            lateral_curvature: 0.0,
        }
    }

    /// Returns the geoms of both sides; None if a side is a sphere.
    pub fn geoms(&self) -> Option<[&[usize]; 2]> {
        match &self.sides {
            [GapSide::Geoms { geoms: a, .. }, GapSide::Geoms { geoms: b, .. }] => Some([a, b]),
            _ => None,
        }
    }

    /// Difference of the measured distance from the target, m; 0 if it costs nothing.
    pub(super) fn error(&self) -> f64 {
        let error = self.distance - self.target;
        match (self.at_least && error > 0.0) || !error.is_finite() {
            true => 0.0,
            false => error,
        }
    }

    /// Measures distance, nearest points and normal. `positions`: of the problem's points, m; `radii`: of each geom's
    /// bounding sphere, m.
    pub(super) fn measure(&mut self, world: &mut World, positions: &[DVec3], radii: &[f64]) {
        self.distance = f64::INFINITY;
        match self.sides {
            [GapSide::Sphere { point: a, radius: ra }, GapSide::Sphere { point: b, radius: rb }] => {
                self.measure_spheres([positions[a], positions[b]], [ra, rb]);
            }
            [GapSide::Geoms { .. }, GapSide::Geoms { .. }] => self.measure_geoms(world, radii),
            // A sphere and geoms have no common distance function: such a gap never counts.
            _ => {}
        }
    }

    fn measure_spheres(&mut self, [a, b]: [DVec3; 2], [ra, rb]: [f64; 2]) {
        let line = b - a;
        self.distance = line.length() - ra - rb;
        self.lateral_curvature = ((self.distance - self.target) / line.length().max(1e-9)).clamp(0.0, 1.0);
        self.normal = line.try_normalize().unwrap_or(DVec3::Z);
        self.points = [a + ra * self.normal, b - rb * self.normal];
    }

    fn measure_geoms(&mut self, world: &mut World, radii: &[f64]) {
        let [GapSide::Geoms { geoms: first, .. }, GapSide::Geoms { geoms: second, .. }] = &self.sides else { return };
        let range = if self.at_least { self.target + AT_LEAST_RANGE } else { RANGE };
        for (a, b) in first.iter().flat_map(|a| second.iter().map(move |b| (*a, *b))) {
            let limit = range.min(self.distance);
            let apart = world.geom_pose(a).0.distance(world.geom_pose(b).0) - radii[a] - radii[b];
            if apart > limit {
                continue;
            }
            let (distance, points) = world.geom_distance([a, b], limit);
            let Some(points) = points.filter(|_| distance < self.distance) else { continue };
            self.distance = distance;
            self.points = points;
            // Where geoms penetrate each other, the line between the nearest points runs from the second to the first.
            let line = points[1] - points[0];
            let direction = if distance < 0.0 { -line } else { line };
            self.normal = direction
                .try_normalize()
                .unwrap_or_else(|| (world.geom_pose(b).0 - world.geom_pose(a).0).try_normalize().unwrap_or(DVec3::Z));
        }
    }
}
