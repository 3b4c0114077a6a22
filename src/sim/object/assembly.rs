//! Objects as assemblies of convex pieces: one geometry for the engine, the labels and the contact goals.

use glam::DVec3;
use parry3d::math::Pose;
use parry3d::query::Ray;
use parry3d::shape::SharedShape;

use super::piece::{Piece, PieceShape};
use crate::error::Result;
use crate::geometry::{SampledSurface, Solid};
use crate::sim::convex::single;

/// Object in its own frame: origin at the centre of its shape, z up.
#[derive(Debug, Clone)]
pub struct Object {
    /// Convex pieces of the moving part.
    pub pieces: Vec<Piece>,
    /// Convex pieces of the fixed part, in the object frame at the start.
    pub base: Vec<Piece>,
    /// Mount of the moving part.
    pub mount: Mount,
    /// Finer surface for the picture; it replaces the pieces that are not visible.
    pub visual: Option<TriangleMesh>,
    /// Height of the origin above the lowest point, m.
    pub half_height: f64,
    /// Convex outline of the moving part.
    pub(super) outline: SharedShape,
}

/// Mount of an object.
#[derive(Debug, Clone, PartialEq)]
pub enum Mount {
    /// No mount: only contact holds the object.
    Free,
    /// One joint to the fixed part.
    Joint(JointMount),
    /// No mount, and the shape deforms: an elastic ball.
    Soft {
        /// Radius at rest, m.
        radius: f64,
        /// Young's modulus, Pa.
        stiffness: f64,
        /// Points of the surface along each edge of the cube that it is made from.
        points: usize,
    },
}

/// Hinge or slide.
#[derive(Debug, Clone, PartialEq)]
pub struct JointMount {
    /// Type in MJCF: `hinge` or `slide`.
    pub kind: &'static str,
    /// Unit axis in the object frame.
    pub axis: DVec3,
    /// Point on the axis, m.
    pub anchor: DVec3,
    /// Limits, rad or m.
    pub range: [f64; 2],
    /// Stiffness of the spring, N m/rad or N/m; 0 = no spring.
    pub stiffness: f64,
    /// Damping, N m s/rad or N s/m.
    pub damping: f64,
    /// Dry friction, N m or N.
    pub friction: f64,
}

/// Vertices, m, and triangles, counter-clockwise seen from outside.
pub type TriangleMesh = (Vec<DVec3>, Vec<[u32; 3]>);

impl Object {
    /// Creates an object without mount and fixed part.
    pub(super) fn free(pieces: Vec<Piece>, half_height: f64, outline: SharedShape) -> Self {
        Self { pieces, base: Vec::new(), mount: Mount::Free, visual: None, half_height, outline }
    }

    /// Returns the convex outline of the moving part: without handles, hollows filled.
    pub(crate) fn outline(&self) -> &SharedShape {
        &self.outline
    }

    /// Returns the obstacles for a hand if the object is at `pose`: the outline, and the fixed part.
    pub(crate) fn obstacles(&self, pose: &Pose) -> Vec<(SharedShape, Pose)> {
        let base = self.base.iter().map(|piece| (piece.collider.clone(), *pose * piece.pose()));
        std::iter::once((self.outline.clone(), *pose)).chain(base).collect()
    }

    /// Casts a ray from outside along `-direction` to `through`; returns the first point on the moving part, m, and the
    /// outward unit normal there.
    pub(crate) fn surface_towards(&self, direction: DVec3, through: DVec3) -> Option<(DVec3, DVec3)> {
        // Beyond any object: meshes extend up to 20 m, from their centre up to 10 m per axis.
        const FAR: f64 = 20.0;
        let direction = direction.normalize();
        let ray = Ray::new(single(through + direction * FAR), single(-direction));
        let hits = self.pieces.iter().filter_map(|piece| piece.cast_ray(&ray, FAR));
        let (time, normal) = hits.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some((through + direction * (FAR - time), normal))
    }

    /// Returns the signed distance of a point in the object frame from the moving part, m: exact outside, negative
    /// inside a piece.
    pub fn distance(&self, point: DVec3) -> f64 {
        self.pieces.iter().map(|piece| piece.distance(point)).fold(f64::INFINITY, f64::min)
    }

    /// Returns the signed distance of a point from the fixed part, in the object frame at the start, m; infinite
    /// without one.
    pub(crate) fn base_distance(&self, point: DVec3) -> f64 {
        self.base.iter().map(|piece| piece.distance(point)).fold(f64::INFINITY, f64::min)
    }

    /// Samples the surface of the moving part for label (a); points inside another piece are left out.
    ///
    /// # Errors
    /// If `spacing` is not a positive length.
    pub(crate) fn sampled_surface(&self, spacing: f32) -> Result<SampledSurface> {
        sampled(&self.pieces, spacing)
    }

    /// Returns the moving part for label (b): round pieces and boxes exactly, hulls as their triangles.
    ///
    /// # Errors
    /// If a piece has no extent.
    pub(crate) fn solid(&self) -> Result<Solid> {
        solid(&self.pieces)
    }

    /// Returns the fixed part for label (b); empty without one.
    ///
    /// # Errors
    /// If a piece has no extent.
    pub(crate) fn base_solid(&self) -> Result<Solid> {
        solid(&self.base)
    }

    /// Samples the surface of the fixed part for label (a); `None` without one.
    ///
    /// # Errors
    /// If `spacing` is not a positive length.
    pub(crate) fn sampled_base(&self, spacing: f32) -> Result<Option<SampledSurface>> {
        if self.base.is_empty() { Ok(None) } else { sampled(&self.base, spacing).map(Some) }
    }
}

fn sampled(pieces: &[Piece], spacing: f32) -> Result<SampledSurface> {
    let mut points = Vec::new();
    for piece in pieces {
        let (vertices, triangles) = piece.mesh();
        for point in crate::geometry::resample(&vertices, &triangles, spacing)? {
            if pieces.iter().all(|piece| piece.distance(point.as_dvec3()) > -1e-4) {
                points.push(point);
            }
        }
    }
    SampledSurface::from_points(points, spacing)
}

fn solid(pieces: &[Piece]) -> Result<Solid> {
    let mut solid = Solid::default();
    for piece in pieces {
        match &piece.shape {
            PieceShape::Box(half) => solid.add_cuboid(half.as_vec3(), piece.pose())?,
            PieceShape::Ball(radius) => solid.add_ball(*radius as f32, piece.pose())?,
            PieceShape::Capsule(radius, half) => solid.add_capsule(*half as f32, *radius as f32, piece.pose())?,
            PieceShape::Cylinder(..) | PieceShape::Hull(_) => {
                let (vertices, triangles) = piece.mesh();
                solid.add_mesh(crate::geometry::Surface::new(vertices, triangles)?);
            }
        }
    }
    Ok(solid)
}
