//! Images in order of time, read from a recording of any format.

use std::sync::Arc;

use ::image::RgbImage;

use super::identity::InputFiles;
use crate::error::{Error, Result};
use crate::image::{self, RawImage};
use crate::message;

/// A stretch of images in order of time that is labelled as one stream: an episode, a file of a bag, a video.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unit {
    /// Name within the source.
    pub name: String,
    /// Number of images; None = known only after reading.
    pub frames: Option<usize>,
}

/// Images of a recording, in one or several units.
pub trait ImageSource: Send + Sync {
    /// Returns the units in the source's order.
    fn units(&self) -> &[Unit];

    /// Lists the files that hold the images and their times, as they are now.
    ///
    /// # Errors
    /// If a folder can't be listed.
    fn files(&self) -> Result<InputFiles>;

    /// Returns the images of unit `unit` from index `from` on, each once and in the same order at every call.
    ///
    /// The two kinds of failure differ. An item that is an error ends the images: the medium could not be read or a
    /// decoder died, so nothing is known about the images that follow, and a later call may succeed. A damaged image is
    /// no error: its frame carries the reason, at every call the same.
    ///
    /// # Errors
    /// If the unit can't be opened.
    fn frames(&self, unit: usize, from: usize) -> Result<SourceFrames<'_>>;

    /// Returns the damage that hides images of unit `unit`, if only the source can find it. `images` is the number of
    /// images that were read.
    ///
    /// # Errors
    /// If the unit can't be read.
    fn damage(&self, unit: usize, images: usize) -> Result<Option<LostBytes>> {
        let _ = (unit, images);
        Ok(None)
    }
}

/// Images in order.
pub type SourceFrames<'a> = Box<dyn Iterator<Item = Result<SourceFrame>> + Send + 'a>;

/// Leaves out the first `n` images. An error among them stays, so that a failure there is not mistaken for an image.
pub(super) fn skip_images<'a>(
    frames: impl Iterator<Item = Result<SourceFrame>> + Send + 'a,
    n: usize,
) -> SourceFrames<'a> {
    Box::new(frames.enumerate().filter(move |(index, frame)| *index >= n || frame.is_err()).map(|(_, frame)| frame))
}

/// One image as it lies in its source.
#[derive(Debug)]
pub struct SourceFrame {
    /// Time of the image, s.
    pub stamp_secs: f64,
    /// Offset of its record in the unit's file, bytes.
    pub offset: Option<u64>,
    /// The image, or the reason why it can't be read.
    pub image: std::result::Result<EncodedImage, String>,
    /// Text that the journal keeps for the output, so that the output need not read the same bytes again.
    pub note: Option<String>,
}

impl SourceFrame {
    /// Creates a frame without offset and note.
    pub fn new(stamp_secs: f64, image: std::result::Result<EncodedImage, String>) -> Self {
        Self { stamp_secs, offset: None, image, note: None }
    }
}

/// An image that is not decoded yet.
#[derive(Debug, Clone)]
pub enum EncodedImage {
    /// Pixels.
    Pixels(RgbImage),
    /// Content of a PNG or JPEG file.
    File(Vec<u8>),
    /// Raw image message of a camera.
    Raw(message::Image),
}

impl EncodedImage {
    /// Estimates the memory that the image takes until it is decoded, bytes; it is close to the most for usual images.
    pub fn memory(&self) -> u64 {
        /// Bytes per pixel of a decoded file, and of its conversion to RGB.
        const PIXEL: u64 = 4 + 3;
        match self {
            Self::Pixels(pixels) => pixels.as_raw().len() as u64,
            Self::File(bytes) => {
                let (width, height) = image::dimensions(bytes).unwrap_or_default();
                bytes.len() as u64 + PIXEL * u64::from(width) * u64::from(height)
            }
            // From one byte per pixel on, and three of RGB.
            Self::Raw(raw) => 4 * raw.data.len() as u64,
        }
    }

    /// Decodes the image.
    ///
    /// # Errors
    /// If it is damaged, or its encoding is unknown.
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

/// Several sources, one behind the other.
pub struct SourceChain {
    sources: Vec<Arc<dyn ImageSource>>,
    units: Vec<Unit>,
}

impl SourceChain {
    /// Chains named sources; each unit's name begins with the name of its source.
    pub fn new(sources: Vec<(String, Arc<dyn ImageSource>)>) -> Self {
        let mut units = Vec::new();
        for (name, source) in &sources {
            let prefixed = |unit: &Unit| Unit { name: format!("{name}: {}", unit.name), frames: unit.frames };
            units.extend(source.units().iter().map(prefixed));
        }
        Self { sources: sources.into_iter().map(|(_, source)| source).collect(), units }
    }

    /// Returns the source of unit `unit`, and the unit's index there.
    fn source(&self, mut unit: usize) -> Result<(&dyn ImageSource, usize)> {
        for source in &self.sources {
            match unit.checked_sub(source.units().len()) {
                Some(rest) => unit = rest,
                None => return Ok((source.as_ref(), unit)),
            }
        }
        Err(Error::value("unit", format!("an index below {}", self.units.len()), unit))
    }
}

impl ImageSource for SourceChain {
    fn units(&self) -> &[Unit] {
        &self.units
    }

    fn files(&self) -> Result<InputFiles> {
        let mut files = InputFiles::default();
        for source in &self.sources {
            files.append(source.files()?);
        }
        Ok(files)
    }

    fn frames(&self, unit: usize, from: usize) -> Result<SourceFrames<'_>> {
        let (source, unit) = self.source(unit)?;
        source.frames(unit, from)
    }

    fn damage(&self, unit: usize, images: usize) -> Result<Option<LostBytes>> {
        let (source, unit) = self.source(unit)?;
        source.damage(unit, images)
    }
}

/// Bytes of an input that can't be read; an output leaves them out, or holds them as they are.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct LostBytes {
    /// Name of the file.
    pub file: String,
    /// Offset at which the damage begins, bytes.
    pub offset: u64,
    /// Number of bytes left out.
    pub bytes: u64,
    /// Kind of damage.
    pub reason: String,
}
