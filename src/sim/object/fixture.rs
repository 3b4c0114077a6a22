//! Objects with a part that stands fast and one that moves on a joint: button, knob, door.

use glam::{DQuat, DVec3};
use parry3d::shape::SharedShape;

use super::piece::{Piece, PieceShape};
use super::{JointMount, Mount, Object};
use crate::error::Result;

/// Height of a button's or knob's housing, m.
const HOUSING: f64 = 0.025;
/// Gap between a part that moves and one that stands fast, m.
const GAP: f64 = 0.0015;

/// A round button on a housing; a spring holds it up, and it sinks by at most `travel`.
///
/// # Errors
/// If a piece is degenerate.
pub(super) fn button(radius: f64, travel: f64, stiffness: f64) -> Result<Object> {
    // It stands out of its housing by its travel and a little more, and reaches as far into it.
    let half = travel + 0.003;
    let cap = solid(PieceShape::Cylinder(radius, half), DVec3::ZERO)?;
    let outline = cap.collider.clone();
    let wide = radius + 0.01;
    let housing = solid(PieceShape::Box(DVec3::new(wide, wide, 0.5 * HOUSING)), -DVec3::Z * 0.5 * HOUSING)?;
    // Damped such that the cap, some 10 g, comes back without ringing.
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
    Ok(fixture(vec![cap], vec![housing], joint, HOUSING, outline))
}

/// A knob on a plate; a ridge on its top shows how it is turned.
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
    let plate =
        solid(PieceShape::Box(DVec3::new(wide, wide, 0.5 * HOUSING)), -DVec3::Z * (half + GAP + 0.5 * HOUSING))?;
    let joint = JointMount {
        kind: "hinge",
        axis: DVec3::Z,
        anchor: DVec3::ZERO,
        range: [-2.6, 2.6],
        stiffness: 0.0,
        damping: 0.02 * resistance.max(0.005),
        friction: resistance,
    };
    Ok(fixture(vec![body, ridge], vec![plate], joint, half + GAP + HOUSING, outline))
}

/// A door whose leaf swings both ways about its edge at -x, beside a post.
///
/// # Errors
/// If a piece is degenerate.
pub(super) fn door(width: f64, height: f64, thickness: f64, resistance: f64) -> Result<Object> {
    let half = DVec3::new(0.5 * width, 0.5 * thickness, 0.5 * height);
    let leaf = solid(PieceShape::Box(half), DVec3::ZERO)?;
    let outline = leaf.collider.clone();
    let post = PieceShape::Box(DVec3::new(0.006, 0.006f64.max(half.y), half.z + 0.5 * GAP));
    let post = solid(post, DVec3::new(-half.x - 0.008, 0.0, -0.5 * GAP))?;
    let joint = JointMount {
        kind: "hinge",
        axis: DVec3::Z,
        anchor: -DVec3::X * half.x,
        range: [-1.7, 1.7],
        stiffness: 0.0,
        damping: 0.05 * resistance.max(0.01),
        friction: resistance,
    };
    Ok(fixture(vec![leaf], vec![post], joint, half.z + GAP, outline))
}

fn solid(shape: PieceShape, position: DVec3) -> Result<Piece> {
    Piece::new(shape, position, DQuat::IDENTITY, true)
}

fn fixture(pieces: Vec<Piece>, base: Vec<Piece>, joint: JointMount, half_height: f64, outline: SharedShape) -> Object {
    Object { base, mount: Mount::Joint(joint), ..Object::free(pieces, half_height, outline) }
}
