//! A rigid object as a union of shapes, for label (b).

use glam::Vec3;
use parry3d::math::{Pose, Vector};
use parry3d::query::PointQuery;
use parry3d::shape::{Ball, Capsule, Cuboid};

use super::mesh::Sides;
use super::surface::{Surface, box_gap};
use crate::error::{Error, Result};

/// Union of shapes that may overlap; a point inside of one shape is inside of the solid.
#[derive(Debug, Clone, Default)]
pub struct Solid {
    parts: Vec<BoundedShape>,
}

/// A shape with its bounding box.
#[derive(Debug, Clone)]
struct BoundedShape {
    shape: Shape,
    low: Vec3,
    high: Vec3,
}

#[derive(Debug, Clone)]
enum Shape {
    Mesh(Surface),
    Ball(Ball, Pose),
    Cuboid(Cuboid, Pose),
    Capsule(Capsule, Pose),
}

impl Solid {
    /// Creates a solid from one mesh.
    pub fn from_mesh(surface: Surface) -> Self {
        let mut solid = Self::default();
        solid.add_mesh(surface);
        solid
    }

    /// Returns vertices, m, and triangles of a solid that is one mesh.
    pub fn mesh(&self) -> Option<(&[Vec3], &[[u32; 3]])> {
        match self.parts.as_slice() {
            [BoundedShape { shape: Shape::Mesh(surface), .. }] => Some(surface.mesh()),
            _ => None,
        }
    }

    /// Adds a mesh.
    pub fn add_mesh(&mut self, surface: Surface) {
        let [low, high] = surface.bounds();
        self.parts.push(BoundedShape { shape: Shape::Mesh(surface), low, high });
    }

    /// Adds a ball of `radius`, m.
    ///
    /// # Errors
    /// If the radius is not a positive length.
    pub fn add_ball(&mut self, radius: f32, pose: Pose) -> Result<()> {
        check("radius", [radius])?;
        let around = Ball::new(radius).aabb(&pose);
        self.push(Shape::Ball(Ball::new(radius), pose), around);
        Ok(())
    }

    /// Adds a box with half edges `half`, m.
    ///
    /// # Errors
    /// If an edge is not a positive length.
    pub fn add_cuboid(&mut self, half: Vec3, pose: Pose) -> Result<()> {
        check("half edge", half.to_array())?;
        let cuboid = Cuboid::new(vector(half));
        self.push(Shape::Cuboid(cuboid, pose), cuboid.aabb(&pose));
        Ok(())
    }

    /// Adds a capsule around the z axis from -`half` to `half`, m.
    ///
    /// # Errors
    /// If a length is not positive.
    pub fn add_capsule(&mut self, half: f32, radius: f32, pose: Pose) -> Result<()> {
        check("half length and radius", [half, radius])?;
        let end = vector(Vec3::Z * half);
        let capsule = Capsule::new(-end, end, radius);
        self.push(Shape::Capsule(capsule, pose), capsule.aabb(&pose));
        Ok(())
    }

    fn push(&mut self, shape: Shape, around: parry3d::bounding_volume::Aabb) {
        let [low, high] = [around.mins, around.maxs].map(|v| Vec3::new(v.x, v.y, v.z));
        self.parts.push(BoundedShape { shape, low, high });
    }

    /// Returns the signed distance of `point`, m; infinity outside beyond `cutoff`, NaN for a point that is not finite.
    ///
    /// The distance is exact outside. Inside it is the depth below the surface of one shape, a lower bound of the depth
    /// where shapes overlap.
    pub fn distance(&self, point: Vec3, cutoff: f32) -> f32 {
        if !point.is_finite() {
            return f32::NAN;
        }
        let mut nearest = f32::INFINITY;
        for part in &self.parts {
            let reach = cutoff.min(nearest.max(0.0));
            if box_gap(part.low, part.high, point) <= reach {
                nearest = nearest.min(part.shape.distance(point, reach));
            }
        }
        if nearest <= cutoff { nearest } else { f32::INFINITY }
    }

    /// Returns false if no point of a ball is within `reach`, m, of the solid; true proves nothing.
    pub fn may_reach(&self, centre: Vec3, radius: f32, reach: f32) -> bool {
        self.parts.iter().any(|part| box_gap(part.low, part.high, centre) <= radius + reach)
    }

    /// Returns [`Sides::Closed`] if the inside of every shape is known, or else the first reason why not.
    pub fn sides(&self) -> Sides {
        let meshes = self.parts.iter().filter_map(|part| match &part.shape {
            Shape::Mesh(surface) => Some(surface.sides()),
            _ => None,
        });
        meshes.into_iter().find(|sides| !sides.is_known()).unwrap_or(Sides::Closed)
    }

    /// Returns the number of shapes.
    pub fn n_parts(&self) -> usize {
        self.parts.len()
    }
}

/// Sampling density of an object for label (a), and its sides for label (b).
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Sampling {
    /// Name of the object.
    pub name: String,
    /// Number of points for label (a).
    pub points: usize,
    /// Largest distance between neighbouring points, mm.
    pub spacing_mm: f64,
    /// Number of shapes for label (b).
    pub parts: usize,
    /// Sides for label (b); without a known inside, distances are never negative.
    pub sides: Sides,
}

impl Shape {
    fn distance(&self, point: Vec3, cutoff: f32) -> f32 {
        let p = vector(point);
        match self {
            Self::Mesh(surface) => surface.distance(point, cutoff),
            Self::Ball(ball, pose) => ball.distance_to_point(pose, p, false),
            Self::Cuboid(cuboid, pose) => cuboid.distance_to_point(pose, p, false),
            Self::Capsule(capsule, pose) => capsule.distance_to_point(pose, p, false),
        }
    }
}

/// Validates lengths.
fn check<const N: usize>(name: &str, lengths: [f32; N]) -> Result<()> {
    match lengths.into_iter().find(|length| !(length.is_finite() && *length > 0.0)) {
        Some(bad) => Err(Error::value(name, "a positive number of metres", bad)),
        None => Ok(()),
    }
}

/// Converts a vector to parry's type.
fn vector(v: Vec3) -> Vector {
    Vector::new(v.x, v.y, v.z)
}
