//! Labels of a frame: touch of both hands from the engine's contacts.

use super::hands::SimHands;
use crate::error::Result;
use crate::geometry::force::link_vertices;
use crate::geometry::{ForceSpreader, PROXIMITY};
use crate::hand::{HandParams, N_VERTICES, PosedHand, Side, Topology};
use crate::mujoco::World;
use crate::sim::contact::{HandForce, hand_force, hand_slip};
use crate::sim::driver::HandDriver;
use crate::sim::effect::{Effect, EffectSet, Observation};
use crate::sim::scene_object::SceneObject;
use crate::tactile::{CONTACT_FORCE_N, N_FIELD, TactileField};

/// Distance from a surface up to which a vertex touches it where no forces are simulated, m.
const TOUCH_DISTANCE: f64 = 0.002;

/// Labels the frames of a rollout.
#[derive(Debug)]
pub(super) struct Labeller {
    spreaders: [ForceSpreader; 2],
    /// True if hands and objects have dynamics; otherwise contact comes from distances.
    dynamic: bool,
    /// True if collision detection lists pairs within 1 cm.
    detects_near: bool,
    /// True if contact is observed and can be delivered; likewise force and slip.
    pub contact: bool,
    pub force: bool,
    pub slip: bool,
}

/// Labels of one frame; left hand first.
#[derive(Debug)]
pub(super) struct Labels {
    /// Force and contact; NaN where they are not observed.
    pub field: TactileField,
    /// (1556) 1 = an object's surface is within 1 cm.
    pub proximity: Vec<u8>,
    /// (1556) m/s.
    pub slip: Vec<f32>,
    /// Parameters of the hands; `None` = absent.
    pub poses: [Option<HandParams>; 2],
    /// Forces with residuals; `None` = absent, or no dynamics.
    pub forces: [Option<HandForce>; 2],
}

impl Labels {
    /// Creates the labels of a frame in which nothing touches.
    fn untouched(topology: Topology) -> Self {
        Self {
            field: TactileField::zeros(topology),
            proximity: vec![0; N_FIELD],
            slip: vec![0.0; N_FIELD],
            poses: [None, None],
            forces: [None, None],
        }
    }
}

impl Labeller {
    /// Creates a labeller for the given observations.
    ///
    /// Effects that replace the scene's may not deliver an observation: it is then unknown, not zero.
    pub fn new(spreaders: [ForceSpreader; 2], observed: &[Observation], effects: EffectSet) -> Self {
        let delivers = |wanted: Observation| {
            observed.contains(&wanted) && wanted.needs().iter().all(|effect| effects.contains(*effect))
        };
        Self {
            spreaders,
            dynamic: effects.contains(Effect::Dynamics),
            detects_near: effects.contains(Effect::NearContact),
            contact: delivers(Observation::Contact),
            force: delivers(Observation::Force),
            slip: delivers(Observation::Slip),
        }
    }

    /// Labels the current instant; `lost` = the state is not finite, and no hand is labelled.
    ///
    /// # Errors
    /// If a contact is not finite.
    pub fn label(&self, world: &World, hands: &SimHands, objects: &[SceneObject], lost: bool) -> Result<Labels> {
        let mut labels = Labels::untouched(hands.rigs[0].model.topology);
        for side in Side::BOTH {
            let Some(driver) = hands.driver(side).filter(|_| !lost) else { continue };
            let Some((params, posed)) = hands.posed(world, side) else { continue };
            self.label_force(world, side, driver, &posed, &mut labels)?;
            if self.contact {
                let near = self.near_vertices(world, driver, &hands.rigs[side as usize].model);
                self.label_distance(side, &near, &posed, objects, &mut labels);
            }
            labels.poses[side as usize] = Some(params);
        }
        self.finish(&mut labels.field);
        Ok(labels)
    }

    /// Labels force and slip of one hand.
    fn label_force(
        &self,
        world: &World,
        side: Side,
        driver: &HandDriver,
        posed: &PosedHand,
        labels: &mut Labels,
    ) -> Result<()> {
        let (links, spreader) = (driver.links(), &self.spreaders[side as usize]);
        if self.dynamic && (self.force || self.contact) {
            let label = hand_force(world, links, &posed.vertices, spreader)?;
            labels.field.force[side.range()].copy_from_slice(&label.force);
            labels.forces[side as usize] = Some(label);
        }
        if self.slip {
            labels.slip[side.range()].copy_from_slice(&hand_slip(world, links, &posed.vertices, spreader)?);
        }
        Ok(())
    }

    /// Labels proximity of one hand, and without dynamics its contact; tests only the vertices marked in `near`.
    fn label_distance(
        &self,
        side: Side,
        near: &[bool],
        posed: &PosedHand,
        objects: &[SceneObject],
        labels: &mut Labels,
    ) {
        let candidates = near.iter().zip(&posed.vertices).enumerate().filter(|(_, (near, _))| **near);
        for (vertex, (_, position)) in candidates {
            let (index, position) = (side.range().start + vertex, position.as_dvec3());
            labels.proximity[index] = u8::from(objects.iter().any(|object| object.is_within(position, PROXIMITY)));
            if !self.dynamic && labels.proximity[index] == 1 {
                let touches = objects.iter().any(|object| object.distance(position) <= TOUCH_DISTANCE);
                labels.field.contact[index] = f32::from(touches);
            }
        }
    }

    /// Marks the vertices of a hand that may be within 1 cm of a surface: those of links that collision detection
    /// lists, or all vertices if it lists no near pairs.
    fn near_vertices(&self, world: &World, driver: &HandDriver, model: &crate::hand::HandModel) -> Vec<bool> {
        if !self.detects_near {
            return vec![true; N_VERTICES];
        }
        let mut near = vec![false; N_VERTICES];
        let found: Vec<_> = world.contacts().flat_map(|contact| contact.bodies).collect();
        let vertices = link_vertices(model);
        for (link, _) in driver.links().iter().enumerate().filter(|(_, body)| found.contains(body)) {
            vertices[link].iter().for_each(|vertex| near[*vertex as usize] = true);
        }
        near
    }

    /// Derives contact from force, and marks unobserved fields as unknown.
    fn finish(&self, field: &mut TactileField) {
        if self.dynamic && self.contact {
            for (contact, force) in field.contact.iter_mut().zip(&field.force) {
                *contact = f32::from(*force > CONTACT_FORCE_N);
            }
        }
        if !self.force {
            field.force.fill(f32::NAN);
        }
        if !self.contact {
            field.contact.fill(f32::NAN);
        }
    }
}
