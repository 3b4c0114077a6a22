//! Label (a): a hand vertex counts as touching if the object is near, with or without pressure.
//!
//! The paper's rule is an object *vertex* within 1 cm. It depends on the mesh (a box of 8 vertices labels almost
//! nothing), so the surface is resampled first, with an explicit spacing.

use glam::Vec3;

use super::mesh;
use super::tree::{Tree, gap_squared};
use crate::error::{Error, Result};

/// Distance below which the paper labels a vertex as in contact, m.
pub const PROXIMITY: f32 = 0.01;

/// Largest spacing of the resampled object surface, m; at this value the recall of the surface rule is above 92 %.
pub const SPACING: f32 = 0.006;

/// Largest number of points that one surface is resampled to: a hundred megabytes.
const MAX_POINTS: usize = 4_000_000;

/// A surface as points at most a given spacing apart, in the frame of its object.
#[derive(Debug, Clone)]
pub struct SampledSurface {
    points: Vec<Vec3>,
    tree: Tree,
    spacing: f32,
}

impl SampledSurface {
    /// Resamples a triangle mesh.
    ///
    /// # Errors
    /// As [`resample`].
    pub fn new(vertices: &[Vec3], triangles: &[[u32; 3]], spacing: f32) -> Result<Self> {
        Self::from_points(resample(vertices, triangles, spacing)?, spacing)
    }

    /// Creates a surface from points on it that are at most `spacing` apart, m.
    ///
    /// # Errors
    /// If a point is not finite.
    pub fn from_points(points: Vec<Vec3>, spacing: f32) -> Result<Self> {
        check_points(&points)?;
        let tree = Tree::new(&points.iter().map(|point| [*point; 2]).collect::<Vec<_>>());
        Ok(Self { points, tree, spacing })
    }

    /// Moves the points of a surface that bends; number and order stay.
    ///
    /// # Errors
    /// If the number of points differs, or a point is not finite.
    pub fn set_points(&mut self, points: &[Vec3]) -> Result<()> {
        if points.len() != self.points.len() {
            return Err(Error::shape("surface points", format!("[{}, 3]", self.points.len()), [points.len(), 3]));
        }
        check_points(points)?;
        self.points.copy_from_slice(points);
        self.tree.refit(|point| [points[point as usize]; 2]);
        Ok(())
    }

    /// Returns the points, m.
    pub fn points(&self) -> &[Vec3] {
        &self.points
    }

    /// Returns the largest distance between neighbouring points, m.
    pub fn spacing(&self) -> f32 {
        self.spacing
    }

    /// Returns the distance of the nearest point, m; infinity beyond `cutoff`, NaN for a query that is not finite.
    pub fn distance(&self, query: Vec3, cutoff: f32) -> f32 {
        if !query.is_finite() {
            return f32::NAN;
        }
        let square = |point: u32, _| f64::from(self.points[point as usize].distance_squared(query));
        let nearest = self.tree.nearest(query, f64::from((cutoff * cutoff).next_up()), |_| 0.0, square);
        nearest.map_or(f32::INFINITY, |(_, square)| (square as f32).sqrt())
    }

    /// Returns true if a point of the surface lies within `distance` of `query` (object frame).
    pub fn is_within(&self, query: Vec3, distance: f32) -> bool {
        let square = distance * distance;
        let meets = |low, high| gap_squared(low, high, query) <= square;
        self.tree.any(meets, |point| self.points[point as usize].distance_squared(query) <= square)
    }
}

fn check_points(points: &[Vec3]) -> Result<()> {
    match points.iter().position(|p| !p.is_finite()) {
        Some(bad) => Err(Error::value(format!("surface point {bad}"), "finite", points[bad])),
        None => Ok(()),
    }
}

/// A point of a triangle mesh, in barycentric coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sample {
    /// Corners of the triangle.
    pub triangle: [u32; 3],
    /// Weights of the second and the third corner; the first corner has the rest to 1.
    pub weights: [f32; 2],
}

impl Sample {
    /// Returns the position of the point on a mesh of these vertices, m.
    pub(super) fn at(&self, vertices: &[Vec3]) -> Vec3 {
        let [a, b, c] = self.triangle.map(|index| vertices[index as usize]);
        a + (b - a) * self.weights[0] + (c - a) * self.weights[1]
    }
}

/// Resamples a triangle mesh: its vertices, and further points so that neighbours are at most `spacing` apart, m.
///
/// # Errors
/// If `spacing` is not a positive length, an index is out of range, a coordinate is not finite, or there would be more
/// than four million points.
pub fn resample(vertices: &[Vec3], triangles: &[[u32; 3]], spacing: f32) -> Result<Vec<Vec3>> {
    Ok(samples(vertices, triangles, spacing)?.iter().map(|sample| sample.at(vertices)).collect())
}

/// Resamples as [`resample`] and returns barycentric coordinates, which stay valid while the mesh bends.
///
/// # Errors
/// As [`resample`].
pub(super) fn samples(vertices: &[Vec3], triangles: &[[u32; 3]], spacing: f32) -> Result<Vec<Sample>> {
    if !(spacing.is_finite() && spacing > 0.0) {
        return Err(Error::value("spacing", "a positive number of metres", spacing));
    }
    mesh::check(vertices, triangles)?;
    let parts = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|index| vertices[index as usize]);
        let longest = (b - a).length().max((c - b).length()).max((a - c).length());
        // Every edge of the n x n subdivision is 1/n of an edge of the triangle.
        (longest / spacing).ceil().max(1.0)
    };
    let count: f64 = triangles.iter().map(|t| (f64::from(parts(t)) + 1.0) * (f64::from(parts(t)) + 2.0) / 2.0).sum();
    if count > MAX_POINTS as f64 {
        let expected = format!("one that gives at most {MAX_POINTS} points on this mesh");
        return Err(Error::value("spacing", expected, format!("{spacing} m, which gives {count:.0}")));
    }
    let mut points = Vec::with_capacity(count as usize);
    for triangle in triangles {
        let n = parts(triangle) as usize;
        for i in 0..=n {
            for j in 0..=n - i {
                let sample = Sample { triangle: *triangle, weights: [i as f32 / n as f32, j as f32 / n as f32] };
                points.push((sample.at(vertices).to_array().map(|x| (f64::from(x) * 1e5).round() as i64), sample));
            }
        }
    }
    // Neighbouring triangles share the points on their corners and edges.
    points.sort_by_key(|(place, _)| *place);
    points.dedup_by_key(|(place, _)| *place);
    Ok(points.into_iter().map(|(_, sample)| sample).collect())
}
