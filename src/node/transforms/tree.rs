//! Tree of coordinate frames.

use std::collections::HashMap;
use std::fmt;

use glam::{DQuat, DVec3};

use super::buffer::{Buffer, CACHE_NANOS, Motion, Outside};
use crate::error::{Error, Result};
use crate::message::{Quaternion, Time, TransformStamped, Vector3};

/// Largest error of a quaternion's length; publishers round.
const MAX_LENGTH_ERROR: f64 = 1e-2;
/// Largest number of frames, far above that of any robot, so that invented names can't fill the memory.
const MAX_FRAMES: usize = 10_000;
/// Largest number of frames between a frame and its root; a longer way is a loop.
const MAX_DEPTH: usize = 1_000;

/// Frames by name, each with its motion in its parent over the last ten seconds.
#[derive(Debug, Default)]
pub(crate) struct FrameTree {
    frames: HashMap<String, Buffer>,
}

/// Reason why there is no transform between two frames.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum LookupError {
    /// No transform names this frame.
    UnknownFrame(String),
    /// The frames belong to different trees.
    NotConnected(String, String),
    /// Frames are their own ancestors.
    Loop(String),
    /// The newest transform of a frame is older than the time asked for, by these nanoseconds; a later one may come.
    TooNew(String, i64),
    /// The oldest transform of a frame is newer than the time asked for, by these nanoseconds.
    TooOld(String, i64),
}

impl fmt::Display for LookupError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UnknownFrame(frame) => write!(f, "no transform of the frame {frame} on /tf or /tf_static"),
            Self::NotConnected(a, b) => write!(f, "the frames {a} and {b} are not connected on /tf and /tf_static"),
            Self::Loop(frame) => write!(f, "the frame {frame} is its own ancestor on /tf and /tf_static"),
            Self::TooNew(frame, by) => {
                write!(f, "the newest transform of the frame {frame} is {:.3} s too old", *by as f64 * 1e-9)
            }
            Self::TooOld(frame, by) => {
                write!(f, "the oldest transform of the frame {frame} is {:.3} s too new", *by as f64 * 1e-9)
            }
        }
    }
}

impl FrameTree {
    /// Adds the pose of a frame in its parent. A frame that gets another parent forgets its motion in the former one; a stamp more
    /// than ten seconds back means that time restarted, and all frames that move forget their motion.
    ///
    /// # Errors
    /// If a name is empty, a frame is its own parent, a number is not finite, the rotation is not a unit quaternion, or there
    /// are too many frames.
    pub(crate) fn insert(&mut self, transform: &TransformStamped, is_static: bool) -> Result<()> {
        let (parent, child) = (name_of(&transform.header.frame_id), name_of(&transform.child_frame_id));
        if parent.is_empty() || child.is_empty() || parent == child {
            let got = format!("{parent:?} and {child:?}");
            return Err(Error::value("header.frame_id and child_frame_id", "two different names", got));
        }
        let motion = motion_of(transform)?;
        let time = transform.header.stamp.nanos();
        if !self.frames.contains_key(child) && self.frames.len() >= MAX_FRAMES {
            return Err(Error::value("frames", format!("at most {MAX_FRAMES}"), child));
        }
        match self.frames.get_mut(child).filter(|buffer| buffer.parent == parent) {
            Some(buffer) => {
                if !buffer.insert(is_static, time, motion) {
                    self.frames.retain(|_, buffer| buffer.newest().is_none_or(|newest| newest - time <= CACHE_NANOS));
                    self.frames.insert(child.to_owned(), Buffer::new(parent.to_owned(), is_static, time, motion));
                }
            }
            None => {
                self.frames.insert(child.to_owned(), Buffer::new(parent.to_owned(), is_static, time, motion));
            }
        }
        Ok(())
    }

    /// Returns the motion from coordinates in `source` to those in `target` at `stamp`; a zero stamp means the newest time at which
    /// all frames between them are known.
    ///
    /// # Errors
    /// If there is no such motion; the error gives the reason.
    pub(crate) fn lookup(&self, target: &str, source: &str, stamp: Time) -> std::result::Result<Motion, LookupError> {
        let (target, source) = (name_of(target), name_of(source));
        if target == source {
            return Ok(Motion::IDENTITY);
        }
        let (mut up, mut down) = (self.way_to_root(source)?, self.way_to_root(target)?);
        for name in [source, target] {
            if !self.frames.contains_key(name) && !self.frames.values().any(|buffer| buffer.parent == name) {
                return Err(LookupError::UnknownFrame(name.to_owned()));
            }
        }
        if up.last() != down.last() {
            return Err(LookupError::NotConnected(target.to_owned(), source.to_owned()));
        }
        // Frames above the common ancestor move nothing relative to each other.
        while up.len() > 1 && down.len() > 1 && up[up.len() - 2] == down[down.len() - 2] {
            up.pop();
            down.pop();
        }
        up.pop();
        down.pop();
        let time = match stamp.is_zero() {
            true => up.iter().chain(&down).filter_map(|name| self.frames[*name].newest()).min().unwrap_or(0),
            false => stamp.nanos(),
        };
        let ancestor_from_source = self.motion_along(&up, time)?;
        let ancestor_from_target = self.motion_along(&down, time)?;
        Ok(ancestor_from_target.inverse().after(ancestor_from_source))
    }

