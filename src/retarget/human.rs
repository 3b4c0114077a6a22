//! The 21 keypoints of a human hand, in the frame of its wrist.
//!
//! The wrist frame has its origin at the wrist and the axes palmar (out of the palm), radial (towards the thumb's side)
//! and distal (towards the fingers). It is right-handed on a right hand and left-handed on a left one, so a hand and its
//! mirror image have the same coordinates.

use glam::{DMat3, DVec3};

use crate::error::{Error, Result};
use crate::hand::{HandModel, HandParams, N_KEYPOINTS, Side};

/// Names of the keypoints: wrist, then each finger from base to tip.
const KEYPOINTS: [&str; N_KEYPOINTS] = [
    "wrist",
    "thumb 1",
    "thumb 2",
    "thumb 3",
    "thumb tip",
    "index 1",
    "index 2",
    "index 3",
    "index tip",
    "middle 1",
    "middle 2",
    "middle 3",
    "middle tip",
    "ring 1",
    "ring 2",
    "ring 3",
    "ring tip",
    "little 1",
    "little 2",
    "little 3",
    "little tip",
];

/// Plausible palm lengths, from the wrist to the bases of the fingers, m: any human hand (an adult's is about 0.1) with
/// room for errors of scale.
const PALM_LENGTHS: std::ops::RangeInclusive<f64> = 0.02..=0.25;
/// Greatest distance of a keypoint from the wrist, in palm lengths: a straight middle finger ends at about 2.
const MAX_REACH: f64 = 4.0;
/// Greatest coordinate, m: beyond it, 32-bit positions are coarser than 1 mm.
const MAX_COORDINATE: f64 = 1e4;
/// Least width of the palm from index to little finger, in palm lengths: below it the radial axis is noise.
const MIN_PALM_WIDTH: f64 = 0.1;
/// Least mean sine of the fingers' bend. Fingers bend backwards by a few degrees only, so a mean of -0.35 (20 degrees)
/// means that the palmar axis points out of the back: a hand of the other side.
const MIN_BEND: f64 = -0.35;

/// Index of a finger's keypoint; `joint`: 0 (base) to 3 (tip).
pub const fn keypoint(finger: usize, joint: usize) -> usize {
    1 + 4 * finger + joint
}

/// A hand in its own wrist frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Hand {
    /// (21) keypoints in the wrist frame: palmar, radial, distal, m.
    pub points: [DVec3; N_KEYPOINTS],
    /// Columns palmar, radial, distal in the frame of the keypoints.
    pub axes: DMat3,
    /// Position of the wrist in the frame of the keypoints, m.
    pub wrist: DVec3,
}

impl Hand {
    /// Transforms keypoints, m in any frame, to the wrist frame of a hand of this side.
    ///
    /// # Errors
    /// If a keypoint is not finite, the points can't be a hand (all in one place, on a line, or out of proportion), or the
    /// fingers bend to the back, as those of the other hand do; the error names the keypoint.
    pub fn new(keypoints: &[DVec3; N_KEYPOINTS], side: Side) -> Result<Self> {
        if let Some(bad) = keypoints.iter().position(|point| !point.is_finite()) {
            return Err(bad_point(bad, "finite metres", keypoints[bad]));
        }
        if let Some(bad) = keypoints.iter().position(|point| point.abs().max_element() > MAX_COORDINATE) {
            return Err(bad_point(bad, &format!("at most {MAX_COORDINATE:e} m from the origin"), keypoints[bad]));
        }
        let wrist = keypoints[0];
        let base = |finger: usize| keypoints[keypoint(finger, 0)];
        // The mean of three finger bases is less noisy than the middle finger's alone.
        let distal = (base(1) + base(2) + base(3)) / 3.0 - wrist;
        let palm = distal.length();
        if !PALM_LENGTHS.contains(&palm) {
            let expected = format!("a palm of {} to {} m", PALM_LENGTHS.start(), PALM_LENGTHS.end());
            return Err(Error::value("keypoints 0 (wrist) and 9 (middle 1)", expected, format!("{palm:.4} m")));
        }
        let distal = distal / palm;
        let radial = (base(1) - base(4)).reject_from_normalized(distal);
        if radial.length() < MIN_PALM_WIDTH * palm {
            let got = format!("{:.4} m", radial.length());
            return Err(Error::value("keypoints 5 (index 1) and 17 (little 1)", "finger bases side by side", got));
        }
        if let Some(far) = keypoints.iter().position(|point| point.distance(wrist) > MAX_REACH * palm) {
            let got = format!("{:.3} m", keypoints[far].distance(wrist));
            return Err(bad_point(far, &format!("at most {:.3} m from the wrist", MAX_REACH * palm), got));
        }
        let radial = radial.normalize();
        let palmar = match side {
            Side::Right => radial.cross(distal),
            Side::Left => distal.cross(radial),
        };
        let axes = DMat3::from_cols(palmar, radial, distal);
        let from_world = axes.transpose();
        let hand = Self { points: keypoints.map(|point| from_world * (point - wrist)), axes, wrist };
        if hand.bend() < MIN_BEND {
            let expected = format!("fingers that bend to the palm of a {} hand", side.name());
            return Err(Error::value(
                "keypoints",
                expected,
                "fingers that bend to its back (mirrored, or the other hand)",
            ));
        }
        Ok(hand)
    }

