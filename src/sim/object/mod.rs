//! Objects of scenes, drawn from their shape specifications.

mod assembly;
mod fixture;
mod mesh;
mod mug;
mod piece;

use glam::{DQuat, DVec3};
use rand::Rng;

pub use assembly::{JointMount, Mount, Object, TriangleMesh};
pub(crate) use mesh::load as load_mesh;
pub use mesh::{mesh_faults, try_mesh};
pub use piece::{Piece, PieceShape};

use super::scene::ShapeSpec;
use crate::error::Result;

impl Object {
    /// Draws an object of the given shape.
    ///
    /// # Errors
    /// If a convex piece is degenerate, or a mesh file cannot be read.
    pub(crate) fn sample(spec: &ShapeSpec, rng: &mut impl Rng) -> Result<Self> {
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
                let [width, height, thickness] = [width, height, thickness].map(|range| range.sample(rng));
                fixture::door(width, height, thickness, resistance.sample(rng))
            }
            ShapeSpec::Soft { radius, stiffness, points } => {
                let (radius, stiffness, points) = (radius.sample(rng), stiffness.sample(rng), *points);
                let ball = Self::simple(PieceShape::Ball(radius), radius)?;
                Ok(Self { mount: Mount::Soft { radius, stiffness, points }, ..ball })
            }
            ShapeSpec::Mesh { file, scale } => mesh::mesh(file, scale.sample(rng)),
        }
    }

    /// Creates a free object of one piece.
    fn simple(shape: PieceShape, half_height: f64) -> Result<Self> {
        let piece = Piece::new(shape, DVec3::ZERO, DQuat::IDENTITY, true)?;
        let outline = piece.collider.clone();
        Ok(Self::free(vec![piece], half_height, outline))
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;
    use crate::sim::range::UniformRange;

    #[test]
    fn distance_to_a_hull_is_exact_at_corners_and_inside() {
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
    fn mesh_vertices_of_pieces_lie_on_their_surfaces() {
        let fixed = UniformRange::fixed;
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
                    // Facets of a round surface lie slightly inside it.
                    assert!(gap.abs() < 1e-3, "{spec:?}: {gap} m from {:?}", piece.shape);
                }
            }
        }
    }
}
