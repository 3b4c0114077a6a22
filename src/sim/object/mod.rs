//! Objects as convex pieces: one list for the engine, for labels and for aiming.

mod fixture;
mod mesh;
mod mug;
mod piece;

use glam::{DQuat, DVec3};
use parry3d::math::Pose;
use parry3d::query::Ray;
use parry3d::shape::SharedShape;
use rand::Rng;

pub(super) use mesh::faults as mesh_faults;
pub use piece::{Piece, PieceShape};

use super::convex::single;
use super::scene::ShapeSpec;
use crate::error::Result;
use crate::geometry::{SampledSurface, Solid};

/// An object in its own frame: origin at the centre of its shape, z up.
#[derive(Debug, Clone)]
pub struct Object {
    /// Convex pieces of the part that moves.
    pub pieces: Vec<Piece>,
    /// Convex pieces of the part that stands fast, in the same frame at the start.
    pub base: Vec<Piece>,
    /// What holds the moving part.
    pub mount: Mount,
    /// Finer surface for the picture in place of the pieces marked as not visible: vertices and triangles.
    pub visual: Option<Surface>,
    /// Height of its origin above what it stands on, m.
    pub half_height: f64,
    outline: SharedShape,
}

/// What holds an object.
#[derive(Debug, Clone, PartialEq)]
pub enum Mount {
    /// Nothing.
    Free,
    /// One joint to its base.
    Joint(JointMount),
    /// Nothing, and its shape gives way: a ball of the given radius, m, and Young's modulus, Pa.
    Soft {
        /// Radius at rest, m.
        radius: f64,
        /// Young's modulus, Pa.
        stiffness: f64,
    },
}

/// A hinge or slide.
#[derive(Debug, Clone, PartialEq)]
pub struct JointMount {
    /// `hinge` or `slide`.
    pub kind: &'static str,
    /// Unit axis in the object's frame.
    pub axis: DVec3,
    /// A point on the axis, m.
    pub anchor: DVec3,
    /// Limits, rad or m.
    pub range: [f64; 2],
    /// Stiffness of its spring, N m/rad or N/m; 0 is none.
    pub stiffness: f64,
    /// Damping, N m s/rad or N s/m.
    pub damping: f64,
    /// Torque or force that just moves it, N m or N.
    pub friction: f64,
}

/// Vertices, m, and triangles, counter-clockwise from outside.
pub type Surface = (Vec<DVec3>, Vec<[u32; 3]>);

impl Object {
    /// Draws an object of the given shape.
    ///
    /// # Errors
    /// If a hull is degenerate, or a mesh file can't be read.
    pub fn sample(spec: &ShapeSpec, rng: &mut impl Rng) -> Result<Self> {
        match spec {
            ShapeSpec::Box { size } => {
                let half = DVec3::from_array(size.each_ref().map(|s| 0.5 * s.sample(rng)));
                Self::simple(PieceShape::Box(half), half.z)
            }
            ShapeSpec::Cube { size } => {
                let half = 0.5 * size.sample(rng);
                Self::simple(PieceShape::Box(DVec3::splat(half)), half)
            }
            ShapeSpec::Ball { radius } => {
                let radius = radius.sample(rng);
                Self::simple(PieceShape::Ball(radius), radius)
            }
            ShapeSpec::Cylinder { radius, height } => {
                let (radius, half) = (radius.sample(rng), 0.5 * height.sample(rng));
                Self::simple(PieceShape::Cylinder(radius, half), half)
            }
            ShapeSpec::Mug { radius, height, wall } => {
                mug::mug(radius.sample(rng), height.sample(rng), wall.sample(rng))
            }
            ShapeSpec::Button { radius, travel, stiffness } => {
                fixture::button(radius.sample(rng), travel.sample(rng), stiffness.sample(rng))
            }
            ShapeSpec::Knob { radius, height, resistance } => {
                fixture::knob(radius.sample(rng), height.sample(rng), resistance.sample(rng))
            }
            ShapeSpec::Door { width, height, thickness, resistance } => {
                let [width, height, thickness] = [width, height, thickness].map(|span| span.sample(rng));
                fixture::door(width, height, thickness, resistance.sample(rng))
            }
            ShapeSpec::Soft { radius, stiffness } => {
                let (radius, stiffness) = (radius.sample(rng), stiffness.sample(rng));
                let ball = Self::simple(PieceShape::Ball(radius), radius)?;
                Ok(Self { mount: Mount::Soft { radius, stiffness }, ..ball })
            }
            ShapeSpec::Mesh { file, scale } => mesh::mesh(file, scale.sample(rng)),
        }
    }

    fn simple(shape: PieceShape, half_height: f64) -> Result<Self> {
        let piece = Piece::new(shape, DVec3::ZERO, DQuat::IDENTITY, true)?;
        let outline = piece.collider.clone();
        Ok(Self::free(vec![piece], half_height, outline))
    }

    fn free(pieces: Vec<Piece>, half_height: f64, outline: SharedShape) -> Self {
        Self { pieces, base: Vec::new(), mount: Mount::Free, visual: None, half_height, outline }
    }

