//! Label (b): exact distance of points from a triangle mesh, negative inside.

use glam::Vec3;
use parry3d::bounding_volume::Aabb;
use parry3d::math::Vector;
use parry3d::partitioning::{Bvh, BvhBuildStrategy, BvhNode};

use super::mesh::{self, Sides};
use crate::error::{Error, Result};

/// A triangle mesh with exact signed distances.
///
/// The distance is that of the nearest triangle, computed in double precision. It is negative if the winding number,
/// computed with exact predicates, is above 0; so shells may overlap, touch or lie in one another, and triangles may
/// have no area. A mesh without a known inside ([`Surface::sides`]) has no negative distances.
#[derive(Debug, Clone)]
pub struct Surface {
    vertices: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    bvh: Bvh,
    low: Vec3,
    high: Vec3,
    sides: Sides,
}

impl Surface {
    /// Creates a surface from `vertices`, m, and `triangles`, counter-clockwise seen from outside.
    ///
    /// # Errors
    /// If there is no triangle, an index is out of range, or a coordinate is not finite or beyond
    /// [`mesh::MAX_COORDINATE`].
    pub fn new(vertices: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Result<Self> {
        mesh::check(&vertices, &triangles)?;
        if triangles.is_empty() {
            return Err(Error::value("triangles", "at least one", "none"));
        }
        let sides = mesh::sides(&vertices, &triangles);
        let boxes: Vec<Aabb> = boxes(&vertices, &triangles).collect();
        let bvh = Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes);
        let mut surface = Self { vertices, triangles, bvh, low: Vec3::ZERO, high: Vec3::ZERO, sides };
        surface.bound();
        Ok(surface)
    }

    /// Moves the vertices of a surface that bends. The sides stay, because bending neither opens nor reverses a
    /// surface.
    ///
    /// # Errors
    /// If the number of vertices differs, or a coordinate is not finite or beyond [`mesh::MAX_COORDINATE`].
    pub fn set_vertices(&mut self, vertices: &[Vec3]) -> Result<()> {
        if vertices.len() != self.vertices.len() {
            return Err(Error::shape("vertices", format!("[{}, 3]", self.vertices.len()), [vertices.len(), 3]));
        }
        mesh::check(vertices, &[])?;
        self.vertices.copy_from_slice(vertices);
        for (leaf, around) in boxes(vertices, &self.triangles).enumerate() {
            self.bvh.insert_or_update_partially(around, leaf as u32, 0.0);
        }
        self.bvh.refit_without_opt();
        self.bound();
        Ok(())
    }

    /// Returns [`Sides::Closed`] if inside and outside are known, or else the reason why not.
    pub fn sides(&self) -> Sides {
        self.sides
    }

    /// Returns the number of triangles.
    pub fn n_triangles(&self) -> usize {
        self.triangles.len()
    }

    /// Returns the lower and the upper corner of the bounding box, m.
    pub fn bounds(&self) -> [Vec3; 2] {
        [self.low, self.high]
    }

    /// Returns the signed distance of `point`, m: negative inside at any depth; infinity outside beyond `cutoff`, which
    /// is cheap to detect; NaN for a point that is not finite.
    pub fn distance(&self, point: Vec3, cutoff: f32) -> f32 {
        if !point.is_finite() {
            return f32::NAN;
        }
        if box_gap(self.low, self.high, point) > cutoff {
            return f32::INFINITY;
        }
        let near = self.unsigned(point, cutoff);
        if !self.sides.is_known() || !self.contains(point) {
            return near.unwrap_or(f32::INFINITY);
        }
        -near.or_else(|| self.unsigned(point, f32::MAX)).unwrap_or(f32::INFINITY)
    }

