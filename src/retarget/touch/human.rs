//! Touch on a human hand.

use glam::{DMat3, DVec3};

use crate::error::{Error, Result};
use crate::hand::N_KEYPOINTS;
use crate::retarget::human::{Hand, bone_axes, keypoint};
use crate::tactile::CONTACT_FORCE_N;

/// Segments of a human hand: three bones of each of five fingers (3 * finger + bone, from base to tip), palm, back.
pub const N_SEGMENTS: usize = 17;
/// Index of the palm's segment.
pub const PALM: usize = 15;
/// Index of the segment of the hand's back.
pub const DORSAL: usize = 16;
/// Greatest force accepted, N: far above any hand's, so the sums that follow stay finite.
pub(super) const MAX_FORCE_N: f64 = 1e9;
/// Position along a bone where force acts if its distribution is unknown, 0 (base) to 1 (tip): about the middle of the pad.
const TYPICAL_ALONG: f64 = 0.7;

/// Touch of one segment of the human hand.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct SegmentTouch {
    /// Force of the world on the segment, N: normal (out of the pad), lateral, along the bone; for palm and back in the
    /// axes of the wrist frame.
    pub force: DVec3,
    /// Sum of the vertices' normal forces, N.
    pub pressed: f64,
    /// Centre of pressure along the bone, 0 (base) to 1 (tip).
    pub along: f64,
    /// Contact probability.
    pub contact: f64,
}

/// Touch of the human hand.
#[derive(Debug, Clone, PartialEq)]
pub struct Touch {
    /// Contact probability of each fingertip, thumb to little; NaN = unknown.
    pub tip_contact: [f64; 5],
    /// Force of the world on each fingertip, N, in the frame of the keypoints; None = unknown, or given by `segments`.
    pub tip_force: Option<[DVec3; 5]>,
    /// Touch of each segment, pooled from a field on the vertices; see [`super::TouchPooling`].
    pub segments: Option<Box<[SegmentTouch; N_SEGMENTS]>>,
}

impl Default for Touch {
    fn default() -> Self {
        Self { tip_contact: [f64::NAN; 5], tip_force: None, segments: None }
    }
}

/// Force of the world on one segment of the human hand, in the wrist frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct SegmentForce {
    /// Force, N.
    pub force: DVec3,
    /// Magnitude that the segment counts with, N: the sum of normal forces where it is known.
    pub magnitude: f64,
    /// Contact probability.
    pub contact: f64,
    /// Point of action, m.
    pub position: DVec3,
}

impl Touch {
    /// Validates forces and probabilities.
    ///
    /// # Errors
    /// If a force is not finite or a probability is outside 0 to 1; the error names it.
    pub fn check(&self) -> Result<()> {
        if let Some(bad) = self.tip_contact.iter().position(|p| !(p.is_nan() || (0.0..=1.0).contains(p))) {
            return Err(Error::value(format!("tip_contact[{bad}]"), "0 to 1", self.tip_contact[bad]));
        }
        let mut forces = self.tip_force.iter().flatten().enumerate();
        match forces.find(|(_, force)| !force.is_finite() || force.length() > MAX_FORCE_N) {
            Some((bad, force)) => Err(Error::value(format!("tip_force[{bad}]"), "finite newtons", force)),
            None => Ok(()),
        }
    }

    /// Force of the world on a fingertip, N, in the wrist frame; `points`: (21) keypoints in the wrist frame, m.
    pub fn force_on_tip(&self, hand: &Hand, points: &[DVec3; N_KEYPOINTS], finger: usize) -> DVec3 {
        self.on_segment(hand, points, 3 * finger + 2).force
    }

    /// Force of the world on a segment; `points`: (21) keypoints in the wrist frame, m.
    pub(super) fn on_segment(&self, hand: &Hand, points: &[DVec3; N_KEYPOINTS], segment: usize) -> SegmentForce {
        let pooled = self.segments.as_ref().map(|segments| segments[segment]);
        let along = pooled.map_or(TYPICAL_ALONG, |touch| touch.along);
        let (finger, bone) = (segment / 3, segment % 3);
        let position = match segment < PALM {
            true => points[keypoint(finger, bone)].lerp(points[keypoint(finger, bone + 1)], along),
            false => 0.5 * Hand::bases(points, 1..5),
        };
        let is_tip = segment < PALM && bone == 2;
        let contact = match (is_tip, pooled) {
            (true, _) if !self.tip_contact[finger].is_nan() => self.tip_contact[finger],
            (_, Some(touch)) => touch.contact,
            _ => 0.0,
        };
        match (&self.tip_force, is_tip) {
            (Some(forces), true) => {
                let force = hand.axes.transpose() * forces[finger];
                let magnitude = force.length();
                let contact = if contact > 0.0 || magnitude <= f64::from(CONTACT_FORCE_N) { contact } else { 1.0 };
                SegmentForce { force, magnitude, contact, position: points[keypoint(finger, 3)] }
            }
            _ => {
                let (force, magnitude) = pooled.map_or((DVec3::ZERO, 0.0), |touch| (touch.force, touch.pressed));
                SegmentForce { force: segment_axes(points, segment) * force, magnitude, contact, position }
            }
        }
    }
}

/// Axes of a segment of the human hand in the wrist frame: columns normal, lateral, along.
pub(super) fn segment_axes(points: &[DVec3; N_KEYPOINTS], segment: usize) -> DMat3 {
    match segment {
        PALM | DORSAL => DMat3::IDENTITY,
        _ => bone_axes(points, segment / 3, segment % 3),
    }
}
