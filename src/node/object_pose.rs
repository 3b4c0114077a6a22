//! Newest pose of the object that a robot hand manipulates.

use std::collections::VecDeque;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use glam::{DQuat, DVec3};

use super::lock::lock;
use super::transforms::{LookupError, Transforms};
use crate::error::{Error, Result};
use crate::message::{PoseStamped, Time};
use crate::retarget::ObjectPose;

/// Number of newest messages that may wait for their transforms; a second at 60 Hz.
const MAX_WAITING: usize = 60;

/// Newest poses of an object.
pub(crate) struct LatestObjectPose {
    /// Newest messages and their arrivals, oldest first.
    newest: Mutex<VecDeque<(PoseStamped, Instant)>>,
    transforms: Transforms,
    /// Largest difference between the stamps of object and hand, s.
    max_age: f64,
    /// Longest wait of a pose in another frame for the transform of its stamp.
    patience: Duration,
}

impl LatestObjectPose {
    /// Starts without a pose. A pose is valid for hands whose stamps differ by at most `max_age` seconds. While poses in another frame
    /// than the hand wait for the transforms of their stamps, the newest one with a transform counts; after `patience` without any,
    /// it is an error.
    pub(crate) fn new(transforms: Transforms, max_age: f64, patience: Duration) -> Self {
        Self { newest: Mutex::default(), transforms, max_age, patience }
    }

    /// Stores the newest message.
    pub(crate) fn update(&self, pose: PoseStamped, now: Instant) {
        let mut newest = lock(&self.newest);
        if newest.len() == MAX_WAITING {
            newest.pop_front();
        }
        newest.push_back((pose, now));
    }

    /// Returns the pose of the object for a hand with this stamp and frame; None if no pose is recent enough.
    ///
    /// # Errors
    /// If the newest pose is in a frame from which no transform leads to that of the hand, or its numbers are not a position and a
    /// unit quaternion.
    pub(crate) fn pose_at(&self, stamp: Time, frame_id: &str, now: Instant) -> Result<Option<ObjectPose>> {
        let mut newest = lock(&self.newest);
        let is_recent = |of: Time| of.is_zero() || (of.secs() - stamp.secs()).abs() <= self.max_age;
        let mut waits_for = None;
        for index in (0..newest.len()).rev() {
            let (message, arrived) = &newest[index];
            if !is_recent(message.header.stamp) {
                break;
            }
            match self.in_frame(message, frame_id)? {
                Ok(pose) => {
                    // Those before it are of no more use.
                    newest.drain(..index);
                    return Ok(Some(pose));
                }
                Err(reason) => waits_for = Some((reason, message.header.frame_id.clone(), *arrived)),
            }
        }
        match waits_for {
            Some((reason, frame, arrived)) if now.saturating_duration_since(arrived) >= self.patience => {
                let expected = format!("{frame_id}, the frame of the hand, or one with a transform to it");
                Err(Error::value("frame_id", expected, format!("{frame}: {reason}")))
            }
            _ => Ok(None),
        }
    }

