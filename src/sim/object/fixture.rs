//! Objects with a fixed part and one that moves on a joint: button, knob, door.

use glam::{DQuat, DVec3};
use parry3d::shape::SharedShape;

use super::assembly::{JointMount, Mount, Object};
use super::piece::{Piece, PieceShape};
use crate::error::Result;

/// Height of the fixed part below a button or knob, m.
const HOUSING_HEIGHT: f64 = 0.025;
/// Gap between a moving and a fixed part, m.
const PART_GAP: f64 = 0.0015;

/// Creates a round button on a housing; a spring holds it up, and it sinks by at most `travel`.
///
/// # Errors
/// If a piece is degenerate.
pub(super) fn button(radius: f64, travel: f64, stiffness: f64) -> Result<Object> {
    // It protrudes from its housing by its travel and 3 mm, and reaches as deep into it.
    let half = travel + 0.003;
    let cap = solid(PieceShape::Cylinder(radius, half), DVec3::ZERO)?;
    let outline = cap.collider.clone();
    let wide = radius + 0.01;
    let housing =
        solid(PieceShape::Box(DVec3::new(wide, wide, 0.5 * HOUSING_HEIGHT)), -DVec3::Z * 0.5 * HOUSING_HEIGHT)?;
    // Critical damping of a cap of about 10 g: it returns without ringing.
    let damping = 2.0 * (0.02 * stiffness).sqrt();
    let joint = JointMount {
        kind: "slide",
        axis: DVec3::Z,
        anchor: DVec3::ZERO,
        range: [-travel, 0.0],
        stiffness,
        damping,
        friction: 0.0,
    };
    Ok(fixture(vec![cap], vec![housing], joint, HOUSING_HEIGHT, outline))
}

/// Creates a knob on a plate; a ridge on its top shows its angle.
///
/// # Errors
/// If a piece is degenerate.
pub(super) fn knob(radius: f64, height: f64, resistance: f64) -> Result<Object> {
    let half = 0.5 * height;
    let body = solid(PieceShape::Cylinder(radius, half), DVec3::ZERO)?;
    let outline = body.collider.clone();
    let ridge = PieceShape::Box(DVec3::new(0.45 * radius, 0.12 * radius, 0.0015));
    let ridge = solid(ridge, DVec3::new(0.5 * radius, 0.0, half + 0.0015))?;
    let wide = radius + 0.012;
    let plate = solid(
        PieceShape::Box(DVec3::new(wide, wide, 0.5 * HOUSING_HEIGHT)),
        -DVec3::Z * (half + PART_GAP + 0.5 * HOUSING_HEIGHT),
    )?;
    let joint = JointMount {
        kind: "hinge",
        axis: DVec3::Z,
        anchor: DVec3::ZERO,
        range: [-2.6, 2.6],
        stiffness: 0.0,
        damping: 0.02 * resistance.max(0.005),
        friction: resistance,
    };
    Ok(fixture(vec![body, ridge], vec![plate], joint, half + PART_GAP + HOUSING_HEIGHT, outline))
}

/// Creates a door whose leaf swings both ways about its edge at -x, beside a post.
///
/// # Errors
/// If a piece is degenerate.
pub(super) fn door(width: f64, height: f64, thickness: f64, resistance: f64) -> Result<Object> {
    let half = DVec3::new(0.5 * width, 0.5 * thickness, 0.5 * height);
    let leaf = solid(PieceShape::Box(half), DVec3::ZERO)?;
    let outline = leaf.collider.clone();
    let post = PieceShape::Box(DVec3::new(0.006, 0.006f64.max(half.y), half.z + 0.5 * PART_GAP));
    let post = solid(post, DVec3::new(-half.x - 0.008, 0.0, -0.5 * PART_GAP))?;
    let joint = JointMount {
        kind: "hinge",
        axis: DVec3::Z,
        anchor: -DVec3::X * half.x,
        range: [-1.7, 1.7],
        stiffness: 0.0,
        damping: 0.05 * resistance.max(0.01),
        friction: resistance,
    };
    Ok(fixture(vec![leaf], vec![post], joint, half.z + PART_GAP, outline))
}

/// Creates a visible piece.
fn solid(shape: PieceShape, position: DVec3) -> Result<Piece> {
    Piece::new(shape, position, DQuat::IDENTITY, true)
}

/// Creates an object with fixed pieces `base`.
fn fixture(pieces: Vec<Piece>, base: Vec<Piece>, joint: JointMount, half_height: f64, outline: SharedShape) -> Object {
    Object { base, mount: Mount::Joint(joint), ..Object::free(pieces, half_height, outline) }
}
