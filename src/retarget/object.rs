//! Object that the hand holds or touches: its pose relative to the robot, as it is relative to the human's hand.
//!
//! Its shapes are part of the robot's model ([`crate::mujoco::object`]). Links stay out of it, and fingertips that touch lie
//! on its surface, although the two hands differ.

use glam::{DMat3, DQuat, DVec3};

use super::filter::Smoother;
use super::human::Hand;
use super::robot::Robot;
use crate::error::{Error, Result};
use crate::hand::Side;

/// Distance from the object's origin of the points on two of its axes, whose smoothing smooths its rotation, m.
const AXIS_LENGTH: f64 = 0.1;
/// Greatest deviation of a quaternion's length from 1: rounding of 32-bit senders.
const MAX_LENGTH_ERROR: f64 = 1e-3;

/// Pose of an object in the frame of the keypoints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObjectPose {
    /// Origin of the object, m.
    pub position: DVec3,
    /// Rotation from the object's axes to those of the keypoints' frame.
    pub orientation: DQuat,
}

impl ObjectPose {
    /// Validates position and quaternion, and normalises the quaternion.
    ///
    /// # Errors
    /// If a number is not finite, or the quaternion's length differs from 1 by more than 0.001.
    pub fn checked(self) -> Result<Self> {
        let length = self.orientation.length();
        if !self.position.is_finite() {
            return Err(Error::value("object_pose", "finite metres", self.position));
        }
        if length.is_nan() || (length - 1.0).abs() > MAX_LENGTH_ERROR {
            return Err(Error::value("object_pose", "a quaternion of length 1", self.orientation));
        }
        Ok(Self { orientation: self.orientation.normalize(), ..self })
    }
}

/// Tracks an object with the delay of the keypoints' filter, so that it keeps its place relative to the fingertips.
#[derive(Debug)]
pub struct ObjectTracker {
    smoother: Smoother<3>,
}

impl ObjectTracker {
    /// Creates a tracker with the delay of the fingertips' filter, s.
    pub fn new(delay: f64) -> Self {
        Self { smoother: Smoother::new(delay) }
    }

    /// Forgets where the object was.
    pub fn reset(&mut self) {
        self.smoother.reset();
    }

    /// Validates a pose for a robot; `side`: of the human hand.
    ///
    /// # Errors
    /// If it is not a pose, the robot was loaded without object, or it is a hand of the other side.
    pub fn check(&self, robot: &Robot, side: Side, pose: Option<ObjectPose>) -> Result<Option<ObjectPose>> {
        let Some(pose) = pose else { return Ok(None) };
        if robot.object.is_none() {
            return Err(Error::value("object_pose", "a robot that was loaded with an object", "a robot alone"));
        }
        if robot.side() != side {
            let expected = format!("a {} hand like the robot's, as objects are not mirrored", robot.side().name());
            return Err(Error::value("object_pose", expected, format!("a {} hand", side.name())));
        }
        pose.checked().map(Some)
    }

    /// Places the robot's object relative to the robot as `pose` is relative to the human's `hand`.
    ///
    /// `pose`: None = absent; `dt`: seconds since the last frame; `bases`: mean position of the robot's and the human's finger
    /// bases in their wrist frames, m, which coincide unless the robot defines its wrist position.
    pub fn push(&mut self, robot: &mut Robot, hand: &Hand, pose: Option<ObjectPose>, dt: f64, bases: [DVec3; 2]) {
        let Some(ObjectPose { position, orientation }) = pose else {
            self.reset();
            robot.place_object(None);
            return;
        };
        let into = hand.axes.transpose();
        let (position, axes) = (into * (position - hand.wrist), into * DMat3::from_quat(orientation));
        let points = [position, position + AXIS_LENGTH * axes.x_axis, position + AXIS_LENGTH * axes.y_axis];
        let [position, x, y] = self.smoother.push(&points, dt);
        let x = (x - position).try_normalize().unwrap_or(axes.x_axis);
        let y = (y - position).reject_from_normalized(x).try_normalize().unwrap_or(axes.y_axis);
        // The wrist frame of a left hand is left-handed, and so are the object's axes in it.
        let z = hand.axes.determinant().signum() * x.cross(y);
        let wrist_axes = robot.wrist.world_axes(&robot.world);
        let (origin, _) = robot.world.body_pose(robot.wrist.body);
        let [robot_bases, human_bases] = bases;
        let position = match robot.wrist_position {
            Some(wrist) => wrist_axes.transpose() * wrist + position,
            None => robot_bases + (position - human_bases),
        };
        let orientation = DQuat::from_mat3(&(wrist_axes * DMat3::from_cols(x, y, z)));
        robot.place_object(Some((origin + wrist_axes * position, orientation)));
        robot.world.update_poses();
    }
}
