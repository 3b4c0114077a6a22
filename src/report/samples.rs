//! Frames to look at: the image, and both hands coloured by force.

use std::io::Cursor;

use ::image::codecs::jpeg::JpegEncoder;
use ::image::imageops::{FilterType, resize};
use ::image::{ImageFormat, RgbImage};

use crate::error::{Error, Result};
use crate::hand::{HandModel, HandParams, Side};
use crate::label::{Labelled, Source};
use crate::render::{View, force_colors, hand_picture};
use crate::tactile::TactileSequence;

/// Height of images and hands, pixels.
const HEIGHT: u32 = 200;
/// Width of a hand's picture, pixels.
const HAND_WIDTH: u32 = 160;
/// Quality of camera images.
const JPEG_QUALITY: u8 = 85;

/// A frame that is shown.
#[derive(Debug, Clone)]
pub struct Sample {
    /// Its number in the data set.
    pub frame: usize,
    /// Its episode.
    pub episode: usize,
    /// Its time, s.
    pub stamp_secs: f64,
    /// The camera's image, a JPEG file; None where it can't be read.
    pub image: Option<Vec<u8>>,
    /// Left and right hand on their palms, PNG files; empty without a hand model.
    pub hands: Vec<Vec<u8>>,
    /// Total force of left and right hand, N.
    pub force: [f32; 2],
    /// Force at the end of the colours, N.
    pub scale: f32,
}

/// Draws `n` frames: in each of `n` equal stretches of the data set the one with the most force.
///
/// # Errors
/// If a picture can't be written.
pub fn samples(
    labelled: &Labelled,
    images: Option<&dyn Source>,
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

fn chosen(labels: &TactileSequence, n: usize) -> Vec<usize> {
    let total = |frame: usize| -> f32 { labels.force_at(frame).iter().filter(|force| !force.is_nan()).sum() };
    let frames = labels.n_frames();
    let n = n.min(frames);
    let stretch = |i: usize| (i * frames / n)..((i + 1) * frames / n);
    (0..n).filter_map(|i| stretch(i).max_by(|a, b| total(*a).total_cmp(&total(*b)).then(b.cmp(a)))).collect()
}

/// The force that 999 of 1000 touched vertices stay below, N.
fn scale(labels: &TactileSequence) -> f32 {
    let mut forces: Vec<f32> = labels.force.iter().copied().filter(|force| *force > 0.05).collect();
    forces.sort_by(f32::total_cmp);
    forces.get(forces.len() * 999 / 1000).copied().unwrap_or(1.0)
}

/// Images by their number in the data set, wanted in growing order.
struct Images<'a> {
    source: &'a dyn Source,
    /// Number of the first image of each unit, as far as it is known.
    unit: usize,
    start: usize,
}

impl<'a> Images<'a> {
    fn new(source: &'a dyn Source) -> Self {
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
        let shot = self.source.shots(self.unit, frame - self.start).ok()?.next()?;
        shot.picture.ok()?.decode().ok()
    }
}

fn jpeg(image: &RgbImage) -> Result<Vec<u8>> {
    let (width, height) = image.dimensions();
    let small = match height > HEIGHT {
        true => &resize(image, (width * HEIGHT / height).max(1), HEIGHT, FilterType::Triangle),
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
