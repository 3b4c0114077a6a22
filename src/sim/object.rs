//! Objects as convex pieces: one list for the engine, for labels and for aiming.

use std::f64::consts::{PI, TAU};

use glam::{DQuat, DVec3, Vec3};
use parry3d::math::{Pose, Vector};
use parry3d::query::Ray;
use parry3d::shape::{SharedShape, TriMeshFlags};
use rand::Rng;

use super::convex::{self, double, single};
use super::scene::ShapeSpec;
use crate::error::{Error, Result};
use crate::label::SampledSurface;

/// Sides of a mug's wall.
const MUG_PIECES: usize = 20;
/// Segments of a mug's handle.
const HANDLE_PIECES: usize = 7;

/// A rigid object in its own frame: origin at the centre of its shape, z up.
#[derive(Debug, Clone)]
pub struct Object {
    /// Convex pieces.
    pub pieces: Vec<Piece>,
    /// Finer surface for the picture in place of the pieces marked as not visible: vertices and triangles.
    pub visual: Option<Surface>,
    /// Half of its height, m.
    pub half_height: f64,
    outline: SharedShape,
}

/// Vertices, m, and triangles, counter-clockwise from outside.
pub type Surface = (Vec<DVec3>, Vec<[u32; 3]>);

/// One convex piece.
#[derive(Debug, Clone)]
pub struct Piece {
    /// Its shape.
    pub shape: PieceShape,
    /// Its place in the object's frame, m.
    pub position: DVec3,
    /// Its orientation in the object's frame.
    pub orientation: DQuat,
    /// Whether the picture shows it.
    pub visible: bool,
    collider: SharedShape,
    /// Answers how far points are: a hull's triangles. For a hull itself parry searches, and near corners of pieces of a
    /// few millimetres it ended 3.6 mm off.
    gauge: SharedShape,
}

/// Shapes the engine knows; the axis of cylinder and capsule is z.
#[derive(Debug, Clone, PartialEq)]
pub enum PieceShape {
    /// Half edges.
    Box(DVec3),
    /// Radius.
    Ball(f64),
    /// Radius and half height.
    Cylinder(f64, f64),
    /// Radius and half length of the axis.
    Capsule(f64, f64),
    /// Corners of a convex hull.
    Hull(Vec<DVec3>),
}

impl Object {
    /// Draws an object of the given shape.
    ///
    /// # Errors
    /// If a hull is degenerate.
    pub fn sample(spec: &ShapeSpec, rng: &mut impl Rng) -> Result<Self> {
        let single = |shape: PieceShape, half_height: f64| -> Result<Self> {
            let piece = Piece::new(shape, DVec3::ZERO, DQuat::IDENTITY, true)?;
            let outline = piece.collider.clone();
            Ok(Self::new(vec![piece], None, half_height, outline))
        };
        match spec {
            ShapeSpec::Box { size } => {
                let half = DVec3::from_array(size.each_ref().map(|s| 0.5 * s.sample(rng)));
                single(PieceShape::Box(half), half.z)
            }
            ShapeSpec::Cube { size } => {
                let half = 0.5 * size.sample(rng);
                single(PieceShape::Box(DVec3::splat(half)), half)
            }
            ShapeSpec::Ball { radius } => {
                let radius = radius.sample(rng);
                single(PieceShape::Ball(radius), radius)
            }
            ShapeSpec::Cylinder { radius, height } => {
                let (radius, half) = (radius.sample(rng), 0.5 * height.sample(rng));
                single(PieceShape::Cylinder(radius, half), half)
            }
            ShapeSpec::Mug { radius, height, wall } => mug(radius.sample(rng), height.sample(rng), wall.sample(rng)),
        }
    }

    fn new(pieces: Vec<Piece>, visual: Option<Surface>, half_height: f64, outline: SharedShape) -> Self {
        Self { pieces, visual, half_height, outline }
    }

    /// Its convex outline: without handles, hollows filled; what a grasping hand keeps out of.
    pub fn outline(&self) -> &SharedShape {
        &self.outline
    }

    /// Volume, m³; overlaps of pieces count twice.
    pub fn volume(&self) -> f64 {
        self.pieces.iter().map(Piece::volume).sum()
    }

