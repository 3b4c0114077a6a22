//! The newest pose of the object that a robot hand is about.

use std::sync::{Mutex, PoisonError};

use glam::{DQuat, DVec3};

use crate::error::{Error, Result};
use crate::message::{PoseStamped, Time};
use crate::retarget::ObjectPose;

/// Follows the messages of an object's pose.
pub struct HeldObject {
    newest: Mutex<Option<PoseStamped>>,
    /// How far the stamps of object and hand may be apart, s.
    patience: f64,
}

impl HeldObject {
    /// Of which nothing is known yet; poses count for hands up to `patience` seconds away.
    pub fn new(patience: f64) -> Self {
        Self { newest: Mutex::new(None), patience }
    }

    /// Takes a message.
    pub fn see(&self, pose: PoseStamped) {
        *self.newest.lock().unwrap_or_else(PoisonError::into_inner) = Some(pose);
    }

    /// Where the object is for a hand of a stamp and frame; None if nothing new enough is known.
    ///
    /// # Errors
    /// If the pose is in another frame than the hand, or is no pose.
    pub fn at(&self, stamp: Time, frame_id: &str) -> Result<Option<ObjectPose>> {
        let newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(PoseStamped { header, pose }) = newest.as_ref() else { return Ok(None) };
        if !header.stamp.is_zero() && (header.stamp.secs() - stamp.secs()).abs() > self.patience {
            return Ok(None);
        }
        // A tracker without frames says nothing.
        if header.frame_id != frame_id && !header.frame_id.is_empty() && !frame_id.is_empty() {
            return Err(Error::value("object: frame_id", format!("that of the hand, {frame_id}"), &header.frame_id));
        }
        let (place, turn) = (&pose.position, &pose.orientation);
        let pose = ObjectPose {
            position: DVec3::new(place.x, place.y, place.z),
            orientation: DQuat::from_xyzw(turn.x, turn.y, turn.z, turn.w),
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
    fn a_pose_counts_for_a_while_and_in_its_frame() {
        let object = HeldObject::new(0.2);
        let at = |nanos: i64, frame: &str| object.at(Time::from_nanos(nanos), frame);
        assert_eq!(at(1, "world").unwrap(), None);
        object.see(message(1_000_000_000, "world", 1.0));
        let pose = ObjectPose { position: DVec3::new(1.0, 2.0, 3.0), orientation: DQuat::IDENTITY };
        assert_eq!(at(1_150_000_000, "world").unwrap(), Some(pose));
        assert_eq!(at(900_000_000, "").unwrap(), Some(pose));
        assert_eq!(at(1_250_000_000, "world").unwrap(), None);
        let error = at(1_000_000_000, "camera").unwrap_err().to_string();
        assert!(error.contains("frame_id") && error.contains("camera") && error.contains("world"), "{error}");
        object.see(message(1_000_000_000, "world", 0.0));
        assert!(at(1_000_000_000, "world").unwrap_err().to_string().contains("length 1"));
        object.see(message(0, "world", 1.0));
        assert_eq!(at(77_000_000_000, "world").unwrap(), Some(pose), "without a stamp it is the newest");
    }
}
