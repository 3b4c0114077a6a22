//! Newest pose of the object that a robot hand manipulates.

use std::sync::Mutex;

use glam::{DQuat, DVec3};

use super::lock::lock;
use crate::error::{Error, Result};
use crate::message::{PoseStamped, Time};
use crate::retarget::ObjectPose;

/// Newest message with the pose of an object.
pub(crate) struct LatestObjectPose {
    newest: Mutex<Option<PoseStamped>>,
    /// Largest difference between the stamps of object and hand, s.
    max_age: f64,
}

impl LatestObjectPose {
    /// Starts without a pose; a pose is valid for hands whose stamps differ by at most `max_age` seconds.
    pub(crate) fn new(max_age: f64) -> Self {
        Self { newest: Mutex::new(None), max_age }
    }

    /// Stores the newest message.
    pub(crate) fn update(&self, pose: PoseStamped) {
        *lock(&self.newest) = Some(pose);
    }

    /// Returns the pose of the object for a hand with this stamp and frame; None if the newest pose is too old.
    ///
    /// # Errors
    /// If the pose is in another frame than the hand, or its numbers are not a position and a unit quaternion.
    pub(crate) fn pose_at(&self, stamp: Time, frame_id: &str) -> Result<Option<ObjectPose>> {
        let newest = lock(&self.newest);
        let Some(PoseStamped { header, pose }) = newest.as_ref() else { return Ok(None) };
        if !header.stamp.is_zero() && (header.stamp.secs() - stamp.secs()).abs() > self.max_age {
            return Ok(None);
        }
        // An empty frame_id leaves the frame open, so there is nothing to compare.
        if header.frame_id != frame_id && !header.frame_id.is_empty() && !frame_id.is_empty() {
            return Err(Error::value("object: frame_id", format!("that of the hand, {frame_id}"), &header.frame_id));
        }
        let (position, orientation) = (&pose.position, &pose.orientation);
        let pose = ObjectPose {
            position: DVec3::new(position.x, position.y, position.z),
            orientation: DQuat::from_xyzw(orientation.x, orientation.y, orientation.z, orientation.w),
        };
        pose.checked().map(Some)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{Header, Point, Pose, Quaternion};

    fn message(nanos: i64, frame_id: &str, w: f64) -> PoseStamped {
        let (position, orientation) = (Point { x: 1.0, y: 2.0, z: 3.0 }, Quaternion { x: 0.0, y: 0.0, z: 0.0, w });
        let header = Header { stamp: Time::from_nanos(nanos), frame_id: frame_id.into() };
        PoseStamped { header, pose: Pose { position, orientation } }
    }

    #[test]
    fn a_pose_is_valid_for_max_age_and_in_its_frame() {
        let object = LatestObjectPose::new(0.2);
        let at = |nanos: i64, frame: &str| object.pose_at(Time::from_nanos(nanos), frame);
        assert_eq!(at(1, "world").unwrap(), None);
        object.update(message(1_000_000_000, "world", 1.0));
        let pose = ObjectPose { position: DVec3::new(1.0, 2.0, 3.0), orientation: DQuat::IDENTITY };
        assert_eq!(at(1_150_000_000, "world").unwrap(), Some(pose));
        assert_eq!(at(900_000_000, "").unwrap(), Some(pose));
        assert_eq!(at(1_250_000_000, "world").unwrap(), None);
        let error = at(1_000_000_000, "camera").unwrap_err().to_string();
        assert!(error.contains("frame_id") && error.contains("camera") && error.contains("world"), "{error}");
        object.update(message(1_000_000_000, "world", 0.0));
        assert!(at(1_000_000_000, "world").unwrap_err().to_string().contains("length 1"));
        object.update(message(0, "world", 1.0));
        assert_eq!(at(77_000_000_000, "world").unwrap(), Some(pose), "a pose without a stamp never expires");
    }
}
