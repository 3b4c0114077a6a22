//! Objects of a rollout: where they are, and how near a point is to them.

use glam::{DQuat, DVec3};

use super::object::Object;
use super::randomize::ObjectDraw;
use crate::error::Result;
use crate::geometry::SampledSurface;
use crate::geometry::proximity::SPACING;
use crate::mujoco::world::{Body, FreeJoint};
use crate::mujoco::{Flex, World};

/// An object of an episode in a world.
#[derive(Debug)]
pub struct SceneObject {
    /// Its name.
    pub name: String,
    /// Its joint, if nothing else holds it.
    pub joint: Option<FreeJoint>,
    place: Place,
    shape: Object,
    surface: SampledSurface,
    base: Option<SampledSurface>,
    start: (DVec3, DQuat),
    pose: (DVec3, DQuat),
}

#[derive(Debug)]
enum Place {
    /// Moves as a body.
    Body(Body),
    /// Deforms.
    Flex(Body, Flex),
    /// Is not in the world.
    Nowhere,
}

impl SceneObject {
    /// Finds a drawn object in the world made from it.
    ///
    /// # Errors
    /// If the world was not made from it.
    pub fn new(world: &World, draw: &ObjectDraw) -> Result<Self> {
        let name = &draw.name;
        let place = match world.flex(name) {
            _ if !draw.solid => Place::Nowhere,
            Ok(flex) => Place::Flex(world.body(name)?, flex),
            Err(_) => Place::Body(world.body(name)?),
        };
        Ok(Self {
            name: name.clone(),
            joint: world.free_joint(name).ok(),
            place,
            surface: draw.shape.sampled_surface(SPACING)?,
            base: draw.shape.sampled_base(SPACING)?,
            shape: draw.shape.clone(),
            start: (draw.position, draw.orientation),
            pose: (draw.position, draw.orientation),
        })
    }

    /// Its body; `None` for a place that is not solid.
    pub fn body(&self) -> Option<Body> {
        match self.place {
            Place::Body(body) | Place::Flex(body, _) => Some(body),
            Place::Nowhere => None,
        }
    }

    /// `world_from_object` at the last [`Self::refresh`]; of a soft body, its middle.
    pub fn pose(&self) -> (DVec3, DQuat) {
        self.pose
    }

    /// Takes pose and shape from the world.
    ///
    /// # Errors
    /// If a soft body's points are not finite.
    pub fn refresh(&mut self, world: &World) -> Result<()> {
        match &self.place {
            Place::Body(body) => self.pose = (world.position(*body), world.orientation(*body)),
            Place::Flex(_, flex) => {
                let centre = world.flex_centre(flex);
                let points: Vec<_> = world.flex_points(flex).iter().map(|p| *p - centre.as_vec3()).collect();
                self.surface = SampledSurface::new(&points, &flex.triangles, SPACING)?;
                self.pose = (centre, DQuat::IDENTITY);
            }
            Place::Nowhere => (),
        }
        Ok(())
    }

    /// Whether a point of its surface, resampled, lies within `distance` of `point`, m in the world frame.
    pub fn is_within(&self, point: DVec3, distance: f32) -> bool {
        if matches!(self.place, Place::Nowhere) {
            return false;
        }
        let near = |surface: &SampledSurface, pose| surface.is_within(local(pose, point).as_vec3(), distance);
        near(&self.surface, self.pose) || self.base.as_ref().is_some_and(|base| near(base, self.start))
    }

    /// Distance of `point` from it, m: negative inside; infinite for a place that is not solid.
    ///
    /// A soft body counts as it is at rest.
    pub fn distance(&self, point: DVec3) -> f64 {
        if matches!(self.place, Place::Nowhere) {
            return f64::INFINITY;
        }
        let base = self.shape.base_distance(local(self.start, point));
        self.shape.distance(local(self.pose, point)).min(base)
    }
}

fn local((position, orientation): (DVec3, DQuat), point: DVec3) -> DVec3 {
    orientation.inverse() * (point - position)
}