    /// Convex outline of its moving part: without handles, hollows filled.
    pub fn outline(&self) -> &SharedShape {
        &self.outline
    }

    /// What a hand keeps out of when the object is at `pose`: its outline, and the part that stands fast.
    pub fn obstacles(&self, pose: &Pose) -> Vec<(SharedShape, Pose)> {
        let base = self.base.iter().map(|piece| (piece.collider.clone(), *pose * piece.pose()));
        std::iter::once((self.outline.clone(), *pose)).chain(base).collect()
    }

    /// Volume of the moving part, m³; overlaps of pieces count twice.
    pub fn volume(&self) -> f64 {
        self.pieces.iter().map(Piece::volume).sum()
    }

    /// Where a ray from outside towards `through` along `-direction` first meets the moving part: point and outward
    /// normal.
    pub fn surface_towards(&self, direction: DVec3, through: DVec3) -> Option<(DVec3, DVec3)> {
        const FAR: f64 = 20.0;
        let direction = direction.normalize();
        let ray = Ray::new(single(through + direction * FAR), single(-direction));
        let hits = self.pieces.iter().filter_map(|piece| piece.meet(&ray, FAR));
        let (time, normal) = hits.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some((through + direction * (FAR - time), normal))
    }

    /// Signed distance of a point in the object's frame from the moving part, m: exact outside, negative inside a
    /// piece.
    pub fn distance(&self, point: DVec3) -> f64 {
        self.pieces.iter().map(|piece| piece.distance(point)).fold(f64::INFINITY, f64::min)
    }

    /// As [`Self::distance`], from the part that stands fast, in the object's frame at the start; infinite without one.
    pub fn base_distance(&self, point: DVec3) -> f64 {
        self.base.iter().map(|piece| piece.distance(point)).fold(f64::INFINITY, f64::min)
    }

    /// Surface of the moving part as points, for label (a); points inside another piece are left out.
    ///
    /// # Errors
    /// If `spacing` is not a positive length.
    pub fn sampled_surface(&self, spacing: f32) -> Result<SampledSurface> {
        sampled(&self.pieces, spacing)
    }

    /// The moving part for label (b): round pieces and boxes exactly, hulls as their triangles.
    ///
    /// # Errors
    /// If a piece has no extent.
    pub fn solid(&self) -> Result<Solid> {
        solid(&self.pieces)
    }

    /// As [`Self::solid`], of the part that stands fast; empty where there is none.
    ///
    /// # Errors
    /// If a piece has no extent.
    pub fn base_solid(&self) -> Result<Solid> {
        solid(&self.base)
    }

    /// Surface of the part that stands fast; `None` where there is none.
    ///
    /// # Errors
    /// If `spacing` is not a positive length.
    pub fn sampled_base(&self, spacing: f32) -> Result<Option<SampledSurface>> {
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

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;
    use crate::sim::range::Span;

    #[test]
    fn distances_to_a_hull_are_exact_at_its_corners_and_inside() {
        let corners = [-1.0, 1.0].map(|x| [-1.0, 1.0].map(|y| [-1.0, 1.0].map(|z| DVec3::new(x, y, z))));
        let half = DVec3::new(0.002, 0.005, 0.045);
        let corners = corners.iter().flatten().flatten().map(|corner| *corner * half).collect();
        let piece = Piece::new(PieceShape::Hull(corners), DVec3::X * 0.03, DQuat::IDENTITY, true).unwrap();
        let outline = piece.collider.clone();
        let object = Object::free(vec![piece], half.z, outline);
        for (from_centre, distance) in [
            (half + DVec3::splat(1e-3), 3f64.sqrt() * 1e-3),
            (half + DVec3::X * 1e-5, 1e-5),
            (DVec3::ZERO, -half.x),
            (half - DVec3::splat(5e-4), -5e-4),
        ] {
            let got = object.distance(DVec3::X * 0.03 + from_centre);
            assert!((got - distance).abs() < 1e-6, "{from_centre}: {got} m instead of {distance} m");
        }
    }

    #[test]
    fn no_piece_samples_points_beside_itself() {
        let fixed = Span::fixed;
        let shapes = [
            ShapeSpec::Cube { size: fixed(0.04) },
            ShapeSpec::Ball { radius: fixed(0.03) },
            ShapeSpec::Cylinder { radius: fixed(0.02), height: fixed(0.1) },
            ShapeSpec::Mug { radius: fixed(0.035), height: fixed(0.09), wall: fixed(0.004) },
        ];
        for spec in shapes {
            let object = Object::sample(&spec, &mut rand_chacha::ChaCha8Rng::seed_from_u64(1)).unwrap();
            for piece in &object.pieces {
                let (vertices, _) = piece.mesh();
                assert!(!vertices.is_empty());
                for vertex in vertices {
                    let gap = piece.distance(vertex.as_dvec3());
                    // Facets of a round surface lie a little inside of it.
                    assert!(gap.abs() < 1e-3, "{spec:?}: {gap} m from {:?}", piece.shape);
                }
            }
        }
    }
}
