//! Colours of all pictures: one ramp for forces, one palette for regions.

use glam::Vec3;
use image::{Rgb, RgbImage};

use super::font;
use crate::hand::Region;

/// Background colour of all pictures.
pub const PAPER: Rgb<u8> = Rgb([255, 255, 255]);
/// Text colour of all pictures.
pub const INK: Rgb<u8> = Rgb([30, 30, 36]);
/// Colour of a hand without a field.
pub const SKIN: Rgb<u8> = Rgb([224, 172, 140]);
/// Colour of an unknown value (NaN).
pub const UNKNOWN: Rgb<u8> = Rgb([150, 158, 168]);

/// Force at the dark end of the colours where the largest force is not known before, N: that of a light grip on one vertex, and
/// that of the shipped RViz configuration.
pub const MAX_COLOR_FORCE: f32 = 0.5;

/// Returns the colour of a force on a scale from 0 to `max`, N: pale sand, orange, red, deep violet.
///
/// Perceived lightness (OKLab L) decreases linearly with the force, so equal steps look equal, also in greyscale.
/// Forces above `max` have the colour of `max`; NaN is [`UNKNOWN`]; if `max` is not positive, all forces have the
/// colour of zero.
pub fn force_color(force: f32, max: f32) -> Rgb<u8> {
    if force.is_nan() {
        return UNKNOWN;
    }
    let t = if max > 0.0 { (force / max).clamp(0.0, 1.0) } else { 0.0 };
    // The hue goes from sand (80 degrees) over red (25) to violet (-55); the chroma is largest in between.
    let hue = (80.0 - 60.0 * t - 75.0 * t * t * t).to_radians();
    let chroma = 0.035 + 0.17 * (t.min(1.0) * std::f32::consts::PI * 0.9).sin().max(0.0).powf(0.8);
    let lightness = 0.90 - 0.58 * t;
    oklab(Vec3::new(lightness, chroma * hue.cos(), chroma * hue.sin()))
}

/// Returns the [`force_color`] of each vertex.
pub fn force_colors(forces: &[f32], max: f32) -> Vec<Rgb<u8>> {
    forces.iter().map(|&force| force_color(force, max)).collect()
}

/// Returns the [`region_color`] of each vertex.
pub fn region_colors(regions: &[Region]) -> Vec<Rgb<u8>> {
    regions.iter().map(|&region| region_color(region)).collect()
}

/// Returns the colour of a region: one hue per finger, darker towards the base; sand for the palm, grey for dorsal.
pub fn region_color(region: Region) -> Rgb<u8> {
    // Hues of thumb, index, middle, ring, little in degrees.
    const HUES: [f32; 5] = [25.0, 85.0, 145.0, 230.0, 310.0];
    const CHROMA: f32 = 0.12;
    match region {
        Region::Palm => oklab(Vec3::new(0.88, 0.01, 0.04)),
        Region::Dorsal => oklab(Vec3::new(0.72, 0.0, -0.01)),
        _ => {
            let (finger, phalanx) = (region.index() / 3, region.index() % 3);
            let hue = HUES[finger].to_radians();
            oklab(Vec3::new(0.80 - 0.12 * phalanx as f32, CHROMA * hue.cos(), CHROMA * hue.sin()))
        }
    }
}

/// Draws a colour bar from zero to `max`, N, with the label above.
pub fn color_bar(max: f32, label: &str, (width, height): (u32, u32)) -> RgbImage {
    let mut picture = RgbImage::from_pixel(width, height, PAPER);
    let text = f64::from(height) * 0.36;
    let (top, bottom) = (height * 2 / 5, height * 3 / 5);
    let (left, right) = (width / 12, width - width / 12);
    for x in left..right {
        let force = max * (x - left) as f32 / (right - left).max(1) as f32;
        for y in top..bottom {
            picture.put_pixel(x, y, force_color(force, max));
        }
    }
    font::draw(&mut picture, label, (left as i32, (height / 24) as i32), text, INK, font::Align::Left);
    for (fraction, x) in [(0.0, left), (0.5, (left + right) / 2), (1.0, right)] {
        let number = format!("{:.*} N", if max < 5.0 { 2 } else { 1 }, max * fraction);
        font::draw(&mut picture, &number, (x as i32, (bottom + height / 12) as i32), text, INK, font::Align::Centre);
    }
    picture
}