    /// Returns the names from a frame to the root of its tree, both included.
    fn way_to_root<'a>(&'a self, frame: &'a str) -> std::result::Result<Vec<&'a str>, LookupError> {
        let mut way = vec![frame];
        let mut name = frame;
        while let Some(buffer) = self.frames.get(name) {
            name = &buffer.parent;
            way.push(name);
            if way.len() > MAX_DEPTH {
                return Err(LookupError::Loop(frame.to_owned()));
            }
        }
        Ok(way)
    }

    /// Returns the motion from the first frame to the parent of the last one at a time.
    fn motion_along(&self, way: &[&str], time: i64) -> std::result::Result<Motion, LookupError> {
        let mut motion = Motion::IDENTITY;
        for name in way {
            let step = self.frames[*name].at(time).map_err(|outside| match outside {
                Outside::Future(newest) => LookupError::TooNew((*name).to_owned(), time - newest),
                Outside::Past(oldest) => LookupError::TooOld((*name).to_owned(), oldest - time),
            })?;
            motion = step.after(motion);
        }
        Ok(motion)
    }
}

/// Returns a frame's name as tf2 compares it: without the leading slash of ROS 1.
fn name_of(frame: &str) -> &str {
    frame.strip_prefix('/').unwrap_or(frame)
}

