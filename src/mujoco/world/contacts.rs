//! Contacts between the bodies of a world.

use glam::DVec3;

use super::{Body, World};

/// One contact point of two geoms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// The two bodies; for a soft body, the body that has its name.
    pub bodies: [Body; 2],
    /// Midpoint between the two surfaces, m.
    pub position: DVec3,
    /// Unit normal from the first body to the second.
    pub normal: DVec3,
    /// Distance between the surfaces, m; negative means penetration.
    pub distance: f64,
    /// Normal force, N, never negative: it pushes the second body along `normal` and the first body against it.
    pub normal_force: f64,
    /// Total force on the second body in the world frame (normal and friction), N.
    pub force: DVec3,
}

/// Friction at one contact point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grip {
    /// The two bodies.
    pub bodies: [Body; 2],
    /// Normal force, N.
    pub normal_force: f64,
    /// Friction force relative to the limit of the friction cone; values above 1 lie outside of the cone.
    pub cone_ratio: f64,
    /// Velocity of the second body relative to the first in the contact plane, m/s.
    pub slip: DVec3,
}

impl World {
    /// Returns all contact points of the last [`Self::forward`] or [`Self::step`], in the engine's order.
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

    /// Returns geom indices and surface distance, m, of each contact of two geoms, without computing its force.
    pub fn gaps(&self) -> impl Iterator<Item = ([usize; 2], f64)> + '_ {
        self.data.contact().iter().filter_map(|contact| match contact.geom.map(usize::try_from) {
            [Ok(a), Ok(b)] => Some(([a, b], contact.dist)),
            _ => None, // a flex, not a geom
        })
    }

    /// Returns friction and slip at all contacts with a normal force; valid after [`Self::forward`].
    pub fn grips(&self) -> impl Iterator<Item = Grip> + '_ {
        let geom_body = self.data.model().geom_bodyid();
        self.data.contact().iter().enumerate().filter_map(move |(index, contact)| {
            let [Ok(geom1), Ok(geom2)] = contact.geom.map(usize::try_from) else { return None };
            let [normal_force, f1, f2, ..] = self.data.contact_force(index);
            if normal_force <= 0.0 {
                return None;
            }
            let bodies = [geom_body[geom1] as usize, geom_body[geom2] as usize].map(Body);
            let normal = DVec3::from_slice(&contact.frame[..3]);
            let position = DVec3::from_array(contact.pos);
            let velocity = self.point_velocity(bodies[1], position) - self.point_velocity(bodies[0], position);
            let [mu1, mu2, ..] = contact.friction;
            let cone_ratio = if contact.dim > 1 { (f1 / mu1).hypot(f2 / mu2) / normal_force } else { 0.0 };
            let slip = velocity.reject_from_normalized(normal);
            Some(Grip { bodies, normal_force, cone_ratio, slip })
        })
    }
}
