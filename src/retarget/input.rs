//! Input of the retargeter.

use glam::DVec3;

use super::object::ObjectPose;
use super::touch::Touch;
use crate::hand::N_KEYPOINTS;

/// One frame of a human hand.
#[derive(Debug, Clone)]
pub struct Input {
    /// (21) keypoints in any right-handed frame, m: wrist, then thumb, index, middle, ring, little, each from base to tip.
    pub keypoints: [DVec3; N_KEYPOINTS],
    /// Time of the frame, s.
    pub time: f64,
    /// Touch of the hand; None = unknown: then fingertips that are close count as touching each other.
    pub touch: Option<Touch>,
    /// Pose of the object that the robot was loaded with, in the frame of the keypoints; None = absent.
    pub object: Option<ObjectPose>,
}

impl Input {
    /// Creates a frame without touch or object.
    pub fn new(keypoints: [DVec3; N_KEYPOINTS], time: f64) -> Self {
        Self { keypoints, time, touch: None, object: None }
    }
}
