//! Colours of a Bayer pattern, by bilinear interpolation as in OpenCV.

use ::image::{Rgb, RgbImage};

/// Least width and height of an image, pixels: the border repeats pixels with neighbours on all sides.
pub const MIN_SIDE: u32 = 3;

/// Returns an image with all colours at each pixel.
///
/// `red`: column and row of the first red pixel, 0 or 1; blue lies diagonally beside it. `at(x, y)` returns the value of a pixel,
/// `to_u8` converts a value. Both sides must be at least [`MIN_SIDE`].
pub fn to_rgb(
    width: u32,
    height: u32,
    red: [usize; 2],
    at: impl Fn(usize, usize) -> u32,
    to_u8: impl Fn(u32) -> u8,
) -> RgbImage {
    let half = |a: u32, b: u32| (a + b).div_ceil(2);
    let quarter = |values: [u32; 4]| (values.iter().sum::<u32>() + 2) / 4;
    RgbImage::from_fn(width, height, |x, y| {
        let (x, y) = (x.clamp(1, width - 2) as usize, y.clamp(1, height - 2) as usize);
        let across = || half(at(x - 1, y), at(x + 1, y));
        let down = || half(at(x, y - 1), at(x, y + 1));
        let beside = || quarter([at(x - 1, y), at(x + 1, y), at(x, y - 1), at(x, y + 1)]);
        let diagonal = || quarter([at(x - 1, y - 1), at(x + 1, y - 1), at(x - 1, y + 1), at(x + 1, y + 1)]);
        let is_red_column = x % 2 == red[0];
        let is_red_row = y % 2 == red[1];
        let rgb = match (is_red_column, is_red_row) {
            (true, true) => [at(x, y), beside(), diagonal()],
            (false, false) => [diagonal(), beside(), at(x, y)],
            (false, true) => [across(), at(x, y), down()],
            (true, false) => [down(), at(x, y), across()],
        };
        Rgb(rgb.map(&to_u8))
    })
}