    /// Returns the pose of a message in the frame of the hand, or the reason why there is no transform.
    ///
    /// # Errors
    /// If the numbers are not a position and a unit quaternion.
    fn in_frame(
        &self,
        PoseStamped { header, pose }: &PoseStamped,
        frame_id: &str,
    ) -> Result<std::result::Result<ObjectPose, LookupError>> {
        let (position, orientation) = (&pose.position, &pose.orientation);
        let pose = ObjectPose {
            position: DVec3::new(position.x, position.y, position.z),
            orientation: DQuat::from_xyzw(orientation.x, orientation.y, orientation.z, orientation.w),
        }
        .checked()?;
        // An empty frame_id leaves the frame open, so there is nothing to transform.
        if header.frame_id == frame_id || header.frame_id.is_empty() || frame_id.is_empty() {
            return Ok(Ok(pose));
        }
        let motion = self.transforms.tree().lookup(frame_id, &header.frame_id, header.stamp);
        Ok(motion.map(|motion| ObjectPose {
            position: motion.rotation * pose.position + motion.translation,
            orientation: (motion.rotation * pose.orientation).normalize(),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{Header, Point, Pose, Quaternion, Transform, TransformStamped, Vector3};

    const PATIENCE: Duration = Duration::from_millis(100);

    fn message(nanos: i64, frame_id: &str, w: f64) -> PoseStamped {
        let (position, orientation) = (Point { x: 1.0, y: 2.0, z: 3.0 }, Quaternion { x: 0.0, y: 0.0, z: 0.0, w });
        let header = Header { stamp: Time::from_nanos(nanos), frame_id: frame_id.into() };
        PoseStamped { header, pose: Pose { position, orientation } }
    }

    fn moved(nanos: i64, parent: &str, child: &str, x: f64) -> TransformStamped {
        TransformStamped {
            header: Header { stamp: Time::from_nanos(nanos), frame_id: parent.into() },
            child_frame_id: child.into(),
            transform: Transform { translation: Vector3 { x, y: 0.0, z: 0.0 }, rotation: Quaternion::default() },
        }
    }

    #[test]
    fn a_pose_is_valid_for_max_age_and_in_its_frame() {
        let object = LatestObjectPose::new(Transforms::default(), 0.2, Duration::ZERO);
        let now = Instant::now();
        let at = |nanos: i64, frame: &str| object.pose_at(Time::from_nanos(nanos), frame, now);
        assert_eq!(at(1, "world").unwrap(), None);
        object.update(message(1_000_000_000, "world", 1.0), now);
        let pose = ObjectPose { position: DVec3::new(1.0, 2.0, 3.0), orientation: DQuat::IDENTITY };
        assert_eq!(at(1_150_000_000, "world").unwrap(), Some(pose));
        assert_eq!(at(900_000_000, "").unwrap(), Some(pose));
        assert_eq!(at(1_250_000_000, "world").unwrap(), None);
        let error = at(1_000_000_000, "camera").unwrap_err().to_string();
        assert!(error.contains("frame_id") && error.contains("camera") && error.contains("world"), "{error}");
        object.update(message(1_000_000_000, "world", 0.0), now);
        assert!(at(1_000_000_000, "world").unwrap_err().to_string().contains("length 1"));
        object.update(message(0, "world", 1.0), now);
        assert_eq!(at(77_000_000_000, "world").unwrap(), Some(pose), "a pose without a stamp never expires");
    }

    #[test]
    fn the_newest_pose_with_a_transform_counts_and_without_one_a_pose_waits() {
        let transforms = Transforms::default();
        let object = LatestObjectPose::new(transforms.clone(), 1.0, PATIENCE);
        let start = Instant::now();
        let at = |nanos: i64, after: Duration| {
            object.pose_at(Time::from_nanos(nanos), "camera", start + after).map(|pose| pose.map(|p| p.position.x))
        };
        let add = |transform| transforms.tree().insert(&transform, false).unwrap();
        object.update(message(1_000_000_000, "world", 1.0), start);
        assert_eq!(at(1_000_000_000, Duration::ZERO).unwrap(), None, "it waits");
        let error = at(1_000_000_000, 2 * PATIENCE).unwrap_err().to_string();
        assert!(error.contains("no transform of the frame world") && error.contains("camera"), "{error}");
        add(moved(1_000_000_000, "camera", "world", 10.0));
        assert_eq!(at(1_000_000_000, Duration::ZERO).unwrap(), Some(11.0));
        // Transforms that always come late: each pose is used once its transform is there.
        for nanos in [1_100_000_000, 1_200_000_000] {
            object.update(message(nanos, "world", 1.0), start);
        }
        assert_eq!(at(1_200_000_000, 2 * PATIENCE).unwrap(), Some(11.0), "the pose before");
        add(moved(1_150_000_000, "camera", "world", 13.0));
        assert_eq!(at(1_200_000_000, Duration::ZERO).unwrap(), Some(13.0), "interpolated at 1.1 s");
        add(moved(1_250_000_000, "camera", "world", 15.0));
        assert_eq!(at(1_200_000_000, Duration::ZERO).unwrap(), Some(15.0), "interpolated at 1.2 s");
        assert!(matches!(at(3_000_000_000, 2 * PATIENCE), Ok(None)), "too old");
    }
}