/// Converts sRGB bytes to linear light.
pub(super) fn linear(color: Rgb<u8>) -> Vec3 {
    Vec3::from_array(color.0.map(|byte| {
        let value = f32::from(byte) / 255.0;
        if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
    }))
}

/// Converts linear light to sRGB bytes, clipped.
pub(super) fn encoded(color: Vec3) -> Rgb<u8> {
    Rgb(color.to_array().map(|value| {
        let value = value.clamp(0.0, 1.0);
        let value = if value <= 0.0031308 { 12.92 * value } else { 1.055 * value.powf(1.0 / 2.4) - 0.055 };
        (value * 255.0 + 0.5) as u8
    }))
}

/// Converts OKLab to sRGB (Ottosson 2020).
fn oklab(lab: Vec3) -> Rgb<u8> {
    let l = (lab.x + 0.396_337_78 * lab.y + 0.215_803_76 * lab.z).powi(3);
    let m = (lab.x - 0.105_561_346 * lab.y - 0.063_854_17 * lab.z).powi(3);
    let s = (lab.x - 0.089_484_18 * lab.y - 1.291_485_5 * lab.z).powi(3);
    encoded(Vec3::new(
        4.076_741_7 * l - 3.307_711_6 * m + 0.230_969_94 * s,
        -1.268_438 * l + 2.609_757_4 * m - 0.341_319_4 * s,
        -0.004_196_086_3 * l - 0.703_418_6 * m + 1.707_614_7 * s,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Computes the lightness of CIE L*a*b*, 0 to 100, a formula independent of the ramp's.
    fn cie_lightness(color: Rgb<u8>) -> f32 {
        let y = linear(color).dot(Vec3::new(0.2126, 0.7152, 0.0722));
        116.0 * y.cbrt() - 16.0
    }

    #[test]
    fn lightness_decreases_evenly_with_force() {
        let lightness: Vec<f32> = (0..=20).map(|k| cie_lightness(force_color(k as f32, 20.0))).collect();
        let steps: Vec<f32> = lightness.windows(2).map(|pair| pair[0] - pair[1]).collect();
        assert!(steps.iter().all(|&step| (1.0..6.5).contains(&step)), "{steps:?}");
    }

    #[test]
    fn colours_saturate_and_nan_is_grey() {
        assert_eq!(force_color(3.0, 2.0), force_color(2.0, 2.0));
        assert_eq!(force_color(1.0, 0.0), force_color(0.0, 1.0));
        assert_eq!(force_color(f32::NAN, 1.0), UNKNOWN);
        assert_eq!(force_colors(&[0.0, 1.0], 1.0), [force_color(0.0, 1.0), force_color(1.0, 1.0)]);
    }

    #[test]
    fn region_colours_are_distinct() {
        for (i, a) in Region::ALL.into_iter().enumerate() {
            for b in &Region::ALL[..i] {
                let (a, b) = (region_color(a), region_color(*b));
                let apart: i32 = (0..3).map(|k| (i32::from(a.0[k]) - i32::from(b.0[k])).abs()).sum();
                assert!(apart > 24, "{a:?} and {b:?}");
            }
        }
    }

    #[test]
    fn srgb_bytes_survive_conversion_to_linear_light() {
        for byte in 0..=255 {
            assert_eq!(encoded(linear(Rgb([byte; 3]))), Rgb([byte; 3]));
        }
    }

    #[test]
    fn colour_bar_runs_from_zero_to_max() {
        let bar = color_bar(3.0, "force", (240, 60));
        assert_eq!(*bar.get_pixel(20, 30), force_color(0.0, 3.0));
        let row: Vec<Rgb<u8>> = (20..220).map(|x| *bar.get_pixel(x, 30)).collect();
        assert!(row.is_sorted_by(|a, b| cie_lightness(*a) >= cie_lightness(*b) - 0.6));
        assert!(bar.pixels().any(|pixel| *pixel == INK), "no label");
    }
}
