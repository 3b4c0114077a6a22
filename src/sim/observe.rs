//! What a rollout observes at an instant: picture, touch and all else that is true.

use ::image::RgbImage;
use glam::{DQuat, DVec3};

use super::camera::CameraPose;
use super::contact::{HandForce, hand_force, hand_slip};
use super::driver::HandDriver;
use super::effect::{Effect, Observation};
use super::rollout::Rollout;
use crate::dataset::Frame;
use crate::error::Result;
use crate::geometry::PROXIMITY;
use crate::geometry::force::link_vertices;
use crate::hand::{N_VERTICES, Side};
use crate::tactile::{CONTACT_FORCE_N, N_FIELD, TactileField, Validity};

/// Distance from a surface at which a vertex counts as touching where no forces are simulated, m.
pub const TOUCH_DISTANCE: f64 = 0.002;

/// One frame: the data-set's part, and what else is true at that instant.
#[derive(Debug, Clone)]
pub struct SimFrame {
    /// Picture, touch and hand poses, as data sets keep them.
    pub frame: Frame,
    /// (1556) 1 = an object's surface is within 1 cm (the paper's label).
    pub proximity: Vec<u8>,
    /// (1556) speed at which touching surfaces slide, m/s; `None` where it is not observed.
    pub slip: Option<Vec<f32>>,
    /// (H, W) distance from the camera's plane, m; `None` where it is not observed.
    pub depth: Option<Vec<f32>>,
    /// Left and right hand's force with residuals; `None` = absent, or without dynamics.
    pub hands: [Option<HandForce>; 2],
    /// Name and pose of each object that is solid, in the world frame, m.
    pub objects: Vec<ObjectPose>,
    /// Pose of the camera.
    pub camera: CameraPose,
}

/// A named pose, `world_from_object`.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectPose {
    /// The object.
    pub name: String,
    /// Position, m.
    pub position: DVec3,
    /// Orientation.
    pub orientation: DQuat,
}

impl Rollout {
    /// What is seen, felt and known at this instant.
    pub(super) fn observe(&mut self, validity: Validity) -> Result<SimFrame> {
        let lost = validity == Validity::NotFinite;
        let observes = |wanted: Observation| self.observe.contains(&wanted);
        // Effects in place of the scene's may not deliver what it observes: that is unknown then, not zero.
        let delivers = |wanted: Observation| {
            observes(wanted) && wanted.needs().iter().all(|effect| self.effects.contains(*effect))
        };
        let (wants_contact, wants_force) = (delivers(Observation::Contact), delivers(Observation::Force));
        let wants_slip = delivers(Observation::Slip);
        let dynamic = self.effects.contains(Effect::Dynamics);
        if !lost {
            self.objects.iter_mut().try_for_each(|object| object.refresh(&self.world))?;
        }
        let mut field = TactileField::zeros(self.topology());
        let mut proximity = vec![0; N_FIELD];
        let mut slip = vec![0.0; N_FIELD];
        let mut poses = [None, None];
        let mut forces = [None, None];
        for side in Side::BOTH {
            let Some(driver) = self.hands[side as usize].as_ref().filter(|_| !lost) else { continue };
            let Some((params, posed)) = self.posed(side) else { continue };
            let (links, spreader) = (driver.links(), &self.spreaders[side as usize]);
            if dynamic && (wants_force || wants_contact) {
                let label = hand_force(&self.world, links, &posed.vertices, spreader)?;
                field.force[side.range()].copy_from_slice(&label.force);
                forces[side as usize] = Some(label);
            }
            if wants_slip {
                slip[side.range()].copy_from_slice(&hand_slip(&self.world, links, &posed.vertices, spreader)?);
            }
            if wants_contact {
                let near = self.near_vertices(side, driver);
                let candidates = near.iter().zip(&posed.vertices).enumerate().filter(|(_, (near, _))| **near);
                for (vertex, (_, position)) in candidates {
                    let (index, position) = (side.range().start + vertex, position.as_dvec3());
                    proximity[index] = u8::from(self.objects.iter().any(|o| o.is_within(position, PROXIMITY)));
                    if !dynamic && proximity[index] == 1 {
                        let touches = self.objects.iter().any(|object| object.distance(position) <= TOUCH_DISTANCE);
                        field.contact[index] = f32::from(touches);
                    }
                }
            }
            poses[side as usize] = Some(params);
        }
        if dynamic && wants_contact {
            for (contact, force) in field.contact.iter_mut().zip(&field.force) {
                *contact = f32::from(*force > CONTACT_FORCE_N);
            }
        }
        if !wants_force {
            field.force.fill(f32::NAN);
        }
        if !wants_contact {
            field.contact.fill(f32::NAN);
        }
        let (picture, depth) = self.shoot(lost)?;
        // A hand that is there is supervised where the frame can be trusted; an absent one is surely not touched.
        let valid = validity == Validity::Valid;
        let [left_hand_pose, right_hand_pose] = poses;
        let frame = Frame {
            timestamp: self.world.time(),
            camera_ego_rgb: picture,
            field,
            force_valid: vec![u8::from(valid && wants_force); N_FIELD],
            contact_valid: vec![u8::from(valid && wants_contact); N_FIELD],
            validity,
            left_hand_pose,
            right_hand_pose,
        };
        let solid = self.objects.iter().filter(|object| object.body().is_some());
        let objects = solid.map(|object| {
            let (position, orientation) = object.pose();
            ObjectPose { name: object.name.clone(), position, orientation }
        });
        let objects = objects.collect();
        let camera = CameraPose::from_engine(self.world.camera_pose(self.camera));
        let slip = wants_slip.then_some(slip);
        Ok(SimFrame { frame, proximity, slip, depth, hands: forces, objects, camera })
    }

    /// Vertices of a hand that may be within 1 cm of something: those of links that collision detection found near, and
    /// all where it does not look for nearness.
    fn near_vertices(&self, side: Side, driver: &HandDriver) -> Vec<bool> {
        if !self.effects.contains(Effect::NearContact) {
            return vec![true; N_VERTICES];
        }
        let mut near = vec![false; N_VERTICES];
        let found: Vec<_> = self.world.contacts().flat_map(|contact| contact.bodies).collect();
        let vertices = link_vertices(&self.rigs[side as usize].model);
        for (link, _) in driver.links().iter().enumerate().filter(|(_, body)| found.contains(body)) {
            vertices[link].iter().for_each(|vertex| near[*vertex as usize] = true);
        }
        near
    }

    fn shoot(&mut self, lost: bool) -> Result<(RgbImage, Option<Vec<f32>>)> {
        if !lost && self.view.is_some() {
            self.set_skins()?;
        }
        match self.view.as_mut().filter(|_| !lost) {
            Some(view) => {
                let (picture, depth) = view.shoot(&mut self.world)?;
                Ok((picture, Some(depth).filter(|_| self.observe.contains(&Observation::Depth))))
            }
            None => Ok((RgbImage::new(self.intrinsics.width, self.intrinsics.height), None)),
        }
    }
}
