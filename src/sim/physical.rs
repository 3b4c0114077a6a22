//! Objects of an episode as bodies whose motion tells forces.

use super::mjcf::{TABLE_CENTRE, TABLE_HALF};
use super::object::Mount;
use super::randomize::{EpisodeDraw, ObjectDraw};
use crate::error::Result;
use crate::geometry::{SPACING, Solid};
use crate::physics::{Fixed, Pose, RigidBody};

/// Returns the solid objects of an episode as bodies, in the order in which stores hold their poses, and the things that
/// stay where they are. Masses and friction are those of the simulation.
///
/// # Errors
/// If a shape has no surface.
pub fn bodies(episode: &EpisodeDraw) -> Result<(Vec<RigidBody>, Vec<Fixed>)> {
    let mut table = Solid::default();
    table.add_cuboid(TABLE_HALF.as_vec3(), super::convex::pose(TABLE_CENTRE, glam::DQuat::IDENTITY))?;
    let mut fixed = vec![Fixed { name: "table".into(), solid: table, pose: Pose::IDENTITY }];
    let mut bodies = Vec::new();
    for object in episode.objects.iter().filter(|object| object.solid) {
        bodies.push(body(object)?);
        if !object.shape.base.is_empty() {
            let pose = Pose { position: object.position, orientation: object.orientation };
            let name = format!("base of {}", object.name);
            fixed.push(Fixed { name, solid: object.shape.base_solid()?, pose });
        }
    }
    Ok((bodies, fixed))
}

fn body(object: &ObjectDraw) -> Result<RigidBody> {
    let samples = object.shape.sampled_surface(SPACING)?.points().to_vec();
    let mut body = RigidBody::from_solid(&object.name, object.shape.solid()?, samples).with_mass(object.mass, 0.0)?;
    body.friction = object.friction;
    body.held = match object.shape.mount {
        Mount::Free => None,
        Mount::Joint(_) => Some("hangs on a joint".into()),
        Mount::Soft { .. } => Some("deforms".into()),
    };
    Ok(body)
}
