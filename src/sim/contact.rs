//! Labels of a hand from the engine's contacts.

use glam::{DVec3, Vec3};

use crate::error::Result;
use crate::geometry::{ForceSpreader, LinkContact};
use crate::hand::{N_JOINTS, link_limit};
use crate::mujoco::World;
use crate::mujoco::world::Body;

/// Force on one hand, with residuals of the conservation of force and moment.
#[derive(Debug, Clone, PartialEq)]
pub struct HandForce {
    /// (778) normal force per vertex, N.
    pub force: Vec<f32>,
    /// Sum of the contacts' normal forces, N.
    pub total: f64,
    /// Relative residual of the sum: |sum over vertices - total| / total.
    pub sum_residual: f64,
    /// Magnitude of the moment that spreading adds, N m.
    pub moment_residual: f64,
    /// Normal force on each link, N.
    pub links: [f64; N_JOINTS],
    /// Number of contact points with force.
    pub contacts: usize,
    /// Positions of the contact points in the world frame, m.
    pub places: Vec<DVec3>,
}

impl HandForce {
    /// Returns true if a link bears more than that of a human hand can.
    pub fn is_too_strong(&self) -> bool {
        self.links.iter().enumerate().any(|(link, force)| *force > link_limit(link))
    }
}

/// Computes label (c) of one hand from all contacts of its `links`; a contact between two links of the hand counts on
/// both.
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
    let mut on_links = [0.0; N_JOINTS];
    contacts.iter().for_each(|contact| on_links[contact.link] += contact.force);
    let (force, total) = (label.force, label.total);
    Ok(HandForce { force, total, sum_residual, moment_residual, links: on_links, contacts: places.len(), places })
}

/// Computes the (778) sliding speed of touching surfaces, m/s: at each vertex the mean over contacts, weighted by the
/// force that the vertex has from each contact; 0 without force.
///
/// # Errors
/// As [`hand_force`].
pub(crate) fn hand_slip(
    world: &World,
    links: &[Body],
    vertices: &[Vec3],
    spreader: &ForceSpreader,
) -> Result<Vec<f32>> {
    let (contacts, speeds): (Vec<LinkContact>, Vec<f64>) = hand_contacts(world, links).unzip();
    let weighted = |(contact, speed): (&LinkContact, &f64)| LinkContact { force: contact.force * speed, ..*contact };
    let force = spreader.spread(vertices, &contacts)?.force;
    let sliding = spreader.spread(vertices, &contacts.iter().zip(&speeds).map(weighted).collect::<Vec<_>>())?.force;
    Ok(sliding.iter().zip(force).map(|(sliding, force)| if force > 0.0 { sliding / force } else { 0.0 }).collect())
}

/// Iterates over the contacts with force on a hand's links, each with its sliding speed, m/s.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_link_beyond_its_limit_makes_a_hand_too_strong() {
        let with = |link: usize, force: f64| {
            let mut links = [0.0; N_JOINTS];
            links[link] = force;
            let (force, places) = (Vec::new(), Vec::new());
            HandForce { force, total: 0.0, sum_residual: 0.0, moment_residual: 0.0, links, contacts: 1, places }
        };
        // A finger bears 80 N, and the palm 250 N.
        let strong =
            [(3, 79.0), (3, 81.0), (0, 249.0), (0, 251.0)].map(|(link, force)| with(link, force).is_too_strong());
        assert_eq!(strong, [false, true, false, true]);
    }
}
