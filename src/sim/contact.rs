//! Contacts of the engine to labels of the hands.

use glam::Vec3;

use crate::error::Result;
use crate::label::{ForceSpreader, LinkContact};
use crate::mujoco::World;
use crate::mujoco::world::Body;

/// Force on one hand, with what conservation says about it.
#[derive(Debug, Clone, PartialEq)]
pub struct HandForce {
    /// (778) N.
    pub force: Vec<f32>,
    /// Sum of the contacts' normal forces, N.
    pub total: f64,
    /// |sum over vertices - total| / total.
    pub sum_residual: f64,
    /// Length of the moment that spreading adds, N m.
    pub moment_residual: f64,
    /// Touching points with force.
    pub contacts: usize,
}

/// Label (c) of one hand: every contact in which one of `links` takes part; a hand that touches itself gets both sides.
///
/// `vertices` are the posed (778) vertices in the world frame, m.
///
/// # Errors
/// If a contact is not finite.
pub fn hand_force(world: &World, links: &[Body], vertices: &[Vec3], spreader: &ForceSpreader) -> Result<HandForce> {
    let mut contacts = Vec::new();
    for contact in world.contacts().filter(|contact| contact.normal_force > 0.0) {
        for (body, sign) in contact.bodies.into_iter().zip([-1.0, 1.0]) {
            if let Some(link) = links.iter().position(|link| *link == body) {
                let (position, normal) = (contact.position, contact.normal * sign);
                contacts.push(LinkContact { link, position, normal, force: contact.normal_force });
            }
        }
    }
    let label = spreader.spread(vertices, &contacts)?;
    let (sum_residual, moment_residual) = (label.sum_residual(), label.moment_residual.length());
    Ok(HandForce { total: label.total, sum_residual, moment_residual, contacts: contacts.len(), force: label.force })
}
