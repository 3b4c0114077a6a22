//! Sample frames: the image, and both hands coloured by force.

use std::io::Cursor;

use ::image::codecs::jpeg::JpegEncoder;
use ::image::{ImageFormat, RgbImage};

use crate::dataset::{ImageSource, Labelled};
use crate::error::{Error, Result};
use crate::hand::{HandModel, HandParams, Side};
use crate::image::scaled;
use crate::render::{View, force_colors, hand_picture};
use crate::tactile::{CONTACT_FORCE_N, TactileSequence};

/// Height of images and hands, pixels.
const HEIGHT: u32 = 200;
/// Width of a hand's image, pixels.
const HAND_WIDTH: u32 = 160;
/// JPEG quality of camera images, 1 to 100.
const JPEG_QUALITY: u8 = 85;

/// A sample frame.
#[derive(Debug, Clone)]
pub struct Sample {
    /// Index of the frame in the data set.
    pub frame: usize,
    /// Index of the episode.
    pub episode: usize,
    /// Time stamp, s.
    pub stamp_secs: f64,
    /// Camera image as JPEG; None if it can't be read.
    pub image: Option<Vec<u8>>,
    /// Palmar views of left and right hand as PNG; empty without a hand model.
    pub hands: Vec<Vec<u8>>,
    /// Total force of left and right hand, N.
    pub force: [f32; 2],
    /// Force at the upper end of the colour scale, N.
    pub scale: f32,
}

/// Draws `n` frames: of each of `n` equal parts of the data set, the frame with the largest total force.
///
/// # Errors
/// If an image can't be encoded.
pub fn samples(
    labelled: &Labelled,
    images: Option<&dyn ImageSource>,
    hands: Option<&[HandModel; 2]>,
    n: usize,
) -> Result<Vec<Sample>> {
    let labels = &labelled.labels;
    let frames = chosen(labels, n);
    let scale = scale(labels);
    let mut samples = Vec::new();
    let mut images = images.map(Images::new);
    for frame in frames {
        let episode = labels.episode_ends.partition_point(|end| *end <= frame);
        let force = labels.force_at(frame);
        let image = images.as_mut().and_then(|images| images.get(frame));
        let mut pictures = Vec::new();
        for hand in hands.into_iter().flatten() {
            let posed = hand.forward(&HandParams::default());
            let colors = force_colors(&force[hand.side.range()], scale);
            pictures.push(png(&hand_picture(hand, &posed, &colors, View::Palmar, (HAND_WIDTH, HEIGHT)))?);
        }
        samples.push(Sample {
            frame,
            episode,
            stamp_secs: labels.stamp_or_index(frame),
            image: image.map(|image| jpeg(&image)).transpose()?,
            hands: pictures,
            force: Side::BOTH.map(|side| force[side.range()].iter().sum()),
            scale,
        });
    }
    Ok(samples)
}

/// Returns the index of the frame with the largest total force in each of `n` equal parts.
fn chosen(labels: &TactileSequence, n: usize) -> Vec<usize> {
    let total = |frame: usize| -> f32 { labels.force_at(frame).iter().filter(|force| !force.is_nan()).sum() };
    let frames = labels.n_frames();
    let n = n.min(frames);
    let part = |i: usize| (i * frames / n)..((i + 1) * frames / n);
    (0..n).filter_map(|i| part(i).max_by(|a, b| total(*a).total_cmp(&total(*b)).then(b.cmp(a)))).collect()
}

/// Returns the 99.9th percentile of the forces above 0.05 N, N.
fn scale(labels: &TactileSequence) -> f32 {
    let mut forces: Vec<f32> = labels.force.iter().copied().filter(|force| *force > CONTACT_FORCE_N).collect();
    forces.sort_by(f32::total_cmp);
    forces.get(forces.len() * 999 / 1000).copied().unwrap_or(1.0)
}

/// Random access to images by their index in the data set; indices must grow.
struct Images<'a> {
    source: &'a dyn ImageSource,
    /// Current unit of the source, and the index of its first image.
    unit: usize,
    start: usize,
}

impl<'a> Images<'a> {
    fn new(source: &'a dyn ImageSource) -> Self {
        Self { source, unit: 0, start: 0 }
    }

    fn get(&mut self, frame: usize) -> Option<RgbImage> {
        loop {
            let length = self.source.units().get(self.unit)?.frames?;
            if frame < self.start + length {
                break;
            }
            (self.unit, self.start) = (self.unit + 1, self.start + length);
        }
        let frame = self.source.frames(self.unit, frame - self.start).ok()?.next()?.ok()?;
        frame.image.ok()?.decode().ok()
    }
}

fn jpeg(image: &RgbImage) -> Result<Vec<u8>> {
    let (width, height) = image.dimensions();
    let small = match height > HEIGHT {
        true => &scaled(image, ((width * HEIGHT / height).max(1), HEIGHT))?,
        false => image,
    };
    let mut bytes = Vec::new();
    let encoded = JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY).encode_image(small);
    encoded.map_err(|error| Error::value("picture", "one that can be encoded", error))?;
    Ok(bytes)
}

fn png(image: &RgbImage) -> Result<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    image
        .write_to(&mut bytes, ImageFormat::Png)
        .map_err(|error| Error::value("picture", "one that can be encoded", error))?;
    Ok(bytes.into_inner())
}
