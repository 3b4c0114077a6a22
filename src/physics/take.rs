//! One recorded episode as the estimation sees it: hands, bodies and surroundings over time.

use glam::{DVec3, Vec3};

use super::body::RigidBody;
use super::pose::Pose;
use crate::error::Result;
use crate::geometry::Solid;
use crate::hand::{HandModel, HandParams, Side};

/// A recorded episode, in one world frame.
#[derive(Debug, Clone)]
pub struct Take<'a> {
    /// Times of the frames, s, ascending.
    pub times: Vec<f64>,
    /// Left and right hand model.
    pub models: [&'a HandModel; 2],
    /// Parameters of the left and the right hand at each frame.
    pub hands: [Vec<Tracked>; 2],
    /// Bodies that the hands may touch.
    pub bodies: Vec<RigidBody>,
    /// Pose of each body at each frame; `None` = unknown.
    pub poses: Vec<Vec<Option<Pose>>>,
    /// Things that stay where they are, such as the table.
    pub fixed: Vec<Fixed>,
    /// Acceleration of free fall, m/s²; `None` = the direction of gravity is unknown.
    pub gravity: Option<DVec3>,
}

/// Knowledge of a hand at one frame.
#[derive(Debug, Clone, PartialEq)]
pub enum Tracked {
    /// The hand is there.
    Present(Box<HandParams>),
    /// The hand is not in the scene.
    Absent,
    /// The recording does not tell.
    Unknown,
}

/// A thing that stays where it is.
#[derive(Debug, Clone)]
pub struct Fixed {
    /// Name.
    pub name: String,
    /// Shape in its own frame.
    pub solid: Solid,
    /// Pose.
    pub pose: Pose,
}

impl Fixed {
    /// Creates a block with half edges `half`, m, around the origin of its pose.
    ///
    /// # Errors
    /// If an edge is not a positive length.
    pub fn block(name: &str, half: Vec3, pose: Pose) -> Result<Self> {
        let mut solid = Solid::default();
        solid.add_cuboid(half, parry3d::math::Pose::IDENTITY)?;
        Ok(Self { name: name.into(), solid, pose })
    }
}

impl Take<'_> {
    /// Returns the first body of the articulated object that a body is a part of; a rigid body is its own.
    pub fn root(&self, body: usize) -> usize {
        let joined_to = |part: &usize| self.bodies.get(*part)?.joined_to.filter(|other| other < part);
        std::iter::successors(Some(body), joined_to).last().unwrap_or(body)
    }

    /// Returns the bodies of the articulated object whose first one is `root`; of a rigid body itself, and of another part none.
    pub fn parts(&self, root: usize) -> impl Iterator<Item = usize> + use<'_> {
        (root..self.bodies.len()).filter(move |part| self.root(*part) == root)
    }

    /// Poses a hand at a frame: (778) vertices, m, world frame; `None` = absent or unknown.
    pub fn vertices(&self, side: Side, frame: usize) -> Option<Vec<Vec3>> {
        match self.hands[side as usize].get(frame)? {
            Tracked::Present(params) => Some(self.models[side as usize].forward(params).vertices),
            Tracked::Absent | Tracked::Unknown => None,
        }
    }

    /// Returns wrist poses of a hand over time, for its noise.
    pub fn wrists(&self, side: Side) -> Vec<Option<Pose>> {
        let wrist = |tracked: &Tracked| match tracked {
            Tracked::Present(params) => Some(Pose {
                position: self.models[side as usize].joints(params)[0].as_dvec3(),
                orientation: glam::DQuat::from_scaled_axis(params.global_orient.as_dvec3()),
            }),
            Tracked::Absent | Tracked::Unknown => None,
        };
        self.hands[side as usize].iter().map(wrist).collect()
    }
}
