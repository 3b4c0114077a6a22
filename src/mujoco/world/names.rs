//! Handles to the elements of a world, looked up by name once.

use mujoco_rs::prelude::*;

use super::World;
use crate::error::{Error, Result};

/// Handle of a body; valid in the world that it was looked up in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Body(pub(in crate::mujoco) usize);

/// Handle of a one-degree-of-freedom joint with the position servo that drives it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Servo {
    pub(super) qpos: usize,
    pub(super) dof: usize,
    pub(super) ctrl: usize,
}

/// Handle of a free joint: 7 positions (xyz, quaternion wxyz), 6 velocities (linear in the world frame, angular in the
/// body frame).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct FreeJoint {
    pub(super) body: Body,
    pub(super) qpos: usize,
    pub(super) dof: usize,
}

/// Handle of a skin: a mesh that bodies deform, for pictures only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Skin {
    pub(super) first: usize,
    pub(super) count: usize,
}

impl World {
    /// Looks up a body.
    ///
    /// # Errors
    /// If the name is unknown; the error lists the known ones.
    pub fn body(&self, name: &str) -> Result<Body> {
        self.id(MjtObjBase::mjOBJ_BODY, "body", name).map(Body)
    }

    /// Looks up the index of a camera.
    ///
    /// # Errors
    /// As [`Self::body`].
    pub fn camera(&self, name: &str) -> Result<usize> {
        self.id(MjtObjBase::mjOBJ_CAMERA, "camera", name)
    }

    /// Looks up a hinge or slide and the actuator of the same name.
    ///
    /// # Errors
    /// If the joint or the actuator is unknown.
    pub fn servo(&self, name: &str) -> Result<Servo> {
        let joint = self.id(MjtObjBase::mjOBJ_JOINT, "joint", name)?;
        let ctrl = self.id(MjtObjBase::mjOBJ_ACTUATOR, "actuator", name)?;
        let model = self.data.model();
        Ok(Servo { qpos: model.jnt_qposadr()[joint] as usize, dof: model.jnt_dofadr()[joint] as usize, ctrl })
    }

    /// Looks up a body's free joint, which has the body's name.
    ///
    /// # Errors
    /// If the body or the joint is unknown, or the joint is of another type.
    pub fn free_joint(&self, name: &str) -> Result<FreeJoint> {
        let body = self.body(name)?;
        let joint = self.id(MjtObjBase::mjOBJ_JOINT, "joint", name)?;
        let model = self.data.model();
        if model.jnt_type()[joint] != MjtJoint::mjJNT_FREE {
            return Err(Error::value(format!("joint {name}"), "a free joint", "a hinge or slide"));
        }
        Ok(FreeJoint { body, qpos: model.jnt_qposadr()[joint] as usize, dof: model.jnt_dofadr()[joint] as usize })
    }

    /// Looks up the index of a mocap body.
    ///
    /// # Errors
    /// If the body is unknown, or is not a mocap body.
    pub fn mocap(&self, name: &str) -> Result<usize> {
        let Body(body) = self.body(name)?;
        let mocap = self.data.model().body_mocapid()[body];
        usize::try_from(mocap)
            .map_err(|_| Error::value(format!("body {name}"), "a mocap body", "a body of another kind"))
    }

    /// Looks up a skin.
    ///
    /// # Errors
    /// As [`Self::body`].
    pub fn skin(&self, name: &str) -> Result<Skin> {
        let skin = self.id(MjtObjBase::mjOBJ_SKIN, "skin", name)?;
        let model = self.data.model();
        Ok(Skin { first: model.skin_vertadr()[skin] as usize, count: model.skin_vertnum()[skin] as usize })
    }

    fn id(&self, kind: MjtObjBase, kind_name: &'static str, name: &str) -> Result<usize> {
        if name.contains('\0') {
            return Err(Error::value(kind_name, "a name without NUL", format!("{name:?}")));
        }
        self.data.model().name_to_id(kind, name).ok_or_else(|| {
            let known: Vec<&str> = (0..).map_while(|id| self.data.model().id_to_name(kind, id)).collect();
            Error::unknown(kind_name, name, known)
        })
    }
}