fn motion_of(transform: &TransformStamped) -> Result<Motion> {
    let Vector3 { x, y, z } = transform.transform.translation;
    let translation = DVec3::new(x, y, z);
    let Quaternion { x, y, z, w } = transform.transform.rotation;
    let rotation = DQuat::from_xyzw(x, y, z, w);
    if !translation.is_finite() {
        return Err(Error::value("transform.translation", "finite metres", translation));
    }
    let length = rotation.length();
    if length.is_nan() || (length - 1.0).abs() > MAX_LENGTH_ERROR {
        return Err(Error::value("transform.rotation", "a unit quaternion", format!("length {length}")));
    }
    Ok(Motion { translation, rotation: rotation.normalize() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{Header, Transform};
    use glam::DMat4;

    fn matrix(seed: f64) -> DMat4 {
        let axis = DVec3::new(seed.sin(), (2.0 * seed).cos(), 0.5).normalize();
        DMat4::from_rotation_translation(DQuat::from_axis_angle(axis, seed), DVec3::new(seed, -0.5 * seed, 0.25))
    }

    fn stamped(parent: &str, child: &str, nanos: i64, pose: DMat4) -> TransformStamped {
        let (_, rotation, translation) = pose.to_scale_rotation_translation();
        TransformStamped {
            header: Header { stamp: Time::from_nanos(nanos), frame_id: parent.into() },
            child_frame_id: child.into(),
            transform: Transform {
                translation: Vector3 { x: translation.x, y: translation.y, z: translation.z },
                rotation: Quaternion { x: rotation.x, y: rotation.y, z: rotation.z, w: rotation.w },
            },
        }
    }

    fn tree(transforms: &[(TransformStamped, bool)]) -> FrameTree {
        let mut tree = FrameTree::default();
        transforms.iter().for_each(|(transform, is_static)| tree.insert(transform, *is_static).unwrap());
        tree
    }

    const SEC: i64 = 1_000_000_000;
    const fn at(nanos: i64) -> Time {
        Time { sec: (nanos / SEC) as i32, nanosec: (nanos % SEC) as u32 }
    }

    /// Two arms of a tree: world -> base (static) -> camera, and world -> table (static) -> object.
    fn arms() -> FrameTree {
        tree(&[
            (stamped("world", "base", 0, matrix(0.3)), true),
            (stamped("base", "camera", SEC, matrix(0.7)), false),
            (stamped("/world", "table", 0, matrix(1.1)), true),
            (stamped("table", "object", SEC, matrix(1.9)), false),
        ])
    }

    #[test]
    fn a_transform_is_the_product_of_matrices_along_the_way() {
        let found = arms().lookup("camera", "object", at(SEC)).unwrap();
        let expected = (matrix(0.3) * matrix(0.7)).inverse() * matrix(1.1) * matrix(1.9);
        let point = DVec3::new(0.1, 0.2, -0.3);
        let moved = found.rotation * point + found.translation;
        assert!((moved - expected.transform_point3(point)).length() < 1e-12);
        let back = arms().lookup("object", "camera", at(SEC)).unwrap();
        assert!((back.rotation * moved + back.translation - point).length() < 1e-12);
    }

    #[test]
    fn motion_between_samples_is_interpolated() {
        let mut tree = FrameTree::default();
        let turned = |angle: f64| DMat4::from_rotation_translation(DQuat::from_rotation_z(angle), DVec3::X * angle);
        for (nanos, angle) in [(2 * SEC, 1.2), (SEC, 0.2)] {
            tree.insert(&stamped("a", "b", nanos, turned(angle)), false).unwrap();
        }
        let quarter = tree.lookup("a", "b", at(SEC + SEC / 4)).unwrap();
        assert!((quarter.translation.x - 0.45).abs() < 1e-12);
        assert!(quarter.rotation.angle_between(DQuat::from_rotation_z(0.45)) < 1e-7);
        assert_eq!(tree.lookup("a", "b", Time::default()).unwrap().translation.x, 1.2, "zero means the newest");
        assert_eq!(tree.lookup("a", "b", at(3 * SEC)), Err(LookupError::TooNew("b".into(), SEC)));
        assert_eq!(tree.lookup("a", "b", at(SEC / 2)), Err(LookupError::TooOld("b".into(), SEC / 2)));
    }

    #[test]
    fn the_newest_common_time_serves_a_zero_stamp_and_only_frames_on_the_way_count() {
        let mut tree = arms();
        tree.insert(&stamped("base", "camera", 2 * SEC, matrix(0.9)), false).unwrap();
        // `object` is known until 1 s.
        let at_one = tree.lookup("camera", "object", at(SEC)).unwrap();
        assert_eq!(tree.lookup("camera", "object", Time::default()).unwrap(), at_one);
        assert!(tree.lookup("base", "camera", at(2 * SEC)).is_ok());
        assert_eq!(tree.lookup("world", "object", at(2 * SEC)), Err(LookupError::TooNew("object".into(), SEC)));
    }

    #[test]
    fn frames_without_a_way_between_them_are_named() {
        let mut tree = arms();
        assert_eq!(tree.lookup("camera", "cup", at(SEC)), Err(LookupError::UnknownFrame("cup".into())));
        tree.insert(&stamped("elsewhere", "cup", SEC, matrix(0.1)), false).unwrap();
        let error = tree.lookup("camera", "cup", at(SEC)).unwrap_err();
        assert_eq!(error, LookupError::NotConnected("camera".into(), "cup".into()));
        tree.insert(&stamped("camera", "world", SEC, matrix(0.1)), false).unwrap();
        assert!(matches!(tree.lookup("camera", "object", at(SEC)), Err(LookupError::Loop(_))));
    }

    #[test]
    fn transforms_that_are_none_are_refused_and_a_restart_of_time_forgets_the_motion() {
        let mut tree = arms();
        let mut nan = stamped("a", "b", SEC, matrix(0.1));
        nan.transform.translation.x = f64::NAN;
        assert!(tree.insert(&nan, false).unwrap_err().to_string().contains("translation"));
        let mut long = stamped("a", "b", SEC, matrix(0.1));
        long.transform.rotation = Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 0.0 };
        assert!(tree.insert(&long, false).unwrap_err().to_string().contains("unit quaternion"));
        assert!(tree.insert(&stamped("a", "/a", SEC, matrix(0.1)), false).is_err());
        tree.insert(&stamped("base", "camera", 100 * SEC, matrix(0.5)), false).unwrap();
        tree.insert(&stamped("base", "camera", 3 * SEC, matrix(0.6)), false).unwrap();
        assert!(tree.lookup("base", "camera", at(3 * SEC)).is_ok(), "time restarted");
        assert!(tree.lookup("world", "base", at(3 * SEC)).is_ok(), "what is static stays");
    }

    #[test]
    fn memory_is_bounded() {
        let mut tree = FrameTree::default();
        for i in 0..200_000 {
            tree.insert(&stamped("a", "b", i * SEC / 100_000, DMat4::IDENTITY), false).unwrap();
        }
        assert!(tree.lookup("a", "b", at(2 * SEC - SEC / 100_000)).is_ok());
        assert!(tree.lookup("a", "b", at(SEC)).is_err());
        let refused =
            (0..20_000).filter(|i| tree.insert(&stamped("a", &format!("f{i}"), SEC, DMat4::IDENTITY), false).is_err());
        assert_eq!(refused.count(), 20_000 - (MAX_FRAMES - 1));
    }
}
