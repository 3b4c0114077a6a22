//! Convex pieces of objects.

use std::f64::consts::{PI, TAU};

use glam::{DQuat, DVec3, Vec3};
use parry3d::math::{Pose, Vector};
use parry3d::query::Ray;
use parry3d::shape::{SharedShape, TriMeshFlags};

use crate::error::{Error, Result};
use crate::sim::convex::{self, double, single};

/// Convex piece.
#[derive(Debug, Clone)]
pub struct Piece {
    /// Shape.
    pub shape: PieceShape,
    /// Position in the object frame, m.
    pub position: DVec3,
    /// Orientation in the object frame.
    pub orientation: DQuat,
    /// True if the picture shows the piece.
    pub visible: bool,
    /// Shape for collision queries.
    pub(super) collider: SharedShape,
    /// Shape for distance queries: the triangles of a hull. parry's own search on hulls was 3.6 mm off near the corners
    /// of pieces of a few millimetres.
    distance_shape: SharedShape,
}

/// Shapes of the engine, lengths in m; the axis of cylinder and capsule is z.
#[derive(Debug, Clone, PartialEq)]
pub enum PieceShape {
    /// Cuboid: half edges.
    Box(DVec3),
    /// Ball: radius.
    Ball(f64),
    /// Cylinder: radius and half height.
    Cylinder(f64, f64),
    /// Capsule: radius and half length of the axis.
    Capsule(f64, f64),
    /// Convex hull: corners.
    Hull(Vec<DVec3>),
}

impl Piece {
    /// Creates a piece.
    ///
    /// # Errors
    /// If the shape spans no volume.
    pub(super) fn new(shape: PieceShape, position: DVec3, orientation: DQuat, visible: bool) -> Result<Self> {
        let collider = match &shape {
            PieceShape::Box(half) => SharedShape::cuboid(half.x as f32, half.y as f32, half.z as f32),
            PieceShape::Ball(radius) => SharedShape::ball(*radius as f32),
            // parry's cylinders stand along y; as hulls they keep our axis.
            PieceShape::Cylinder(radius, half) => hull(&ring_points(*radius, *half))?,
            PieceShape::Capsule(radius, half) => {
                let end = Vector::new(0.0, 0.0, *half as f32);
                SharedShape::capsule(-end, end, *radius as f32)
            }
            PieceShape::Hull(points) => hull(points)?,
        };
        let distance_shape = match collider.as_convex_polyhedron() {
            Some(hull) => {
                let (vertices, triangles) = hull.to_trimesh();
                SharedShape::trimesh_with_flags(vertices, triangles, TriMeshFlags::ORIENTED)
                    .map_err(|error| Error::value("convex piece", "a closed surface", error))?
            }
            None => collider.clone(),
        };
        Ok(Self { shape, position, orientation, visible, collider, distance_shape })
    }

    /// Returns the volume, m³.
    pub(crate) fn volume(&self) -> f64 {
        match &self.shape {
            PieceShape::Box(half) => 8.0 * half.x * half.y * half.z,
            PieceShape::Ball(radius) => 4.0 / 3.0 * PI * radius.powi(3),
            PieceShape::Cylinder(radius, half) => PI * radius.powi(2) * 2.0 * half,
            PieceShape::Capsule(radius, half) => PI * radius.powi(2) * (2.0 * half + 4.0 / 3.0 * radius),
            PieceShape::Hull(_) => f64::from(self.collider.mass_properties(1.0).mass()),
        }
    }

    /// Returns half the smallest extent along the axes of the shape, m.
    pub(crate) fn half_thickness(&self) -> f64 {
        match &self.shape {
            PieceShape::Box(half) => half.min_element(),
            PieceShape::Ball(radius) | PieceShape::Capsule(radius, _) => *radius,
            PieceShape::Cylinder(radius, half) => radius.min(*half),
            PieceShape::Hull(corners) => {
                let low = corners.iter().copied().reduce(DVec3::min).unwrap_or_default();
                let high = corners.iter().copied().reduce(DVec3::max).unwrap_or_default();
                0.5 * (high - low).min_element()
            }
        }
    }

    /// Returns the first hit of a ray up to `far`, m: distance along the ray, m, and outward unit normal.
    pub(super) fn cast_ray(&self, ray: &Ray, far: f64) -> Option<(f64, DVec3)> {
        let hit = self.collider.cast_ray_and_get_normal(&self.pose(), ray, far as f32, true)?;
        Some((f64::from(hit.time_of_impact), double(hit.normal)))
    }

    /// Returns the signed distance of a point in the object frame, m.
    pub(super) fn distance(&self, point: DVec3) -> f64 {
        self.distance_shape.distance_to_point(&self.pose(), single(point), false).into()
    }

    /// Returns the pose in the object frame.
    pub(super) fn pose(&self) -> Pose {
        convex::pose(self.position, self.orientation)
    }

    /// Returns the surface in the object frame: vertices, m, and triangles.
    pub fn mesh(&self) -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let (vertices, triangles) = if let Some(cuboid) = self.collider.as_cuboid() {
            cuboid.to_trimesh()
        } else if let Some(ball) = self.collider.as_ball() {
            ball.to_trimesh(32, 16)
        } else if let Some(capsule) = self.collider.as_capsule() {
            capsule.to_trimesh(12, 6)
        } else if let Some(hull) = self.collider.as_convex_polyhedron() {
            hull.to_trimesh()
        } else {
            (Vec::new(), Vec::new())
        };
        let pose = self.pose();
        let place = |v: &Vector| {
            let p = pose * *v;
            Vec3::new(p.x, p.y, p.z)
        };
        (vertices.iter().map(place).collect(), triangles)
    }
}

/// Computes the convex hull of points.
///
/// # Errors
/// If they span no volume.
pub(super) fn hull(points: &[DVec3]) -> Result<SharedShape> {
    convex::hull(points)
        .ok_or_else(|| Error::value("convex piece", "points that span a volume", format!("{} points", points.len())))
}

/// Returns the corners of an upright cylinder as a prism of 48 sides.
pub(super) fn ring_points(radius: f64, half: f64) -> Vec<DVec3> {
    let ring = (0..48)
        .map(|i| DVec3::new(radius * (TAU * i as f64 / 48.0).cos(), radius * (TAU * i as f64 / 48.0).sin(), 0.0));
    ring.flat_map(|p| [p - DVec3::Z * half, p + DVec3::Z * half]).collect()
}
