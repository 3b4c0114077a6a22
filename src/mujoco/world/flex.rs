//! Soft bodies of a world.

use glam::{DVec3, Vec3};
use mujoco_rs::prelude::*;

use super::{Body, World};
use crate::error::{Error, Result};

/// Handle of a soft body; valid in the world that it was looked up in.
#[derive(Debug, Clone, PartialEq)]
pub struct Flex {
    first: usize,
    count: usize,
    /// Triangles of the outer surface, as indices into [`World::flex_points`], counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl World {
    /// Looks up a soft body.
    ///
    /// # Errors
    /// If the name is unknown; the error lists the known ones.
    pub fn flex(&self, name: &str) -> Result<Flex> {
        let model = self.data.model();
        let names =
            (0..model.ffi().nflex as usize).map(|id| model.id_to_name(MjtObjBase::mjOBJ_FLEX, id).unwrap_or_default());
        let id = names.clone().position(|other| other == name);
        let id = id.ok_or_else(|| Error::unknown("soft body", name, names))?;
        let (first, count) = (model.flex_vertadr()[id] as usize, model.flex_vertnum()[id] as usize);
        let shell = model.flex_shelldataadr()[id] as usize;
        let length = 3 * model.flex_shellnum()[id] as usize;
        let corners = &model.flex_shell()[shell..shell + length];
        let triangles = corners.chunks_exact(3).map(|t| [t[0], t[1], t[2]].map(|corner| corner as u32)).collect();
        Ok(Flex { first, count, triangles })
    }

    /// Returns the points of a soft body, m.
    pub fn flex_points(&self, flex: &Flex) -> Vec<Vec3> {
        let points = &self.data.flexvert_xpos()[flex.first..flex.first + flex.count];
        points.iter().map(|point| DVec3::from_array(*point).as_vec3()).collect()
    }

    /// Returns the mean of a soft body's points, m.
    pub fn flex_centre(&self, flex: &Flex) -> DVec3 {
        let points = &self.data.flexvert_xpos()[flex.first..flex.first + flex.count];
        points.iter().map(|point| DVec3::from_array(*point)).sum::<DVec3>() / flex.count.max(1) as f64
    }

    /// Returns for each soft body the body of the same name, or else the first body that moves its points.
    pub(super) fn find_flex_bodies(&self) -> Vec<Body> {
        let model = self.data.model();
        let body = |id: usize| {
            let name = model.id_to_name(MjtObjBase::mjOBJ_FLEX, id).unwrap_or_default();
            let first = || model.flex_nodebodyid().get(model.flex_nodeadr()[id].max(0) as usize).copied().unwrap_or(0);
            self.body(name).unwrap_or_else(|_| Body(first().max(0) as usize))
        };
        (0..model.ffi().nflex as usize).map(body).collect()
    }
}
