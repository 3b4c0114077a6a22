//! Objects of a rollout: pose, shape, and distances of points from them.

use glam::{DQuat, DVec3};

use super::object::Object;
use super::randomize::ObjectDraw;
use crate::error::Result;
use crate::geometry::SampledSurface;
use crate::geometry::proximity::SPACING;
use crate::mujoco::world::{Body, FreeJoint};
use crate::mujoco::{Flex, World};

/// Object of an episode in a world.
#[derive(Debug)]
pub struct SceneObject {
    /// Name.
    pub name: String,
    /// Free joint of an object that only contact holds.
    pub joint: Option<FreeJoint>,
    physics: ObjectPhysics,
    shape: Object,
    /// Surface of the moving part; of a soft object, deformed.
    surface: SampledSurface,
    /// Surface of the fixed part.
    base: Option<SampledSurface>,
    /// `world_from_object` at the start, where the fixed part stays.
    start: (DVec3, DQuat),
    /// `world_from_object` at the last refresh.
    pose: (DVec3, DQuat),
}

/// Representation of an object in the physics.
#[derive(Debug)]
enum ObjectPhysics {
    /// Rigid body.
    Body(Body),
    /// Soft body.
    Flex(Body, Flex),
    /// Place to reach, without a body.
    None,
}

impl SceneObject {
    /// Finds a drawn object in the world that was made from it.
    ///
    /// # Errors
    /// If the world was not made from it.
    pub fn new(world: &World, draw: &ObjectDraw) -> Result<Self> {
        let name = &draw.name;
        let physics = match world.flex(name) {
            _ if !draw.solid => ObjectPhysics::None,
            Ok(flex) => ObjectPhysics::Flex(world.body(name)?, flex),
            Err(_) => ObjectPhysics::Body(world.body(name)?),
        };
        Ok(Self {
            name: name.clone(),
            joint: world.free_joint(name).ok(),
            physics,
            surface: draw.shape.sampled_surface(SPACING)?,
            base: draw.shape.sampled_base(SPACING)?,
            shape: draw.shape.clone(),
            start: (draw.position, draw.orientation),
            pose: (draw.position, draw.orientation),
        })
    }

    /// Returns the body; `None` for an object that is not solid.
    pub fn body(&self) -> Option<Body> {
        match self.physics {
            ObjectPhysics::Body(body) | ObjectPhysics::Flex(body, _) => Some(body),
            ObjectPhysics::None => None,
        }
    }

    /// Returns `world_from_object` at the last [`Self::refresh`]; of a soft body, its centre.
    pub fn pose(&self) -> (DVec3, DQuat) {
        self.pose
    }

    /// Updates pose and shape from the world.
    ///
    /// # Errors
    /// If a soft body's points are not finite.
    pub(crate) fn refresh(&mut self, world: &World) -> Result<()> {
        match &self.physics {
            ObjectPhysics::Body(body) => self.pose = (world.position(*body), world.orientation(*body)),
            ObjectPhysics::Flex(_, flex) => {
                let centre = world.flex_centre(flex);
                let points: Vec<_> = world.flex_points(flex).iter().map(|p| *p - centre.as_vec3()).collect();
                self.surface = SampledSurface::new(&points, &flex.triangles, SPACING)?;
                self.pose = (centre, DQuat::IDENTITY);
            }
            ObjectPhysics::None => (),
        }
        Ok(())
    }

    /// Returns true if a point of the resampled surface lies within `distance`, m, of `point` in the world frame.
    pub fn is_within(&self, point: DVec3, distance: f32) -> bool {
        if matches!(self.physics, ObjectPhysics::None) {
            return false;
        }
        let near = |surface: &SampledSurface, pose| surface.is_within(local(pose, point).as_vec3(), distance);
        near(&self.surface, self.pose) || self.base.as_ref().is_some_and(|base| near(base, self.start))
    }

    /// Returns the signed distance of `point` in the world frame, m: negative inside, infinite for an object that is
    /// not solid.
    ///
    /// A soft body has its shape at rest.
    pub fn distance(&self, point: DVec3) -> f64 {
        if matches!(self.physics, ObjectPhysics::None) {
            return f64::INFINITY;
        }
        let base = self.shape.base_distance(local(self.start, point));
        self.shape.distance(local(self.pose, point)).min(base)
    }
}

/// Transforms a world point to an object frame.
fn local((position, orientation): (DVec3, DQuat), point: DVec3) -> DVec3 {
    orientation.inverse() * (point - position)
}
