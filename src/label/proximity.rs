//! Label (a): a vertex counts as touching when the object is near, whether it is pressed or not.
//!
//! It is the paper's rule: an object *vertex* within 1 cm. It depends on how finely the object is meshed (a box of 8
//! vertices yields next to no label), so the surface is resampled first, with the spacing as an explicit number.

use glam::Vec3;

use crate::error::{Error, Result};

/// Distance below which the paper calls a vertex in contact, m.
pub const PROXIMITY: f32 = 0.01;

/// Spacing of the resampled object surface at most, m: recall of the surface rule is above 92 %.
pub const SPACING: f32 = 0.006;

/// Most points a surface is resampled to: 50 MB; more is a spacing chosen for a smaller object.
const MOST_POINTS: f64 = 4e6;

/// A surface as points no farther apart than a given spacing, in the frame of its object.
#[derive(Debug, Clone)]
pub struct SampledSurface {
    points: Vec<Vec3>,
    low: Vec3,
    high: Vec3,
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

    /// Takes points that lie on a surface no farther apart than `spacing`.
    ///
    /// # Errors
    /// If a point is not finite.
    pub fn from_points(points: Vec<Vec3>, spacing: f32) -> Result<Self> {
        if let Some(bad) = points.iter().position(|p| !p.is_finite()) {
            return Err(Error::value(format!("surface point {bad}"), "finite", points[bad]));
        }
        let low = points.iter().copied().fold(Vec3::INFINITY, Vec3::min);
        let high = points.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
        Ok(Self { points, low, high, spacing })
    }

    /// The points, m.
    pub fn points(&self) -> &[Vec3] {
        &self.points
    }

    /// Longest edge between neighbouring points, m.
    pub fn spacing(&self) -> f32 {
        self.spacing
    }

    /// Whether a point of the surface lies within `distance` of `query` (object frame).
    pub fn is_within(&self, query: Vec3, distance: f32) -> bool {
        let outside = (self.low - query).max(query - self.high).max(Vec3::ZERO);
        outside.length_squared() <= distance * distance
            && self.points.iter().any(|point| point.distance_squared(query) <= distance * distance)
    }
}

/// Points on a triangle mesh: its vertices, and as many more that no triangle edge between them exceeds `spacing`.
///
/// # Errors
/// If `spacing` is not a positive length or gives more than 4 million points, an index is out of range, or a coordinate is
/// not finite.
pub fn resample(vertices: &[Vec3], triangles: &[[u32; 3]], spacing: f32) -> Result<Vec<Vec3>> {
    if !(spacing.is_finite() && spacing > 0.0) {
        return Err(Error::value("spacing", "a positive number of metres", spacing));
    }
    if let Some(bad) = vertices.iter().position(|v| !v.is_finite()) {
        return Err(Error::value(format!("vertex {bad}"), "finite", vertices[bad]));
    }
    let corners = triangles.iter().map(|triangle| corners(vertices, triangle)).collect::<Result<Vec<_>>>()?;
    // Every edge of the n x n subdivision is 1/n of an edge of the triangle.
    let subdivision = |[a, b, c]: &[Vec3; 3]| {
        let [a, b, c] = [a, b, c].map(|corner| corner.as_dvec3());
        let longest = (b - a).length().max((c - b).length()).max((a - c).length());
        (longest / f64::from(spacing)).ceil().max(1.0)
    };
    let count: f64 = corners.iter().map(&subdivision).map(|n| 0.5 * (n + 1.0) * (n + 2.0)).sum();
    if count > MOST_POINTS {
        let least = f64::from(spacing) * (count / MOST_POINTS).sqrt();
        return Err(Error::value("spacing", format!("at least {least:.1e} m for a surface of this size"), spacing));
    }
    let mut points = Vec::with_capacity(count as usize);
    for triangle in &corners {
        let ([a, b, c], n) = (*triangle, subdivision(triangle) as usize);
        for i in 0..=n {
            for j in 0..=n - i {
                points.push(a + (b - a) * (i as f32 / n as f32) + (c - a) * (j as f32 / n as f32));
            }
        }
    }
    // Triangles share corners and edges; once is enough.
    let key = |p: &Vec3| p.to_array().map(|x| (x * 1e5).round() as i64);
    points.sort_unstable_by_key(key);
    points.dedup_by_key(|p| key(p));
    Ok(points)
}

fn corners(vertices: &[Vec3], triangle: &[u32; 3]) -> Result<[Vec3; 3]> {
    let mut corners = [Vec3::ZERO; 3];
    for (corner, index) in corners.iter_mut().zip(triangle) {
        *corner = *vertices
            .get(*index as usize)
            .ok_or_else(|| Error::value("triangle index", format!("below {}", vertices.len()), index))?;
    }
    Ok(corners)
}
