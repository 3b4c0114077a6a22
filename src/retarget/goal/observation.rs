//! Human hand as observed in one frame.

use glam::DVec3;

use crate::hand::N_KEYPOINTS;
use crate::retarget::filter::SizeEstimate;
use crate::retarget::human::Hand;
use crate::retarget::touch::Touch;

/// Human hand as observed in one frame.
#[derive(Debug, Clone, Copy)]
pub struct HandObservation<'a> {
    /// The hand as it came.
    pub hand: &'a Hand,
    /// (21) smoothed keypoints in the wrist frame, m.
    pub points: &'a [DVec3; N_KEYPOINTS],
    /// (21) keypoints smoothed more, for the directions of bones, m.
    pub direction_points: &'a [DVec3; N_KEYPOINTS],
    /// Size of the hand.
    pub size: &'a SizeEstimate,
    /// Touch of the hand; None = unknown.
    pub touch: Option<&'a Touch>,
}