    /// Returns the same as [`Surface::distance`], faster, for a point beside another one whose distance is known: `beside` is
    /// that point and its distance, which must be finite. The surface is nearer than the other point's distance and the way to it,
    /// and it does not pass between two points that are closer to each other than one of them is to it.
    pub fn distance_beside(&self, point: Vec3, cutoff: f32, beside: (Vec3, f32)) -> f32 {
        /// Allowance for the rounding of distances, relative and m.
        const ROUNDING: (f32, f32) = (1e-5, 1e-6);
        if !point.is_finite() {
            return f32::NAN;
        }
        if box_gap(self.low, self.high, point) > cutoff {
            return f32::INFINITY;
        }
        let (other, known) = beside;
        let step = point.distance(other);
        let bound = (known.abs() + step) * (1.0 + ROUNDING.0) + ROUNDING.1;
        let same_side = step * (1.0 + ROUNDING.0) + ROUNDING.1 < known.abs();
        let inside = if same_side { known < 0.0 } else { self.sides.is_known() && self.contains(point) };
        // Inside, the distance counts at any depth.
        let near = self.unsigned(point, if inside { bound } else { bound.min(cutoff) });
        match (inside, near) {
            (false, near) => near.unwrap_or(f32::INFINITY),
            (true, Some(depth)) => -depth,
            (true, None) => self.distance(point, cutoff),
        }
    }

    /// Returns the winding number of the surface around `point`: 1 inside, 0 outside, more where shells overlap.
    /// Undefined unless [`Surface::sides`] is closed.
    pub fn winding(&self, point: Vec3) -> i32 {
        let meets = |node: &BvhNode| {
            let (low, high) = (node.mins(), node.maxs());
            let within = |low: f32, x: f32, high: f32| low <= x && x <= high;
            within(low.y, point.y, high.y) && within(low.z, point.z, high.z) && high.x >= point.x
        };
        let crossings = self.bvh.leaves(meets).map(|leaf| mesh::crossing(self.corners(leaf), point));
        crossings.sum()
    }

    fn contains(&self, point: Vec3) -> bool {
        point.cmpge(self.low).all() && point.cmple(self.high).all() && self.winding(point) > 0
    }

    /// Returns the distance of the nearest triangle if it is within `cutoff`.
    fn unsigned(&self, point: Vec3, cutoff: f32) -> Option<f32> {
        let at = point.as_dvec3();
        let square = |leaf: u32| mesh::distance_squared(self.corners(leaf).map(Vec3::as_dvec3), at);
        let best = self.bvh.find_best(
            (cutoff * cutoff).next_up(),
            |node, _| gap_squared(node, point),
            |leaf, _| {
                let square = square(leaf);
                Some((square as f32, square))
            },
        );
        best.map(|(_, (_, square))| square.sqrt() as f32)
    }

    fn corners(&self, triangle: u32) -> [Vec3; 3] {
        self.triangles[triangle as usize].map(|index| self.vertices[index as usize])
    }

    /// Computes the bounding box of the vertices that triangles use.
    fn bound(&mut self) {
        let used = || self.triangles.iter().flatten().map(|index| self.vertices[*index as usize]);
        let (low, high) = (used().fold(Vec3::INFINITY, Vec3::min), used().fold(Vec3::NEG_INFINITY, Vec3::max));
        (self.low, self.high) = (low, high);
    }
}

fn boxes(vertices: &[Vec3], triangles: &[[u32; 3]]) -> impl Iterator<Item = Aabb> {
    triangles.iter().map(move |triangle| {
        let [a, b, c] = triangle.map(|index| vertices[index as usize]);
        Aabb::new(vector(a.min(b).min(c)), vector(a.max(b).max(c)))
    })
}

/// Computes the squared distance of a point from a node's bounding box, m².
pub(super) fn gap_squared(node: &BvhNode, point: Vec3) -> f32 {
    let (low, high) = (node.mins(), node.maxs());
    let beyond = (Vec3::new(low.x, low.y, low.z) - point).max(point - Vec3::new(high.x, high.y, high.z));
    beyond.max(Vec3::ZERO).length_squared()
}

/// Computes the distance of a point from a box, m.
pub(super) fn box_gap(low: Vec3, high: Vec3, point: Vec3) -> f32 {
    (low - point).max(point - high).max(Vec3::ZERO).length()
}

/// Converts a vector to parry's type.
pub(super) fn vector(v: Vec3) -> Vector {
    Vector::new(v.x, v.y, v.z)
}
