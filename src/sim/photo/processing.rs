//! Picture processing of a real camera: exposure, white balance, tone curve, vignetting, JPEG.

use image::codecs::jpeg::JpegEncoder;
use image::{ImageFormat, RgbImage};
use rand::Rng;

/// Largest factor on red and blue by a wrong white balance.
const MAX_CAST: f64 = 1.18;

/// Drawn processing of a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Processing {
    /// Factor on the light of each channel.
    pub gain: [f64; 3],
    /// Exponent of the tone curve; below 1 brightens.
    pub gamma: f64,
    /// Share of light that the picture's corners lack, 0 to 1.
    pub vignette: f64,
    /// Quality of the JPEG, 1 to 100.
    pub quality: u8,
}

impl Processing {
    /// Draws a camera's processing.
    pub(super) fn sample(rng: &mut impl Rng) -> Self {
        let exposure = 2.0_f64.powf(rng.random_range(-0.7..0.7));
        let cast = |rng: &mut dyn rand::RngCore| MAX_CAST.powf(rng.random_range(-1.0..1.0));
        Self {
            gain: [exposure * cast(rng), exposure, exposure * cast(rng)],
            gamma: rng.random_range(0.75..1.3),
            vignette: rng.random_range(0.0..0.45),
            quality: rng.random_range(35..96),
        }
    }

    /// Processes a picture.
    pub(crate) fn apply(&self, mut picture: RgbImage) -> RgbImage {
        let (width, height) = (f64::from(picture.width()), f64::from(picture.height()));
        let curve = |light: f64| 255.0 * (light / 255.0).clamp(0.0, 1.0).powf(self.gamma);
        for (x, y, pixel) in picture.enumerate_pixels_mut() {
            let [u, v] = [(f64::from(x) + 0.5) / width - 0.5, (f64::from(y) + 0.5) / height - 0.5];
            // 0 in the middle, 1 in the corners.
            let light = 1.0 - self.vignette * 2.0 * (u * u + v * v);
            for (value, gain) in pixel.0.iter_mut().zip(self.gain) {
                *value = curve(f64::from(*value) * gain * light).round() as u8;
            }
        }
        self.compress(&picture).unwrap_or(picture)
    }

    /// Encodes and decodes as JPEG; `None` never occurs for a picture that has pixels.
    fn compress(&self, picture: &RgbImage) -> Option<RgbImage> {
        let mut bytes = Vec::new();
        picture.write_with_encoder(JpegEncoder::new_with_quality(&mut bytes, self.quality)).ok()?;
        Some(image::load_from_memory_with_format(&bytes, ImageFormat::Jpeg).ok()?.into_rgb8())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gain_and_vignette_act_on_light_and_the_tone_curve_after_them() {
        let grey = RgbImage::from_pixel(64, 64, image::Rgb([100; 3]));
        let of = |gain: [f64; 3], gamma: f64, vignette: f64| {
            Processing { gain, gamma, vignette, quality: 100 }.apply(grey.clone())
        };
        let near = |value: u8, expected: f64| assert!((f64::from(value) - expected).abs() <= 3.0, "{value} {expected}");
        let middle = |picture: &RgbImage| picture.get_pixel(32, 32).0;
        near(middle(&of([1.0; 3], 1.0, 0.0))[1], 100.0);
        near(middle(&of([1.0, 2.0, 1.0], 1.0, 0.0))[1], 200.0);
        near(middle(&of([1.0; 3], 0.5, 0.0))[1], 255.0 * (100.0_f64 / 255.0).sqrt());
        let dark = of([1.0; 3], 1.0, 0.4);
        near(dark.get_pixel(0, 0).0[1], 60.0);
        near(middle(&dark)[1], 100.0);
    }
}
