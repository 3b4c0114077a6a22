//! Image augmentation, the same for all frames of a clip.

use rand::Rng;

use super::config::AugmentConfig;

/// One random augmentation: a crop, a mirroring and a linear colour transform.
#[derive(Debug, Clone, PartialEq)]
pub struct Augmentation {
    /// Left edge of the view, as a share of the side.
    left: f32,
    /// Upper edge of the view, as a share of the side.
    top: f32,
    /// Side of the view as a share of the image's.
    scale: f32,
    /// Linear map of RGB in 0..1, row-major.
    matrix: [[f32; 3]; 3],
    /// Offset added after the map.
    offset: f32,
    /// True if the result is mirrored left to right.
    pub mirrored: bool,
}

impl Augmentation {
    /// Returns an augmentation that changes nothing.
    #[cfg(test)]
    pub fn identity() -> Self {
        Self { left: 0.0, top: 0.0, scale: 1.0, matrix: color_matrix(1.0, 0.0, 1.0), offset: 0.0, mirrored: false }
    }

    /// Draws an augmentation; mirrors only if `mirrorable`.
    pub fn draw(config: &AugmentConfig, mirrorable: bool, rng: &mut impl Rng) -> Self {
        let mut within = |half: f64| if half > 0.0 { rng.random_range(-half..=half) } else { 0.0 };
        let brightness = 1.0 + within(config.brightness);
        let contrast = 1.0 + within(config.contrast);
        let saturation = 1.0 + within(config.saturation);
        let hue = within(config.hue);
        let view = 1.0 + within(config.view_scale);
        let crop = 1.0 - within(config.crop).abs();
        let [x, y] = [within(1.0), within(1.0)];
        let view = if rng.random_bool(config.view_scale_probability) { view } else { 1.0 };
        let scale = crop * view;
        // Largest shift of the crop from the centre; a view wider than the image stays centred.
        let max_shift = 0.5 * (1.0 - crop).max(0.0) * view;
        let edge = |shift: f64| (0.5 * (1.0 - scale) + max_shift * shift) as f32;
        Self {
            left: edge(x),
            top: edge(y),
            scale: scale as f32,
            matrix: color_matrix(brightness * contrast, hue, saturation),
            // Contrast scales around mid-grey.
            offset: (0.5 * (1.0 - contrast)) as f32,
            mirrored: mirrorable && rng.random_bool(config.mirror),
        }
    }

    /// Maps a place in the image, as shares of its sides, to its place in the augmented image.
    pub fn place(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        let x = (x - self.left) / self.scale;
        [if self.mirrored { 1.0 - x } else { x }, (y - self.top) / self.scale]
    }

    /// Augments and normalises `pixels` `(side, side, 3)` u8 into `out` `(3, side, side)`, with bilinear interpolation and
    /// the edge repeated beyond the image.
    pub fn apply(&self, pixels: &[u8], side: usize, mean: [f32; 3], std: [f32; 3], out: &mut [f32]) {
        let (mut columns, rows) = (taps(self.left, self.scale, side), taps(self.top, self.scale, side));
        if self.mirrored {
            columns.reverse();
        }
        let mut row = vec![[0f32; 3]; side];
        for (y, (top, bottom, below)) in rows.iter().enumerate() {
            let [upper, lower] = [top, bottom].map(|r| &pixels[r * side * 3..(r + 1) * side * 3]);
            // Interpolates vertically, on whole rows, then horizontally within the blended row.
            for ((blend, u), l) in row.iter_mut().zip(upper.chunks_exact(3)).zip(lower.chunks_exact(3)) {
                for c in 0..3 {
                    blend[c] = f32::from(u[c]) * (1.0 - below) + f32::from(l[c]) * below;
                }
            }
            for (x, (a, b, right)) in columns.iter().enumerate() {
                let rgb: [f32; 3] =
                    std::array::from_fn(|c| (row[*a][c] * (1.0 - right) + row[*b][c] * right) * (1.0 / 255.0));
                for (c, m) in self.matrix.iter().enumerate() {
                    let value = m[0] * rgb[0] + m[1] * rgb[1] + m[2] * rgb[2] + self.offset;
                    out[(c * side + y) * side + x] = (value.clamp(0.0, 1.0) - mean[c]) / std[c];
                }
            }
        }
    }
}

/// Returns for each output pixel the two source pixels that it lies between, and the weight of the second one.
fn taps(start: f32, scale: f32, side: usize) -> Vec<(usize, usize, f32)> {
    let last = side as f32 - 1.0;
    let tap = |i: usize| {
        let at = (start * side as f32 + (i as f32 + 0.5) * scale - 0.5).clamp(0.0, last);
        let floor = at.floor();
        (floor as usize, (floor as usize + 1).min(side - 1), at - floor)
    };
    (0..side).map(tap).collect()
}

