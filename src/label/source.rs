//! What images to label come from.

use ::image::RgbImage;

use crate::dataset::mcap::Lost;
use crate::error::Result;
use crate::image::{self, RawImage};
use crate::message;

/// A stretch of images in order of time that is labelled as one stream: an episode, a file of a bag, a video.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unit {
    /// Its name within the source.
    pub name: String,
    /// Images in it; None = known only when it was read.
    pub frames: Option<usize>,
}

/// Images in one or several units.
pub trait Source: Send + Sync {
    /// The units, in the source's order.
    fn units(&self) -> &[Unit];

    /// The images of unit `unit` from number `from` on, each once and in the same order at every call.
    ///
    /// # Errors
    /// If the unit can't be opened. What is damaged within is an item's matter.
    fn shots(&self, unit: usize, from: usize) -> Result<Shots<'_>>;

    /// What of unit `unit` is in no image since it can't be read, where the source knows better than the output: `images`
    /// were.
    ///
    /// # Errors
    /// If the unit can't be looked at.
    fn damage(&self, unit: usize, images: usize) -> Result<Option<Lost>> {
        let _ = (unit, images);
        Ok(None)
    }
}

/// Images one after the other.
pub type Shots<'a> = Box<dyn Iterator<Item = Shot> + Send + 'a>;

/// One image as it lies in its source.
#[derive(Debug)]
pub struct Shot {
    /// When it was taken, s.
    pub stamp_secs: f64,
    /// Where its record begins in the unit's file, bytes.
    pub offset: Option<u64>,
    /// The image, or why it can't be read.
    pub picture: std::result::Result<Picture, String>,
    /// What the output will want to know, and need not read again.
    pub note: Option<String>,
}

/// An image that is not decoded yet.
#[derive(Debug, Clone)]
pub enum Picture {
    /// Pixels.
    Pixels(RgbImage),
    /// A PNG or JPEG file.
    File(Vec<u8>),
    /// A camera's raw image.
    Raw(message::Image),
}

impl Picture {
    /// Decodes it.
    ///
    /// # Errors
    /// If it is damaged, or its encoding is none of ours.
    pub fn decode(self) -> Result<RgbImage> {
        match self {
            Self::Pixels(pixels) => Ok(pixels),
            Self::File(bytes) => image::decode(&bytes),
            Self::Raw(raw) => {
                let message::Image { height, width, encoding, step, data, .. } = &raw;
                RawImage { width: *width, height: *height, encoding, step: *step, data }.to_rgb()
            }
        }
    }
}
