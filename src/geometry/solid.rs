//! A rigid thing as the union of its parts, for label (b).

use glam::Vec3;
use parry3d::math::Pose;
use parry3d::query::PointQuery;
use parry3d::shape::{Ball, Capsule, Cuboid};

use super::mesh::Sides;
use super::surface::{Surface, box_gap, vector};
use crate::error::{Error, Result};

/// Parts that may overlap; a point inside one of them is inside.
#[derive(Debug, Clone, Default)]
pub struct Solid {
    parts: Vec<Part>,
}

#[derive(Debug, Clone)]
struct Part {
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
    /// A solid of one mesh.
    pub fn from_mesh(surface: Surface) -> Self {
        let mut solid = Self::default();
        solid.add_mesh(surface);
        solid
    }

    /// Adds a mesh; a convex or closed one has an inside.
    pub fn add_mesh(&mut self, surface: Surface) {
        let [low, high] = surface.bounds();
        self.parts.push(Part { shape: Shape::Mesh(surface), low, high });
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

    /// Adds a box of half edges `half`, m.
    ///
    /// # Errors
    /// If an edge is not a positive length.
    pub fn add_cuboid(&mut self, half: Vec3, pose: Pose) -> Result<()> {
        check("half edge", half.to_array())?;
        let cuboid = Cuboid::new(vector(half));
        self.push(Shape::Cuboid(cuboid, pose), cuboid.aabb(&pose));
        Ok(())
    }

    /// Adds a capsule about the z axis, from -`half` to `half`, m.
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
        self.parts.push(Part { shape, low, high });
    }

    /// Signed distance of `point`, m; infinity outside beyond `cutoff`, NaN for a point that is not finite.
    ///
    /// Outside it is exact. Inside it is that of the nearest part's surface: where parts meet, less than the way out.
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

    /// Whether the inside of every part is known, or the first reason why not.
    pub fn sides(&self) -> Sides {
        let meshes = self.parts.iter().filter_map(|part| match &part.shape {
            Shape::Mesh(surface) => Some(surface.sides()),
            _ => None,
        });
        meshes.into_iter().find(|sides| !sides.is_known()).unwrap_or(Sides::Closed)
    }

    /// Number of parts.
    pub fn n_parts(&self) -> usize {
        self.parts.len()
    }
}

/// How finely a thing is sampled, and whether its inside is known.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Sampling {
    /// The thing.
    pub name: String,
    /// Points of label (a).
    pub points: usize,
    /// Longest edge between neighbouring ones, mm.
    pub spacing_mm: f64,
    /// Parts of label (b)'s surface.
    pub parts: usize,
    /// What label (b) knows about its inside; distances are at least 0 where it is none.
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

fn check<const N: usize>(name: &str, lengths: [f32; N]) -> Result<()> {
    match lengths.into_iter().find(|length| !(length.is_finite() && *length > 0.0)) {
        Some(bad) => Err(Error::value(name, "a positive number of metres", bad)),
        None => Ok(()),
    }
}