/// Returns the colour matrix of a gain, a rotation about the grey axis by `hue`, and a scaling of the distance from that axis
/// by `saturation`.
fn color_matrix(gain: f64, hue: f64, saturation: f64) -> [[f32; 3]; 3] {
    let (sin, cos) = hue.sin_cos();
    let sin = sin / 3f64.sqrt();
    std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            let grey = 1.0 / 3.0;
            let identity = f64::from(i == j);
            // Rodrigues' formula about (1, 1, 1) / sqrt 3; the sign of the cross product depends on the order of i and j.
            let cross = if i == j {
                0.0
            } else if (i + 1) % 3 == j {
                -sin
            } else {
                sin
            };
            let rotated = cos * (identity - grey) + cross;
            (gain * (grey + saturation * rotated)) as f32
        })
    })
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::image::{IMAGENET_MEAN, IMAGENET_STD, normalise};

    const SIDE: usize = 16;

    fn picture() -> Vec<u8> {
        (0..SIDE * SIDE * 3).map(|i| (i * 37 % 251) as u8).collect()
    }

    fn apply(change: &Augmentation, pixels: &[u8]) -> Vec<f32> {
        let mut out = vec![0.0; pixels.len()];
        change.apply(pixels, SIDE, [0.0; 3], [1.0; 3], &mut out);
        out
    }

    #[test]
    fn no_augmentation_gives_the_input_of_inference() {
        let image = image::RgbImage::from_raw(SIDE as u32, SIDE as u32, picture()).unwrap();
        let expected = normalise(&image, IMAGENET_MEAN, IMAGENET_STD);
        let drawn = Augmentation::draw(&AugmentConfig::none(), true, &mut ChaCha8Rng::seed_from_u64(1));
        for change in [Augmentation::identity(), drawn] {
            let mut out = vec![0.0; expected.len()];
            change.apply(image.as_raw(), SIDE, IMAGENET_MEAN, IMAGENET_STD, &mut out);
            let worst = out.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(worst < 1e-5, "{worst}");
        }
    }

    #[test]
    fn a_crop_at_the_centre_keeps_a_linear_ramp_linear() {
        // A horizontal ramp: any crop of it is linear in x, whatever the interpolation.
        let ramp: Vec<u8> = (0..SIDE * SIDE * 3).map(|i| ((i / 3) % SIDE * 16) as u8).collect();
        let change = Augmentation { left: 0.25, top: 0.25, scale: 0.5, ..Augmentation::identity() };
        let out = apply(&change, &ramp);
        for x in 0..SIDE {
            let expected = 16.0 * (4.0 + (x as f32 + 0.5) * 0.5 - 0.5) / 255.0;
            assert!((out[5 * SIDE + x] - expected).abs() < 1e-5, "{x}: {} instead of {expected}", out[5 * SIDE + x]);
        }
    }

    #[test]
    fn a_place_moves_with_the_pixels_there() {
        // Tracks the centre of a bright spot.
        let mut spot = vec![0u8; SIDE * SIDE * 3];
        for (x, y) in [(9, 5), (10, 5), (9, 6), (10, 6)] {
            spot[(y * SIDE + x) * 3..][..3].fill(255);
        }
        let change = Augmentation { left: 0.2, top: 0.1, scale: 0.7, ..Augmentation::identity() };
        let out = apply(&change, &spot);
        let mut sums = [0f32; 3];
        for (i, value) in out[..SIDE * SIDE].iter().enumerate() {
            let at = [(i % SIDE) as f32 + 0.5, (i / SIDE) as f32 + 0.5, 1.0];
            sums.iter_mut().zip(at).for_each(|(sum, at)| *sum += value * at / SIDE as f32);
        }
        let seen = [sums[0], sums[1]].map(|sum| sum / (sums[2] * SIDE as f32));
        let place = change.place([10.0 / SIDE as f32, 6.0 / SIDE as f32]);
        assert!((0..2).all(|axis| (seen[axis] - place[axis]).abs() < 0.02), "{seen:?} {place:?}");
    }

    #[test]
    fn a_mirrored_image_has_its_columns_reversed() {
        let (plain, mirrored) = (Augmentation::identity(), Augmentation { mirrored: true, ..Augmentation::identity() });
        let (before, after) = (apply(&plain, &picture()), apply(&mirrored, &picture()));
        for (row, reversed) in before.chunks_exact(SIDE).zip(after.chunks_exact(SIDE)) {
            assert!(row.iter().eq(reversed.iter().rev()));
        }
        assert_eq!(mirrored.place([0.25, 0.75]), [0.75, 0.75]);
        let drawn = |mirrorable| {
            let mut rng = ChaCha8Rng::seed_from_u64(5);
            (0..200).filter(|_| Augmentation::draw(&AugmentConfig::default(), mirrorable, &mut rng).mirrored).count()
        };
        assert_eq!(drawn(false), 0);
        assert!((70..130).contains(&drawn(true)), "{}", drawn(true));
    }

    #[test]
    fn grey_keeps_its_hue_and_a_third_of_a_turn_permutes_the_channels() {
        let turn = Augmentation {
            matrix: color_matrix(1.0, 2.0 * std::f64::consts::PI / 3.0, 1.0),
            ..Augmentation::identity()
        };
        assert!(apply(&turn, &[128; SIDE * SIDE * 3]).iter().all(|v| (v - 128.0 / 255.0).abs() < 1e-5));
        let red: Vec<u8> = [255, 0, 0].repeat(SIDE * SIDE);
        let out = apply(&turn, &red);
        let channels = [out[0], out[SIDE * SIDE], out[2 * SIDE * SIDE]];
        assert!(channels[0] < 1e-5 && (channels[1] - 1.0).abs() < 1e-5 && channels[2] < 1e-5, "{channels:?}");
    }

    #[test]
    fn draws_depend_only_on_the_generator() {
        let draw = |seed| Augmentation::draw(&AugmentConfig::default(), true, &mut ChaCha8Rng::seed_from_u64(seed));
        assert_eq!(draw(3), draw(3));
        assert_ne!(draw(3), draw(4));
    }
}
