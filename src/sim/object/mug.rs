//! Mugs: convex pieces for contact, a surface of revolution for the picture.

use std::f64::consts::{PI, TAU};

use glam::{DQuat, DVec3};

use super::assembly::{Object, TriangleMesh};
use super::piece::{Piece, PieceShape, hull, ring_points};
use crate::error::Result;

/// Number of convex pieces of a mug's wall.
const WALL_PIECES: usize = 20;
/// Number of capsules of a mug's handle.
const HANDLE_PIECES: usize = 7;

/// Creates a mug with its handle along +x.
///
/// # Errors
/// If a piece is degenerate.
pub(super) fn mug(radius: f64, height: f64, wall: f64) -> Result<Object> {
    let half = 0.5 * height;
    let inner = radius - wall;
    let mut pieces = Vec::new();
    let around = |angle: f64, r: f64, z: f64| DVec3::new(r * angle.cos(), r * angle.sin(), z);
    // Outer radius of a polygon whose mean radius is that of the round wall.
    let outer = radius / (PI / WALL_PIECES as f64).cos().sqrt();
    for i in 0..WALL_PIECES {
        let angles = [i, i + 1].map(|k| TAU * k as f64 / WALL_PIECES as f64);
        let corners = angles
            .into_iter()
            .flat_map(|a| [-half, half].into_iter().flat_map(move |z| [outer, inner].map(|r| around(a, r, z))));
        pieces.push(Piece::new(PieceShape::Hull(corners.collect()), DVec3::ZERO, DQuat::IDENTITY, false)?);
    }
    let floor = PieceShape::Cylinder(inner + 0.5 * wall, 0.5 * wall);
    pieces.push(Piece::new(floor, DVec3::Z * (0.5 * wall - half), DQuat::IDENTITY, false)?);

    // Handle: half an ellipse in the xz plane, from wall to wall.
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
    Ok(Object { visual: Some(mug_surface(radius, height, wall)), ..Object::free(pieces, half, outline) })
}

/// Creates the mug's body as a fine surface of revolution for the picture.
fn mug_surface(radius: f64, height: f64, wall: f64) -> TriangleMesh {
    const AROUND: usize = 48;
    let (half, inner) = (0.5 * height, radius - wall);
    let rim = 0.3 * wall;
    // Profile (r, z) from the centre of the underside around the rim to the centre of the inner floor. Corners appear
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
            // A small ring instead of a point on the axis: the engine would merge coincident vertices.
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