    /// Returns the keypoints of a hand model in a pose, m.
    pub fn of_model(model: &HandModel, params: &HandParams) -> [DVec3; N_KEYPOINTS] {
        model.keypoints(&model.forward(params)).map(|point| point.as_dvec3())
    }

    /// Returns the built-in hand, flat.
    ///
    /// # Errors
    /// Never with the built-in hand.
    pub fn reference() -> Result<Self> {
        Self::new(&Self::of_model(&HandModel::builtin(Side::Right), &HandParams::default()), Side::Right)
    }

    /// Mean bend of the four fingers: sine of the angle between palm plane and the line from base to tip; negative towards
    /// the back.
    fn bend(&self) -> f64 {
        let one = |finger: usize| {
            let line = self.points[keypoint(finger, 3)] - self.points[keypoint(finger, 0)];
            let length = finger_length(&self.points, finger);
            if length > 0.0 { line.x / length } else { 0.0 }
        };
        (1..5).map(one).sum::<f64>() / 4.0
    }

    /// Mean of the bases of the given fingers, m; zero without fingers.
    pub fn bases(points: &[DVec3; N_KEYPOINTS], fingers: impl Iterator<Item = usize>) -> DVec3 {
        let (sum, count) =
            fingers.fold((DVec3::ZERO, 0.0), |(sum, count), finger| (sum + points[keypoint(finger, 0)], count + 1.0));
        if count > 0.0 { sum / count } else { DVec3::ZERO }
    }
}

/// Length of a finger along its bones from base to tip, m.
pub fn finger_length(points: &[DVec3; N_KEYPOINTS], finger: usize) -> f64 {
    (0..3).map(|joint| points[keypoint(finger, joint)].distance(points[keypoint(finger, joint + 1)])).sum()
}

/// Sum of all bone lengths, those of the palm included, m: a measure of size that does not depend on the pose.
pub fn size(points: &[DVec3; N_KEYPOINTS]) -> f64 {
    (0..5).map(|finger| points[keypoint(finger, 0)].length() + finger_length(points, finger)).sum()
}

/// Outward normal of a human fingertip's pad, in the wrist frame.
pub fn pad_normal(points: &[DVec3; N_KEYPOINTS], finger: usize) -> DVec3 {
    bone_normal(points, finger, 2)
}

/// Palmar normal of a finger's bone (0 at its base to 2 at its tip), in the wrist frame.
fn bone_normal(points: &[DVec3; N_KEYPOINTS], finger: usize, bone: usize) -> DVec3 {
    let [from, to] = [keypoint(finger, bone), keypoint(finger, bone + 1)];
    let along = (points[to] - points[from]).normalize_or_zero();
    let toward = match finger {
        // The thumb faces the middle bones of index and middle finger.
        0 => 0.5 * (points[keypoint(1, 2)] + points[keypoint(2, 2)]) - points[to],
        // Fingers bend about the radial axis: palmar = radial x distal.
        _ => DVec3::Y.cross(along),
    };
    let normal = toward.reject_from(if along == DVec3::ZERO { DVec3::Z } else { along });
    normal.try_normalize().unwrap_or(DVec3::X)
}

/// Axes of a human bone in the wrist frame: columns normal, lateral, along.
pub fn bone_axes(points: &[DVec3; N_KEYPOINTS], finger: usize, bone: usize) -> DMat3 {
    let along =
        (points[keypoint(finger, bone + 1)] - points[keypoint(finger, bone)]).try_normalize().unwrap_or(DVec3::Z);
    let normal = bone_normal(points, finger, bone);
    DMat3::from_cols(normal, along.cross(normal), along)
}

fn bad_point(index: usize, expected: &str, got: impl ToString) -> Error {
    Error::value(format!("keypoint {index} ({})", KEYPOINTS[index]), expected, got.to_string())
}
