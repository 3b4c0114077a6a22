//! Hands of a world that is set to recorded poses: vertices and contacts.

use egotac::error::Result;
use egotac::geometry::{ForceSpreader, LinkContact};
use egotac::hand::Side;
use egotac::mujoco::World;
use egotac::mujoco::world::{Body, Contact, Servo};
use egotac::sim::Rollout;
use egotac::sim::rig::{HandRig, JOINT_NAMES};
use glam::Vec3;

/// A hand with its bodies in a world.
#[derive(Debug)]
pub struct Hand {
    /// Left or right.
    pub side: Side,
    /// Bodies of the links in MANO's order.
    pub links: Vec<Body>,
    rig: HandRig,
    hinges: Vec<Servo>,
}

impl Hand {
    /// Finds the hands of a scene, left first.
    ///
    /// # Errors
    /// If a part of a hand is missing in the world.
    pub fn of(rollout: &Rollout) -> Result<Vec<Self>> {
        let world = rollout.world();
        let there = Side::BOTH.into_iter().filter(|side| rollout.hand_params(*side).is_some());
        let hand = |side: Side| {
            let rig = rollout.rigs()[side as usize].clone();
            let links = JOINT_NAMES.iter().map(|name| world.body(&rig.name(name))).collect::<Result<_>>()?;
            let hinges = rig.hinges.iter().map(|h| world.servo(&rig.name(&h.name))).collect::<Result<_>>()?;
            Ok(Self { side, links, rig, hinges })
        };
        there.map(hand).collect()
    }

    /// Returns the (778) vertices in the present pose, world frame, m.
    pub fn vertices(&self, world: &World) -> Vec<Vec3> {
        let angles: Vec<f64> = self.hinges.iter().map(|hinge| world.joint_position(*hinge)).collect();
        let params = self.rig.params(world.position(self.links[0]), world.orientation(self.links[0]), &angles);
        self.rig.model.forward(&params).vertices
    }

    /// Creates the spreader of forces over the vertices.
    ///
    /// # Errors
    /// If `sigma` is not a positive length.
    pub fn spreader(&self, sigma: f64) -> Result<ForceSpreader> {
        ForceSpreader::new(&self.rig.model, sigma)
    }

    /// Returns the contacts on the hand, each with a force of `force` newtons.
    pub fn places(&self, contacts: &[Contact], force: f64) -> Vec<LinkContact> {
        let mut places = Vec::new();
        for contact in contacts.iter().filter(|contact| contact.distance < 0.0) {
            for (body, sign) in contact.bodies.into_iter().zip([-1.0, 1.0]) {
                if let Some(link) = self.links.iter().position(|link| *link == body) {
                    places.push(LinkContact { link, position: contact.position, normal: contact.normal * sign, force });
                }
            }
        }
        places
    }
}
