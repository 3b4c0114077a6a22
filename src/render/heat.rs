//! Weights of patches, such as attention, drawn over their image.

use image::{ImageBuffer, Luma, Rgb, RgbImage, imageops};

/// Draws weights over an image of patches, `grid` x `grid`, row by row: darker where there is little, redder where there is
/// much. Returns a picture of `side` x `side` pixels.
pub fn overlay(image: &RgbImage, weights: &[f32], grid: u32, largest: f32, side: u32) -> RgbImage {
    let share = |weight: f32| if largest > 0.0 { weight / largest } else { 0.0 };
    let map =
        ImageBuffer::<Luma<f32>, Vec<f32>>::from_fn(grid, grid, |x, y| Luma([share(weights[(y * grid + x) as usize])]));
    let map = imageops::resize(&map, side, side, imageops::FilterType::Triangle);
    let picture = imageops::resize(image, side, side, imageops::FilterType::Triangle);
    RgbImage::from_fn(side, side, |x, y| {
        let heat = map.get_pixel(x, y).0[0].clamp(0.0, 1.0).sqrt();
        let Rgb(pixel) = *picture.get_pixel(x, y);
        let color = [255.0, 200.0 * heat, 0.0];
        Rgb(std::array::from_fn(|channel| {
            let dark = f32::from(pixel[channel]) * 0.55;
            (dark + 0.7 * heat * (color[channel] - dark)) as u8
        }))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: u32 = 64;

    #[test]
    fn the_patch_with_the_most_attention_is_the_reddest() {
        let image = RgbImage::from_pixel(28, 28, Rgb([80, 80, 80]));
        let picture = overlay(&image, &[0.0, 0.1, 0.0, 0.0], 2, 0.1, SIDE);
        let red = |x: u32, y: u32| i32::from(picture.get_pixel(x, y).0[0]) - i32::from(picture.get_pixel(x, y).0[2]);
        assert!(red(3 * SIDE / 4, SIDE / 4) > 100 && red(SIDE / 4, 3 * SIDE / 4) < 40);
    }
}
