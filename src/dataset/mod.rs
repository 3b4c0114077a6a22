//! Episodes: frames of image, touch and hand pose, one module per format.
//!
//! | module | images | labels |
//! |---|---|---|
//! | [`zarr`] | stores, one unit per episode | arrays of the same store, or a new store |
//! | [`mcap`] | bags, one unit per file | a topic beside the images, or a new bag |
//! | [`lerobot`] | data sets of version 3, one unit per episode | columns of the same data set |
//! | [`video`] | video files | |
//! | `image_folder` | folders of PNG and JPEG files | |
//! | [`tensors`] | | safetensors files |
//!
//! `source` and `labels` hold the traits that all formats implement; [`Format`] finds the format of a path.

mod carry;
pub(crate) mod copy;
pub(crate) mod format;
pub(crate) mod identity;
pub(crate) mod image_folder;
mod label_frame;
mod label_info;
mod labelled;
pub(crate) mod labels;
pub mod lerobot;
pub mod mcap;
mod prefetch;
mod provenance;
pub(crate) mod random_images;
#[doc(hidden)]
pub mod ring;
pub(crate) mod source;
pub mod tensors;
pub mod video;
pub mod zarr;

use std::path::Path;

use ::image::RgbImage;

#[doc(hidden)]
pub use carry::carry;
pub use copy::copy_folder;
pub use format::Format;
pub use identity::{InputFiles, InputIdentity, InputState};
pub use label_frame::LabelCounts;
pub use label_frame::LabelFrame;
pub use label_info::{LabelInfo, LabelSummary, UnlabelledImage};
pub use labelled::Labelled;
pub use labels::{LabelOutput, SourceLabels};
pub use provenance::{CONTACT_THRESHOLD, DoubtRule, PROVENANCE_KEY, Provenance, Thresholds};
pub use source::LostBytes;
pub use source::{ImageSource, SourceFrame, SourceFrames, Unit};

use crate::error::Result;
use crate::hand::{HandParams, Topology};
use crate::tactile::{TactileField, Validity, median_step};

/// One instant of an episode.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Seconds.
    pub timestamp: f64,
    /// Image of the head camera.
    pub camera_ego_rgb: RgbImage,
    /// Force and contact on both hands (label c for simulated truth).
    pub field: TactileField,
    /// (1556) 1 = the force is supervised.
    pub force_valid: Vec<u8>,
    /// (1556) 1 = the contact is supervised.
    pub contact_valid: Vec<u8>,
    /// Validity: valid, or the guard that refused the frame.
    pub validity: Validity,
    /// Left hand in the world frame; None = absent (zeros in the store).
    pub left_hand_pose: Option<HandParams>,
    /// Right hand in the world frame; None = absent (zeros in the store).
    pub right_hand_pose: Option<HandParams>,
}

/// Attributes of a store.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Attributes {
    /// Meaning of vertex indices.
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
    /// Version of the program.
    #[serde(default)]
    pub version: String,
    /// Scene or source; one per store.
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

    /// Returns the shortest decimal of a number that came from f32, so that 0.05 is written as 0.05.
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

/// Writes episodes frame by frame.
pub trait EpisodeWriter {
    /// Appends one frame to the open episode.
    ///
    /// # Errors
    /// If the frame does not fit the store (image size, topology) or can't be written.
    fn push(&mut self, frame: Frame) -> Result<()>;
    /// Ends the open episode.
    ///
    /// # Errors
    /// If nothing was pushed since the last end, or writing fails.
    fn end_episode(&mut self) -> Result<()>;
}

/// Reads frames by index over all episodes.
pub trait EpisodeReader: Send + Sync {
    /// Returns the attributes of the store.
    fn attributes(&self) -> &Attributes;
    /// Returns the exclusive cumulative ends of the episodes.
    fn episode_ends(&self) -> &[usize];
    /// Reads one frame.
    ///
    /// # Errors
    /// If the index is out of range or the store can't be read.
    fn frame(&self, index: usize) -> Result<Frame>;
}

/// Estimates the unit of `timestamps`, s; foreign stores do not state it. Cameras take 1 to 1000 images per second, so the
/// size of the steps distinguishes seconds, milliseconds, microseconds and nanoseconds.
pub fn time_unit_of(timestamps: &[f64]) -> f64 {
    match median_step(timestamps) {
        Some(step) if step > 1e6 => 1e-9,
        Some(step) if step > 1e3 => 1e-6,
        Some(step) if step > 1.0 => 1e-3,
        _ => 1.0,
    }
}

/// Returns the last component of `path` as text.
pub(crate) fn base_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_unit_of_timestamps_follows_from_their_steps() {
        for (seconds, step) in [(1.0, 0.04), (1e-3, 33.3), (1e-6, 33_333.0), (1e-9, 4e7), (1.0, 0.001)] {
            let stamps: Vec<f64> = (0..20).map(|i| 5e3 * step + step * f64::from(i)).collect();
            assert_eq!(time_unit_of(&stamps), seconds, "{step}");
        }
        assert_eq!(time_unit_of(&[3.0]), 1.0);
    }
}
