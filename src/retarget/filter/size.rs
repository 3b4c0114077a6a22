//! Estimate of a hand's size.

use glam::DVec3;

use crate::hand::N_KEYPOINTS;
use crate::retarget::human::{finger_length, size};

/// Frames that the mean covers: beyond that, older frames fade.
const MEAN_FRAMES: f64 = 300.0;
/// Ratios of a frame's size to the mean within which it is the same hand: poses do not change the size by more.
const SAME_HAND: std::ops::RangeInclusive<f64> = 0.8..=1.25;

/// Running mean of a hand's bone lengths.
#[derive(Debug, Clone, Default)]
pub struct SizeEstimate {
    size: f64,
    finger_lengths: [f64; 5],
    frames: f64,
}

impl SizeEstimate {
    /// Takes (21) keypoints in the wrist frame, m. The mean starts anew if the hand has another size.
    pub fn push(&mut self, points: &[DVec3; N_KEYPOINTS]) {
        let now = size(points);
        if self.frames > 0.0 && !SAME_HAND.contains(&(now / self.size)) {
            self.frames = 0.0;
        }
        self.frames = (self.frames + 1.0).min(MEAN_FRAMES);
        self.size += (now - self.size) / self.frames;
        for (finger, length) in self.finger_lengths.iter_mut().enumerate() {
            *length += (finger_length(points, finger) - *length) / self.frames;
        }
    }

    /// Sum of all bone lengths, m; 0 before the first frame.
    pub fn size(&self) -> f64 {
        self.size
    }

    /// Length of each finger from base to tip, m.
    pub fn finger_lengths(&self) -> [f64; 5] {
        self.finger_lengths
    }
}
