//! Sample frames: the image, and both hands coloured by force.

use std::io::Cursor;

use ::image::{ImageFormat, RgbImage};

use crate::dataset::random_images::RandomImages;
use crate::dataset::{ImageSource, Labelled};
use crate::error::{Error, Result};
use crate::hand::{HandModel, HandParams, Side};
use crate::image::{self, scaled};
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
    /// The same views of the truth; empty without truth.
    pub truth_hands: Vec<Vec<u8>>,
    /// Total force of left and right hand, N; NaN = unknown.
    pub force: [f32; 2],
    /// True total force of left and right hand, N; None = the data set has no truth.
    pub truth: Option<[f32; 2]>,
    /// Likeness of the image to those of the network's training, 0 to 1; NaN = not estimated.
    pub familiarity: f32,
    /// Presence of left and right hand, 0 to 1; NaN = not estimated.
    pub presence: [f32; 2],
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
    let mut images = images.map(RandomImages::new);
    for frame in frames {
        let episode = labels.episode_ends.partition_point(|end| *end <= frame);
        let force = labels.force_at(frame);
        let image = images.as_mut().and_then(|images| images.get(frame).ok()??.image.ok()?.decode().ok());
        let truth = labelled.truth.as_ref().map(|truth| truth.force_at(frame));
        let totals = |force: &[f32]| Side::BOTH.map(|side| force[side.range()].iter().sum());
        let estimate = |values: &[f32], at: usize| values.get(at).copied().unwrap_or(f32::NAN);
        samples.push(Sample {
            frame,
            episode,
            stamp_secs: labels.stamp_or_index(frame),
            image: image.map(|image| jpeg(&image)).transpose()?,
            hands: palms(hands, force, scale)?,
            truth_hands: truth.map_or(Ok(Vec::new()), |truth| palms(hands, truth, scale))?,
            force: totals(force),
            truth: truth.map(totals),
            familiarity: estimate(&labels.familiarity, frame),
            presence: [0, 1].map(|side| estimate(&labels.presence, 2 * frame + side)),
            scale,
        });
    }
    Ok(samples)
}

/// Draws the palms of both hands, coloured by `force`, (1556) N; nothing without hands.
fn palms(hands: Option<&[HandModel; 2]>, force: &[f32], scale: f32) -> Result<Vec<Vec<u8>>> {
    let draw = |hand: &HandModel| {
        let posed = hand.forward(&HandParams::default());
        let colors = force_colors(&force[hand.side.range()], scale);
        png(&hand_picture(hand, &posed, &colors, View::Palmar, (HAND_WIDTH, HEIGHT)))
    };
    hands.into_iter().flatten().map(draw).collect()
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
pub(crate) fn scale(labels: &TactileSequence) -> f32 {
    let mut forces: Vec<f32> = labels.force.iter().copied().filter(|force| *force > CONTACT_FORCE_N).collect();
    forces.sort_by(f32::total_cmp);
    forces.get(forces.len() * 999 / 1000).copied().unwrap_or(1.0)
}

fn jpeg(image: &RgbImage) -> Result<Vec<u8>> {
    let (width, height) = image.dimensions();
    let small = match height > HEIGHT {
        true => &scaled(image, ((width * HEIGHT / height).max(1), HEIGHT))?,
        false => image,
    };
    image::jpeg(small, JPEG_QUALITY)
}

pub(super) fn png(image: &RgbImage) -> Result<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    image
        .write_to(&mut bytes, ImageFormat::Png)
        .map_err(|error| Error::value("picture", "one that can be encoded", error))?;
    Ok(bytes.into_inner())
}
