//! A JPEG file as a camera of 640 x 480 pixels sends it.

use std::io::Cursor;

use ::image::codecs::jpeg::JpegEncoder;
use ::image::{Rgb, RgbImage};
use egotac::error::{Error, Result};

/// Quality of the JPEG file.
const QUALITY: u8 = 90;

/// Encodes smooth shapes with some noise as a JPEG file.
pub fn jpeg() -> Result<Vec<u8>> {
    let mut state = 1u32;
    let picture = RgbImage::from_fn(640, 480, |x, y| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let noise = (state >> 28) as f32;
        let wave = |phase: f32| (f32::sin(x as f32 * 0.02 + phase) + f32::cos(y as f32 * 0.03 - phase)) * 55.0 + 120.0;
        Rgb([0.0, 1.0, 2.0].map(|phase| (wave(phase) + noise) as u8))
    });
    let mut bytes = Cursor::new(Vec::new());
    let written = JpegEncoder::new_with_quality(&mut bytes, QUALITY).encode_image(&picture);
    written.map_err(|error| Error::value("picture", "one that can be encoded", error))?;
    Ok(bytes.into_inner())
}
