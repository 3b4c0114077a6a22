//! One frame of a rollout: the record of a data set and further ground truth.

use glam::{DQuat, DVec3};

use super::camera::CameraPose;
use super::contact::HandForce;
use crate::dataset::Frame;

/// One frame of a rollout. All poses are in the world frame.
#[derive(Debug, Clone)]
pub struct SimFrame {
    /// Picture, touch and hand poses, as data sets store them.
    pub frame: Frame,
    /// (1556) 1 = an object's surface is within 1 cm (the paper's label).
    pub proximity: Vec<u8>,
    /// (1556) sliding speed of touching surfaces, m/s; `None` if it is not observed.
    pub slip: Option<Vec<f32>>,
    /// (H, W) distance from the camera plane, m; `None` if it is not observed.
    pub depth: Option<Vec<f32>>,
    /// Forces on the left and the right hand, with residuals; `None` = hand absent, or no dynamics.
    pub hands: [Option<HandForce>; 2],
    /// Poses of the solid objects, in the episode's order.
    pub objects: Vec<ObjectPose>,
    /// Pose of the camera.
    pub camera: CameraPose,
    /// Readings of the taxels of the left and the right glove, (N) N each; `None` if the hands wear none.
    pub taxels: Option<[Vec<f32>; 2]>,
}

/// Named pose `world_from_object`.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectPose {
    /// Name of the object.
    pub name: String,
    /// Position, m.
    pub position: DVec3,
    /// Orientation.
    pub orientation: DQuat,
}