    /// Where a ray from outside towards `through` along `-direction` first meets the object: point and outward normal.
    pub fn surface_towards(&self, direction: DVec3, through: DVec3) -> Option<(DVec3, DVec3)> {
        const FAR: f64 = 20.0;
        let direction = direction.normalize();
        let ray = Ray::new(single(through + direction * FAR), single(-direction));
        let hits = self.pieces.iter().filter_map(|piece| {
            let hit = piece.collider.cast_ray_and_get_normal(&piece.pose(), &ray, FAR as f32, true)?;
            Some((f64::from(hit.time_of_impact), double(hit.normal)))
        });
        let (time, normal) = hits.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some((through + direction * (FAR - time), normal))
    }

    /// Signed distance of a point in the object's frame, m: exact outside, negative inside a piece.
    pub fn distance(&self, point: DVec3) -> f64 {
        let distance = |piece: &Piece| piece.gauge.distance_to_point(&piece.pose(), single(point), false);
        self.pieces.iter().map(distance).fold(f32::INFINITY, f32::min).into()
    }

    /// Its surface as points, for label (a); points inside another piece are left out.
    ///
    /// # Errors
    /// If `spacing` is not a positive length.
    pub fn sampled_surface(&self, spacing: f32) -> Result<SampledSurface> {
        let mut points = Vec::new();
        for piece in &self.pieces {
            let (vertices, triangles) = piece.mesh();
            for point in crate::label::resample(&vertices, &triangles, spacing)? {
                if self.distance(point.as_dvec3()) > -1e-4 {
                    points.push(point);
                }
            }
        }
        SampledSurface::from_points(points, spacing)
    }
}

impl Piece {
    fn new(shape: PieceShape, position: DVec3, orientation: DQuat, visible: bool) -> Result<Self> {
        let collider = match &shape {
            PieceShape::Box(half) => SharedShape::cuboid(half.x as f32, half.y as f32, half.z as f32),
            PieceShape::Ball(radius) => SharedShape::ball(*radius as f32),
            // parry's cylinders and capsules stand along y; as hulls of their own mesh they keep our axis.
            PieceShape::Cylinder(radius, half) => hull(&ring_points(*radius, *half))?,
            PieceShape::Capsule(radius, half) => {
                let end = Vector::new(0.0, 0.0, *half as f32);
                SharedShape::capsule(-end, end, *radius as f32)
            }
            PieceShape::Hull(points) => hull(points)?,
        };
        let gauge = match collider.as_convex_polyhedron() {
            Some(hull) => {
                let (vertices, triangles) = hull.to_trimesh();
                SharedShape::trimesh_with_flags(vertices, triangles, TriMeshFlags::ORIENTED)
                    .map_err(|error| Error::value("convex piece", "a closed surface", error))?
            }
            None => collider.clone(),
        };
        Ok(Self { shape, position, orientation, visible, collider, gauge })
    }

    /// Volume, m³.
    pub fn volume(&self) -> f64 {
        match &self.shape {
            PieceShape::Box(half) => 8.0 * half.x * half.y * half.z,
            PieceShape::Ball(radius) => 4.0 / 3.0 * PI * radius.powi(3),
            PieceShape::Cylinder(radius, half) => PI * radius.powi(2) * 2.0 * half,
            PieceShape::Capsule(radius, half) => PI * radius.powi(2) * (2.0 * half + 4.0 / 3.0 * radius),
            PieceShape::Hull(_) => f64::from(self.collider.mass_properties(1.0).mass()),
        }
    }

    fn pose(&self) -> Pose {
        convex::pose(self.position, self.orientation)
    }

