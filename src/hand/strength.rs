//! Strength of a human hand.

use super::N_JOINTS;

/// Largest normal force that a finger's link bears, N: a strong pinch is 70 to 100 N.
pub const FINGER_LIMIT: f64 = 80.0;
/// Largest normal force that the palm bears, N.
pub const PALM_LIMIT: f64 = 250.0;

/// Returns the largest normal force that a link of a human hand bears, N.
pub fn link_limit(link: usize) -> f64 {
    debug_assert!(link < N_JOINTS);
    if link == 0 { PALM_LIMIT } else { FINGER_LIMIT }
}
