//! Label (b): exact distance of points from a triangle mesh, negative inside.

use glam::Vec3;

use super::disc::Disc;
use super::mesh::{self, Sides};
use super::tree::Tree;
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
    tree: Tree,
    /// Disc around each triangle, and around each leaf of the tree.
    discs: Vec<Disc>,
    leaves: Vec<Disc>,
    low: Vec3,
    high: Vec3,
    sides: Sides,
}

/// A point whose distance from a surface is known, for [`Surface::distance_beside`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Beside {
    /// The point, m.
    point: Vec3,
    /// Its signed distance, m.
    distance: f32,
    /// The triangle that is nearest to it.
    triangle: u32,
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
        let boxes: Vec<[Vec3; 2]> = triangles.iter().map(|triangle| around(&vertices, *triangle)).collect();
        let tree = Tree::new(&boxes);
        let (discs, leaves) = (Vec::new(), vec![Disc::EVERYTHING; tree.n_leaves()]);
        let mut surface = Self { vertices, triangles, tree, discs, leaves, low: Vec3::ZERO, high: Vec3::ZERO, sides };
        surface.bound();
        Ok(surface)
    }

    /// Returns vertices, m, and triangles.
    pub fn mesh(&self) -> (&[Vec3], &[[u32; 3]]) {
        (&self.vertices, &self.triangles)
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
        self.tree.refit(|triangle| around(vertices, self.triangles[triangle as usize]));
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
        let near = self.unsigned(point, cutoff, None);
        let distance = |found: Option<(f32, u32)>| found.map_or(f32::INFINITY, |(distance, _)| distance);
        if !self.sides.is_known() || !self.contains(point) {
            return distance(near);
        }
        -distance(near.or_else(|| self.unsigned(point, f32::MAX, None)))
    }

    /// Returns the same as [`Surface::distance`], faster, for one of many points that lie beside each other: `beside` is the point
    /// of the call before, and becomes this one. The surface is nearer than the other point's distance and the way to it,
    /// at most as far as the triangle that is nearest to the other point,
    /// and it does not pass between two points that are closer to each other than one of them is to it.
    pub fn distance_beside(&self, point: Vec3, cutoff: f32, beside: &mut Option<Beside>) -> f32 {
        let before = beside.take();
        /// Allowance for the rounding of distances, relative and m.
        const ROUNDING: (f32, f32) = (1e-5, 1e-6);
        if !point.is_finite() {
            return f32::NAN;
        }
        if box_gap(self.low, self.high, point) > cutoff {
            return f32::INFINITY;
        }
        let same_side =
            |other: &Beside| point.distance(other.point) * (1.0 + ROUNDING.0) + ROUNDING.1 < other.distance.abs();
        let inside = match before.as_ref().filter(|other| same_side(other)) {
            Some(other) => other.distance < 0.0,
            None => self.sides.is_known() && self.contains(point),
        };
        let bound = before.as_ref().map_or(f32::MAX, |other| {
            (other.distance.abs() + point.distance(other.point)) * (1.0 + ROUNDING.0) + ROUNDING.1
        });
        // Inside, the distance counts at any depth.
        let most = if inside { bound } else { bound.min(cutoff) };
        let Some((distance, triangle)) = self.unsigned(point, most, before.map(|other| other.triangle)) else {
            return if inside { self.distance(point, cutoff) } else { f32::INFINITY };
        };
        let distance = if inside { -distance } else { distance };
        *beside = Some(Beside { point, distance, triangle });
        distance
    }

    /// Returns the winding number of the surface around `point`: 1 inside, 0 outside, more where shells overlap.
    /// Undefined unless [`Surface::sides`] is closed.
    pub fn winding(&self, point: Vec3) -> i32 {
        let meets = |low: Vec3, high: Vec3| {
            let within = |low: f32, x: f32, high: f32| low <= x && x <= high;
            within(low.y, point.y, high.y) && within(low.z, point.z, high.z) && high.x >= point.x
        };
        let mut winding = 0;
        self.tree.any(meets, |triangle| {
            winding += mesh::crossing(self.corners(triangle), point);
            false
        });
        winding
    }

    fn contains(&self, point: Vec3) -> bool {
        point.cmpge(self.low).all() && point.cmple(self.high).all() && self.winding(point) > 0
    }

    /// Returns distance and index of the nearest triangle if it is within `cutoff`; `guess` is a triangle that may be near.
    fn unsigned(&self, point: Vec3, cutoff: f32, guess: Option<u32>) -> Option<(f32, u32)> {
        let at = point.as_dvec3();
        let square = |triangle: u32, best: f64| {
            if self.discs[triangle as usize].least_square(point) > best {
                return f64::INFINITY;
            }
            let [a, b, c] = self.corners(triangle);
            mesh::distance_squared([a.as_dvec3(), b.as_dvec3(), c.as_dvec3()], at)
        };
        let most = f64::from((cutoff * cutoff).next_up());
        let guess = guess.map(|triangle| (triangle, square(triangle, most))).filter(|(_, square)| *square < most);
        let leaf = |leaf: usize| self.leaves[leaf].least_square(point);
        let nearest = self.tree.nearest(point, guess.map_or(most, |(_, square)| square), leaf, square).or(guess);
        nearest.map(|(triangle, square)| (square.sqrt() as f32, triangle))
    }

    #[inline]
    fn corners(&self, triangle: u32) -> [Vec3; 3] {
        self.triangles[triangle as usize].map(|index| self.vertices[index as usize])
    }

    /// Computes the bounding box of the vertices that triangles use, and the discs.
    fn bound(&mut self) {
        let of = |triangle: u32| self.corners(triangle);
        let discs = (0..self.triangles.len() as u32).map(|triangle| Disc::around(&[of(triangle)])).collect();
        let leaf = |(number, items): (usize, &[u32])| {
            let corners: Vec<[Vec3; 3]> = items.iter().map(|triangle| of(*triangle)).collect();
            (number, Disc::around(&corners))
        };
        let leaves: Vec<(usize, Disc)> = self.tree.leaves().map(leaf).collect();
        self.discs = discs;
        leaves.into_iter().for_each(|(number, disc)| self.leaves[number] = disc);
        let used = || self.triangles.iter().flatten().map(|index| self.vertices[*index as usize]);
        let (low, high) = (used().fold(Vec3::INFINITY, Vec3::min), used().fold(Vec3::NEG_INFINITY, Vec3::max));
        (self.low, self.high) = (low, high);
    }
}

/// Returns the lower and the upper corner of the box around a triangle.
fn around(vertices: &[Vec3], triangle: [u32; 3]) -> [Vec3; 2] {
    let [a, b, c] = triangle.map(|index| vertices[index as usize]);
    [a.min(b).min(c), a.max(b).max(c)]
}

/// Computes the distance of a point from a box, m.
pub(super) fn box_gap(low: Vec3, high: Vec3, point: Vec3) -> f32 {
    (low - point).max(point - high).max(Vec3::ZERO).length()
}