    /// Surface in the object's frame.
    fn mesh(&self) -> (Vec<Vec3>, Vec<[u32; 3]>) {
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

fn hull(points: &[DVec3]) -> Result<SharedShape> {
    convex::hull(points)
        .ok_or_else(|| Error::value("convex piece", "points that span a volume", format!("{} points", points.len())))
}

fn ring_points(radius: f64, half: f64) -> Vec<DVec3> {
    let ring = (0..48)
        .map(|i| DVec3::new(radius * (TAU * i as f64 / 48.0).cos(), radius * (TAU * i as f64 / 48.0).sin(), 0.0));
    ring.flat_map(|p| [p - DVec3::Z * half, p + DVec3::Z * half]).collect()
}

fn mug(radius: f64, height: f64, wall: f64) -> Result<Object> {
    let half = 0.5 * height;
    let inner = radius - wall;
    let mut pieces = Vec::new();
    let around = |angle: f64, r: f64, z: f64| DVec3::new(r * angle.cos(), r * angle.sin(), z);
    // A polygon of the same mean radius as the round wall.
    let outer = radius / (PI / MUG_PIECES as f64).cos().sqrt();
    for i in 0..MUG_PIECES {
        let angles = [i, i + 1].map(|k| TAU * k as f64 / MUG_PIECES as f64);
        let corners = angles
            .into_iter()
            .flat_map(|a| [-half, half].into_iter().flat_map(move |z| [outer, inner].map(|r| around(a, r, z))));
        pieces.push(Piece::new(PieceShape::Hull(corners.collect()), DVec3::ZERO, DQuat::IDENTITY, false)?);
    }
    let floor = PieceShape::Cylinder(inner + 0.5 * wall, 0.5 * wall);
    pieces.push(Piece::new(floor, DVec3::Z * (0.5 * wall - half), DQuat::IDENTITY, false)?);

    // Handle: a half ellipse in the xz plane from wall to wall.
    let reach = 0.028;
    let tall = 0.36 * height;
    let thick = 0.0045;
    let point = |k: usize| {
        let angle = PI * (k as f64 / HANDLE_PIECES as f64 - 0.5);
        DVec3::new(radius - 0.5 * wall + reach * angle.cos(), 0.0, tall * angle.sin())
    };
    for k in 0..HANDLE_PIECES {
        let (a, b) = (point(k), point(k + 1));
        let turn = DQuat::from_rotation_arc(DVec3::Z, (b - a).normalize());
        let capsule = PieceShape::Capsule(thick, 0.5 * (b - a).length());
        pieces.push(Piece::new(capsule, 0.5 * (a + b), turn, true)?);
    }
    let outline = hull(&ring_points(radius, half))?;
    Ok(Object::new(pieces, Some(mug_surface(radius, height, wall)), half, outline))
}

/// The mug's body as a surface of revolution, finely faceted for the picture.
fn mug_surface(radius: f64, height: f64, wall: f64) -> Surface {
    const AROUND: usize = 48;
    let (half, inner) = (0.5 * height, radius - wall);
    let rim = 0.3 * wall;
    // Profile (r, z) from the middle of the underside around the rim to the middle of the inner floor. Corners appear
    // twice, close together, so that averaged normals stay sharp there.
    let profile = [
        (0.0, -half),
        (radius - 2.0 * rim, -half),
        (radius - 0.3 * rim, -half + 0.3 * rim),
        (radius, -half + 2.0 * rim),
        (radius, half - 2.0 * rim),
        (radius - 0.4 * rim, half - 0.4 * rim),
        (0.5 * (radius + inner), half),
        (inner + 0.4 * rim, half - 0.4 * rim),
        (inner, half - 2.0 * rim),
        (inner, -half + 2.0 * wall),
        (inner - 0.5 * wall, -half + 1.2 * wall),
        (inner - wall, -half + wall),
        (0.0, -half + wall),
    ];
    let mut vertices = Vec::new();
    for (r, z) in profile {
        for i in 0..AROUND {
            let angle = TAU * i as f64 / AROUND as f64;
            // The axis is a small ring, not a point: coincident vertices would be merged.
            let r = r.max(1e-4);
            vertices.push(DVec3::new(r * angle.cos(), r * angle.sin(), z));
        }
    }
    let mut triangles = Vec::new();
    for row in 0..profile.len() - 1 {
        for i in 0..AROUND {
            let at = |row: usize, i: usize| (row * AROUND + i % AROUND) as u32;
            let (a, b, c, d) = (at(row, i), at(row, i + 1), at(row + 1, i), at(row + 1, i + 1));
            triangles.push([a, b, d]);
            triangles.push([a, d, c]);
        }
    }
    (vertices, triangles)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;
    use crate::sim::span::Span;

    #[test]
    fn distances_to_a_hull_are_exact_at_its_corners_and_inside() {
        let corners = [-1.0, 1.0].map(|x| [-1.0, 1.0].map(|y| [-1.0, 1.0].map(|z| DVec3::new(x, y, z))));
        let half = DVec3::new(0.002, 0.005, 0.045);
        let corners = corners.iter().flatten().flatten().map(|corner| *corner * half).collect();
        let piece = Piece::new(PieceShape::Hull(corners), DVec3::X * 0.03, DQuat::IDENTITY, true).unwrap();
        let outline = piece.collider.clone();
        let object = Object::new(vec![piece], None, half.z, outline);
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
                    let gap = piece.gauge.distance_to_point(&piece.pose(), single(vertex.as_dvec3()), false);
                    // Facets of a round surface lie a little inside of it.
                    assert!(gap.abs() < 1e-3, "{spec:?}: {gap} m from {:?}", piece.shape);
                }
            }
        }
    }
}
