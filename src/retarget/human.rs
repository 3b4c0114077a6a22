//! A human hand's 21 keypoints, as seen from its own wrist.
//!
//! The wrist frame has its origin at the wrist and the axes palmar (out of the palm), radial (towards the thumb's side)
//! and distal (towards the fingers). It is right-handed on a right hand and left-handed on a left one, so that a hand and
//! its mirror image have the same coordinates in it.

use glam::{DMat3, DVec3};

use crate::error::{Error, Result};
use crate::hand::{HandModel, HandParams, N_KEYPOINTS, Side};

/// Names of the keypoints.
pub const KEYPOINTS: [&str; N_KEYPOINTS] = [
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

/// Plausible distances from the wrist to the base of the middle finger, m.
const PALM: std::ops::RangeInclusive<f64> = 0.02..=0.25;
/// No keypoint is further from the wrist than this many palms.
const REACH: f64 = 4.0;
/// Longest coordinate, m: further away floats are too coarse.
const FAR: f64 = 1e4;

/// Keypoint of a finger: 0 base to 3 tip.
pub const fn keypoint(finger: usize, joint: usize) -> usize {
    1 + 4 * finger + joint
}

/// A hand in its own wrist frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Hand {
    /// (21) palmar, radial, distal, m.
    pub points: [DVec3; N_KEYPOINTS],
    /// Columns palmar, radial, distal in the frame of the keypoints.
    pub axes: DMat3,
    /// The wrist in the frame of the keypoints, m.
    pub wrist: DVec3,
}

impl Hand {
    /// Looks at keypoints from their wrist.
    ///
    /// # Errors
    /// If a keypoint is not finite, the points are no hand (all in one place or on a line, out of all proportion), or the
    /// fingers bend to the back, as those of a hand of the other side do; the error names the keypoint.
    pub fn new(keypoints: &[DVec3; N_KEYPOINTS], side: Side) -> Result<Self> {
        if let Some(bad) = keypoints.iter().position(|point| !point.is_finite()) {
            return Err(bad_point(bad, "finite metres", keypoints[bad]));
        }
        if let Some(bad) = keypoints.iter().position(|point| point.abs().max_element() > FAR) {
            return Err(bad_point(bad, &format!("at most {FAR:e} m from the origin"), keypoints[bad]));
        }
        let wrist = keypoints[0];
        let base = |finger: usize| keypoints[keypoint(finger, 0)];
        // Three bases about the middle one's: steadier than that one alone.
        let distal = (base(1) + base(2) + base(3)) / 3.0 - wrist;
        let palm = distal.length();
        if !PALM.contains(&palm) {
            let expected = format!("a palm of {} to {} m", PALM.start(), PALM.end());
            return Err(Error::value("keypoints 0 (wrist) and 9 (middle 1)", expected, format!("{palm:.4} m")));
        }
        let distal = distal / palm;
        let radial = (base(1) - base(4)).reject_from_normalized(distal);
        if radial.length() < 0.1 * palm {
            let got = format!("{:.4} m", radial.length());
            return Err(Error::value("keypoints 5 (index 1) and 17 (little 1)", "bases side by side", got));
        }
        if let Some(far) = keypoints.iter().position(|point| point.distance(wrist) > REACH * palm) {
            let got = format!("{:.3} m", keypoints[far].distance(wrist));
            return Err(bad_point(far, &format!("at most {:.3} m from the wrist", REACH * palm), got));
        }
        let radial = radial.normalize();
        let palmar = match side {
            Side::Right => radial.cross(distal),
            Side::Left => distal.cross(radial),
        };
        let axes = DMat3::from_cols(palmar, radial, distal);
        let from_world = axes.transpose();
        let hand = Self { points: keypoints.map(|point| from_world * (point - wrist)), axes, wrist };
        if hand.bend() < -0.35 {
            let expected = format!("fingers that bend to the palm of a {} hand", side.name());
            return Err(Error::value(
                "keypoints",
                expected,
                "fingers that bend to its back (mirrored, or the other hand)",
            ));
        }
        Ok(hand)
    }

    /// Keypoints of a hand model in a pose, m.
    pub fn of_model(model: &HandModel, params: &HandParams) -> [DVec3; N_KEYPOINTS] {
        model.keypoints(&model.forward(params)).map(|point| point.as_dvec3())
    }

    /// The built-in hand, flat.
    pub fn reference() -> Result<Self> {
        Self::new(&Self::of_model(&HandModel::builtin(Side::Right), &HandParams::default()), Side::Right)
    }

    /// How far the four fingers bend to the palm, on average: sine of the angle between base and tip direction.
    fn bend(&self) -> f64 {
        let one = |finger: usize| {
            let line = self.points[keypoint(finger, 3)] - self.points[keypoint(finger, 0)];
            let length = self.finger_length(finger);
            if length > 0.0 { line.x / length } else { 0.0 }
        };
        (1..5).map(one).sum::<f64>() / 4.0
    }

    /// Length of a finger from base to tip along its bones, m.
    pub fn finger_length(&self, finger: usize) -> f64 {
        (0..3)
            .map(|joint| self.points[keypoint(finger, joint)].distance(self.points[keypoint(finger, joint + 1)]))
            .sum()
    }

    /// Mean of the bases of the given fingers.
    pub fn bases(points: &[DVec3; N_KEYPOINTS], fingers: impl Iterator<Item = usize>) -> DVec3 {
        let (sum, count) =
            fingers.fold((DVec3::ZERO, 0.0), |(sum, count), finger| (sum + points[keypoint(finger, 0)], count + 1.0));
        if count > 0.0 { sum / count } else { DVec3::ZERO }
    }
}

/// Sum of the lengths of all fingers' bones and the palm's, m: the size of a hand in any pose.
pub fn size(points: &[DVec3; N_KEYPOINTS]) -> f64 {
    let finger = |finger: usize| {
        let base = points[keypoint(finger, 0)].length();
        let bones = (0..3).map(|j| points[keypoint(finger, j)].distance(points[keypoint(finger, j + 1)])).sum::<f64>();
        base + bones
    };
    (0..5).map(finger).sum()
}

fn bad_point(index: usize, expected: &str, got: impl ToString) -> Error {
    Error::value(format!("keypoint {index} ({})", KEYPOINTS[index]), expected, got.to_string())
}
