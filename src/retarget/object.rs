//! The object that the hand is about, where it is for the robot: as it lies to the human's hand.
//!
//! Its shapes are of the robot's model ([`crate::mujoco::object`]). Links stay out of it, and fingertips that touch are on
//! it, whatever the difference between the two hands.

use glam::{DMat3, DQuat, DVec3};

use super::filter::Smoother;
use super::human::Hand;
use super::robot::Robot;
use crate::error::{Error, Result};
use crate::hand::Side;

/// Length along the axes at which points of the object are smoothed, m.
const ARM: f64 = 0.1;

/// Where an object is: its frame in that of the keypoints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Origin, m.
    pub place: DVec3,
    /// From the object's axes to the keypoints'.
    pub orientation: DQuat,
}

impl Pose {
    /// Refuses what is no place and no rotation; makes the rotation's length exact.
    ///
    /// # Errors
    /// If a number is not finite, or the quaternion's length is off 1 by more than a thousandth.
    pub fn checked(self) -> Result<Self> {
        let length = self.orientation.length();
        if !self.place.is_finite() {
            return Err(Error::value("object_pose", "finite metres", self.place));
        }
        if length.is_nan() || (length - 1.0).abs() > 1e-3 {
            return Err(Error::value("object_pose", "a quaternion of length 1", self.orientation));
        }
        Ok(Self { orientation: self.orientation.normalize(), ..self })
    }
}

/// Follows an object as the keypoints are followed, with the same delay, so that it stays where it is to them.
#[derive(Debug)]
pub struct Follower {
    smoother: Smoother<3>,
}

impl Follower {
    /// With the delay of the fingertips' filter, s.
    pub fn new(delay: f64) -> Self {
        Self { smoother: Smoother::new(delay) }
    }

    /// Forgets where it was.
    pub fn reset(&mut self) {
        self.smoother.reset();
    }

    /// Refuses a pose that can't be followed; `side` is the human hand's.
    ///
    /// # Errors
    /// If it is no pose, or the robot has no object, or is the other hand.
    pub fn check(&self, robot: &Robot, side: Side, pose: Option<Pose>) -> Result<Option<Pose>> {
        let Some(pose) = pose else { return Ok(None) };
        if robot.object.is_none() {
            return Err(Error::value("object_pose", "a robot that was loaded with an object", "a robot alone"));
        }
        if robot.side() != side {
            let expected = format!("a {} hand, as the robot's: the object is no mirror image", robot.side().name());
            return Err(Error::value("object_pose", expected, format!("a {} hand", side.name())));
        }
        pose.checked().map(Some)
    }

    /// Places the robot's object: as `pose` lies to the human's `hand`, `dt` seconds after the last one. The fingers'
    /// bases of both hands, `robot_bases` and `human_bases` in the wrist frames, lie over each other. None = there is none.
    pub fn push(
        &mut self,
        robot: &mut Robot,
        hand: &Hand,
        pose: Option<Pose>,
        dt: f64,
        [robot_bases, human_bases]: [DVec3; 2],
    ) {
        let Some(Pose { place, orientation }) = pose else {
            self.reset();
            robot.place_object(None);
            return;
        };
        let into = hand.axes.transpose();
        let (place, axes) = (into * (place - hand.wrist), into * DMat3::from_quat(orientation));
        let points = [place, place + ARM * axes.x_axis, place + ARM * axes.y_axis];
        let [place, x, y] = self.smoother.push(&points, dt);
        let x = (x - place).try_normalize().unwrap_or(axes.x_axis);
        let y = (y - place).reject_from_normalized(x).try_normalize().unwrap_or(axes.y_axis);
        // A left hand's coordinates turn the other way.
        let z = hand.axes.determinant().signum() * x.cross(y);
        let frame = robot.wrist.world_axes(&robot.world);
        let (origin, _) = robot.world.body_pose(robot.wrist.body);
        let place = match robot.wrist_position {
            Some(wrist) => frame.transpose() * wrist + place,
            None => robot_bases + (place - human_bases),
        };
        let turned = DQuat::from_mat3(&(frame * DMat3::from_cols(x, y, z)));
        robot.place_object(Some((origin + frame * place, turned)));
        robot.world.update_poses();
    }
}
