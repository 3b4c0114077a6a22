//! Contacts of the engine to labels of the hands.

use glam::{DVec3, Vec3};

use crate::error::Result;
use crate::geometry::{ForceSpreader, LinkContact};
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
    /// Their places in the world frame, m.
    pub places: Vec<DVec3>,
}

/// Label (c) of one hand: every contact in which one of `links` takes part; a hand that touches itself gets both sides.
///
/// `vertices` are the posed (778) vertices in the world frame, m.
///
/// # Errors
/// If a contact is not finite.
pub fn hand_force(world: &World, links: &[Body], vertices: &[Vec3], spreader: &ForceSpreader) -> Result<HandForce> {
    let contacts: Vec<LinkContact> = hand_contacts(world, links).map(|(contact, _)| contact).collect();
    let label = spreader.spread(vertices, &contacts)?;
    let (sum_residual, moment_residual) = (label.sum_residual(), label.moment_residual.length());
    let places: Vec<DVec3> = contacts.iter().map(|contact| contact.position).collect();
    let (force, total) = (label.force, label.total);
    Ok(HandForce { force, total, sum_residual, moment_residual, contacts: places.len(), places })
}

/// (778) speed at which touching surfaces slide along each other, m/s: at each vertex the mean over contacts, weighted
/// with the force that it has from each; 0 where it has none.
///
/// # Errors
/// As [`hand_force`].
pub fn hand_slip(world: &World, links: &[Body], vertices: &[Vec3], spreader: &ForceSpreader) -> Result<Vec<f32>> {
    let (contacts, speeds): (Vec<LinkContact>, Vec<f64>) = hand_contacts(world, links).unzip();
    let weighted = |(contact, speed): (&LinkContact, &f64)| LinkContact { force: contact.force * speed, ..*contact };
    let force = spreader.spread(vertices, &contacts)?.force;
    let sliding = spreader.spread(vertices, &contacts.iter().zip(&speeds).map(weighted).collect::<Vec<_>>())?.force;
    Ok(sliding.iter().zip(force).map(|(sliding, force)| if force > 0.0 { sliding / force } else { 0.0 }).collect())
}

/// Contacts with force on a hand's links, each with the speed at which it slides, m/s.
fn hand_contacts<'a>(world: &'a World, links: &'a [Body]) -> impl Iterator<Item = (LinkContact, f64)> + 'a {
    let pressed = world.contacts().filter(|contact| contact.normal_force > 0.0);
    pressed.flat_map(move |contact| {
        let [first, second] = contact.bodies.map(|body| world.point_velocity(body, contact.position));
        let speed = (second - first).reject_from_normalized(contact.normal).length();
        contact.bodies.into_iter().zip([-1.0, 1.0]).filter_map(move |(body, sign)| {
            let link = links.iter().position(|link| *link == body)?;
            let (position, normal, force) = (contact.position, contact.normal * sign, contact.normal_force);
            Some((LinkContact { link, position, normal, force }, speed))
        })
    })
}
