//! Episodes: frames of image, touch and hand pose, in the formats people keep them in.

pub mod lerobot;
pub mod mcap;
pub mod ring;
pub mod tensors;
pub mod video;
pub mod zarr;

use ::image::RgbImage;

use crate::error::Result;
use crate::hand::{HandParams, Topology};
use crate::tactile::{TactileField, Validity, median_step};

/// One instant of an episode.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Seconds.
    pub timestamp: f64,
    /// What the head camera sees.
    pub camera_ego_rgb: RgbImage,
    /// Force and contact on both hands (label c for simulated truth).
    pub field: TactileField,
    /// (1556) 1 = the force is supervised.
    pub force_valid: Vec<u8>,
    /// (1556) 1 = the contact is supervised.
    pub contact_valid: Vec<u8>,
    /// Whether the frame can be trusted.
    pub validity: Validity,
    /// Left hand in the world frame; None = absent (zeros in the store).
    pub left_hand_pose: Option<HandParams>,
    /// Right hand in the world frame; None = absent (zeros in the store).
    pub right_hand_pose: Option<HandParams>,
}

/// What is true of a whole store.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Attributes {
    /// What the vertex indices mean.
    pub topology: Topology,
    /// Width of the kernel that spread the contact forces, m; 0 = forces were not spread.
    #[serde(default)]
    pub sigma: f64,
    /// Force above which truth is contact, N; stored as `{"thresholds": {"contact_force": ..}}`.
    #[serde(default = "thresholds::default", rename = "thresholds", with = "thresholds")]
    pub contact_force: f64,
    /// Program that wrote the store.
    #[serde(default)]
    pub producer: String,
    /// Its version.
    #[serde(default)]
    pub version: String,
    /// Scene or source, one per store.
    #[serde(default)]
    pub scene: String,
    /// Seed of the first episode.
    #[serde(default)]
    pub seed: u64,
}

/// The `thresholds` attribute: an object, so that a store can name further thresholds.
mod thresholds {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use crate::tactile::CONTACT_FORCE_N;

    #[derive(Serialize, Deserialize)]
    struct Thresholds {
        #[serde(default = "default")]
        contact_force: f64,
    }

    pub fn default() -> f64 {
        shortest(f64::from(CONTACT_FORCE_N))
    }

    pub fn serialize<S: Serializer>(contact_force: &f64, serializer: S) -> Result<S::Ok, S::Error> {
        Thresholds { contact_force: shortest(*contact_force) }.serialize(serializer)
    }

    /// A number that came from f32 by its shortest decimal, so that 0.05 is written as 0.05.
    fn shortest(value: f64) -> f64 {
        let narrow = value as f32;
        match f64::from(narrow) == value {
            true => narrow.to_string().parse().unwrap_or(value),
            false => value,
        }
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
        Ok(Thresholds::deserialize(deserializer)?.contact_force)
    }
}

/// Takes episodes, frame by frame.
pub trait EpisodeWriter {
    /// Appends one frame to the open episode.
    ///
    /// # Errors
    /// If the frame does not fit the store (image size, topology) or can't be written.
    fn push(&mut self, frame: Frame) -> Result<()>;
    /// Ends the open episode; an empty one is an error.
    ///
    /// # Errors
    /// If nothing was pushed since the last end, or writing fails.
    fn end_episode(&mut self) -> Result<()>;
}

/// Gives frames by index over all episodes.
pub trait EpisodeReader: Send + Sync {
    /// What is true of the whole store.
    fn attributes(&self) -> &Attributes;
    /// Exclusive cumulative ends of the episodes.
    fn episode_ends(&self) -> &[usize];
    /// Reads one frame.
    ///
    /// # Errors
    /// If the index is out of range or the store can't be read.
    fn frame(&self, index: usize) -> Result<Frame>;
}

/// What one unit of `timestamps` is, s: foreign stores leave it open. Cameras give 1 to 1000 images per second, so the size
/// of the steps tells seconds, milliseconds, microseconds and nanoseconds apart.
pub fn time_unit_of(timestamps: &[f64]) -> f64 {
    match median_step(timestamps) {
        Some(step) if step > 1e6 => 1e-9,
        Some(step) if step > 1e3 => 1e-6,
        Some(step) if step > 1.0 => 1e-3,
        _ => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_of_time_stamps_tell_themselves_by_their_steps() {
        for (seconds, step) in [(1.0, 0.04), (1e-3, 33.3), (1e-6, 33_333.0), (1e-9, 4e7), (1.0, 0.001)] {
            let stamps: Vec<f64> = (0..20).map(|i| 5e3 * step + step * f64::from(i)).collect();
            assert_eq!(time_unit_of(&stamps), seconds, "{step}");
        }
        assert_eq!(time_unit_of(&[3.0]), 1.0);
    }
}
