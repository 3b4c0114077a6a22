//! Hands of UmeTrack, the model of HOT3D's trackers: keypoints from joint angles and a person's profile.

use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};

use super::input::json::Json;
use crate::error::Result;
use crate::hand::{N_KEYPOINTS, Side};

/// Joints that bend fingers, four per finger from the thumb on.
const JOINTS: usize = 20;
/// Joints of one finger: two at its base.
const PER_FINGER: usize = 4;
/// Frames that landmarks follow: root, wrist, three per finger.
const FRAMES: usize = 2 + 3 * 5;
/// Landmarks that make keypoints: tips, wrist, then the joints of each finger.
const LANDMARKS: usize = 20;
/// Unit of the profile, m.
const MILLIMETRE: f64 = 0.001;
/// Landmark of each keypoint; the base of the thumb is a joint and no landmark.
const LANDMARK_OF: [Option<usize>; N_KEYPOINTS] = {
    let mut of = [Some(5); N_KEYPOINTS];
    (of[1], of[2], of[3], of[4]) = (None, Some(6), Some(7), Some(0));
    let mut finger = 1;
    while finger < 5 {
        let base = 1 + 4 * finger;
        (of[base], of[base + 1]) = (Some(5 + 3 * finger), Some(6 + 3 * finger));
        (of[base + 2], of[base + 3]) = (Some(7 + 3 * finger), Some(finger));
        finger += 1;
    }
    of
};

/// A person's profile: a left hand at rest, in the frame of the wrist.
#[derive(Debug, Clone)]
pub struct UmeTrack {
    /// (20) axis and position, m, of each joint.
    joints: Vec<(DVec3, DVec3)>,
    /// (20) position of each landmark, m, and the frames that it follows with their weights.
    landmarks: Vec<(DVec3, Vec<(usize, f64)>)>,
}

impl UmeTrack {
    /// Reads the part `umetrack` of the hands' shapes; `None` if it is absent or empty.
    ///
    /// # Errors
    /// If a field is absent or out of range; the error names it.
    pub fn parse(profile: &Json) -> Result<Option<Self>> {
        if profile.entries().is_empty() {
            return Ok(None);
        }
        let rows = |field: &str, least: usize| {
            let (rows, list) = (profile.get(field).items(), profile.get(field));
            if rows.len() < least { Err(list.expected(&format!("at least {least} rows"))) } else { Ok(rows) }
        };
        let vectors = |field: &str, least: usize| {
            rows(field, least)?.iter().map(|row| Ok(DVec3::from_array(row.exactly()?))).collect::<Result<Vec<_>>>()
        };
        let axes = vectors("joint_rotation_axes", JOINTS)?;
        if let Some(at) = axes.iter().take(JOINTS).position(|axis| axis.length() < 1e-6) {
            return Err(profile.get("joint_rotation_axes").expected(&format!("axes with a length, got none at {at}")));
        }
        let places = vectors("joint_rest_positions", JOINTS)?;
        let joints = axes.iter().zip(&places).take(JOINTS).map(|(axis, place)| (axis.normalize(), *place * MILLIMETRE));
        let points = vectors("landmark_rest_positions", LANDMARKS)?;
        let indices = rows("landmark_rest_bone_indices", LANDMARKS)?;
        let weights = rows("landmark_rest_bone_weights", LANDMARKS)?;
        let mut landmarks = Vec::with_capacity(LANDMARKS);
        for (point, (indices, weights)) in points.into_iter().zip(indices.iter().zip(&weights)).take(LANDMARKS) {
            let mut follows = Vec::new();
            for (index, weight) in indices.items().iter().zip(weights.numbers()?).filter(|(_, weight)| *weight != 0.0) {
                match usize::try_from(index.whole()?) {
                    Ok(frame) if frame < FRAMES => follows.push((frame, weight)),
                    _ => return Err(index.expected(&format!("a frame from 0 to {}", FRAMES - 1))),
                }
            }
            landmarks.push((point * MILLIMETRE, follows));
        }
        Ok(Some(Self { joints: joints.collect(), landmarks }))
    }

    /// Returns the keypoints of a hand, m, in the frame that `wrist`, `world_from_wrist`, leads to. `angles`: at least 20, rad.
    ///
    /// # Errors
    /// If there are fewer angles.
    pub fn keypoints(&self, side: Side, angles: &Json, wrist: DAffine3) -> Result<[Vec3; N_KEYPOINTS]> {
        let numbers = angles.numbers()?;
        if numbers.len() < JOINTS {
            return Err(angles.expected(&format!("at least {JOINTS} angles")));
        }
        // The profile is a left hand.
        let mirror = DAffine3::from_mat3(DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0)));
        let root = if side == Side::Right { wrist * mirror } else { wrist };
        let turn = |joint: usize| {
            let (axis, place) = self.joints[joint];
            let rotation = DQuat::from_axis_angle(axis, numbers[joint]);
            DAffine3::from_rotation_translation(rotation, place - rotation * place)
        };
        let mut frames = vec![root; 2];
        for finger in 0..5 {
            let mut frame = root;
            for joint in 0..PER_FINGER {
                frame *= turn(PER_FINGER * finger + joint);
                if joint > 0 {
                    frames.push(frame);
                }
            }
        }
        let landmark = |index: usize| -> DVec3 {
            let (point, follows) = &self.landmarks[index];
            follows.iter().map(|(frame, weight)| frames[*frame].transform_point3(*point) * *weight).sum()
        };
        // The second joint at the thumb's base turns with the first one.
        let thumb = || (root * turn(0)).transform_point3(self.joints[1].1);
        Ok(LANDMARK_OF.map(|of| of.map_or_else(thumb, landmark).as_vec3()))
    }
}
