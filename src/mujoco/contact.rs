//! Where the bodies of a world touch.

use glam::DVec3;

use super::World;
use super::names::Body;

/// One touching point of two geoms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// The two bodies; of a soft body, the one that has its name.
    pub bodies: [Body; 2],
    /// Midpoint between the two surfaces, m.
    pub position: DVec3,
    /// Unit normal from the first body to the second.
    pub normal: DVec3,
    /// Distance between the surfaces, m; negative means penetration.
    pub distance: f64,
    /// Normal force, N, never negative: the second body is pushed along `normal`, the first against it.
    pub normal_force: f64,
    /// Whole force on the second body in the world frame (normal and friction), N.
    pub force: DVec3,
}

impl World {
    /// All touching points of the last [`Self::forward`] or [`Self::step`], in the engine's order.
    pub fn contacts(&self) -> impl Iterator<Item = Contact> + '_ {
        let geom_body = self.data.model().geom_bodyid();
        self.data.contact().iter().enumerate().filter_map(move |(index, contact)| {
            let side = |geom: i32, flex: i32| match (usize::try_from(geom), usize::try_from(flex)) {
                (Ok(geom), _) => Some(Body(geom_body[geom] as usize)),
                (_, Ok(flex)) => self.flex_bodies.get(flex).copied(),
                _ => None,
            };
            let bodies = [side(contact.geom[0], contact.flex[0])?, side(contact.geom[1], contact.flex[1])?];
            let axis = |row: usize| DVec3::from_slice(&contact.frame[3 * row..3 * row + 3]);
            let [normal, t1, t2, ..] = self.data.contact_force(index);
            Some(Contact {
                bodies,
                position: DVec3::from_array(contact.pos),
                normal: axis(0),
                distance: contact.dist,
                normal_force: normal.max(0.0),
                force: axis(0) * normal + axis(1) * t1 + axis(2) * t2,
            })
        })
    }
}
