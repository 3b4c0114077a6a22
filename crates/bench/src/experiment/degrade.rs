//! Pictures made worse, step by step.

use image::imageops::{self, FilterType};
use image::{Rgb, RgbImage};
use rand::Rng;

/// Grey of an occluding block: neither skin nor black.
const BLOCK: Rgb<u8> = Rgb([112, 112, 112]);
/// Exponent that turns the picture's values into light, about that of sRGB.
const GAMMA: f32 = 2.2;

/// One way in which pictures get worse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Degradation {
    /// A block over this share of the square around each hand in view, in the same place for a whole episode.
    Occlusion(f32),
    /// Motion during the exposure by this share of the picture's side, in one direction per episode.
    Blur(f32),
    /// Sensor noise of this standard deviation, in units of the 8-bit picture.
    Noise(f32),
    /// Light times two to this power, without more than white.
    Exposure(f32),
    /// Picture of this many pixels a side, scaled up again.
    Resolution(u32),
    /// New picture this often, 1/s; the last one stands in between.
    FrameRate(f64),
}

/// Random values of an episode.
#[derive(Debug, Clone, Copy)]
pub struct Episode {
    /// Place of a block within the room that its square leaves, 0 to 1 along both axes.
    pub block: [f32; 2],
    /// Direction of motion, rad.
    pub direction: f32,
}

impl Episode {
    /// Draws the values of an episode.
    pub fn draw(rng: &mut impl Rng) -> Self {
        let block = [rng.random(), rng.random()];
        Self { block, direction: rng.random_range(0.0..std::f32::consts::TAU) }
    }
}

impl Degradation {
    /// Degrades a picture. `squares`: centre (x, y) and half side of the square around each hand in view, as shares of the
    /// picture's side. The frame rate is not a matter of single pictures.
    pub fn apply(self, image: RgbImage, squares: &[[f32; 3]], episode: &Episode, rng: &mut impl Rng) -> RgbImage {
        match self {
            Self::Occlusion(share) => occlude(image, squares, share, episode.block),
            Self::Blur(length) => blur(&image, length * image.width() as f32, episode.direction),
            Self::Noise(sigma) => noise(image, sigma, rng),
            Self::Exposure(stops) => expose(image, stops),
            Self::Resolution(side) => {
                let small = imageops::resize(&image, side, side, FilterType::Triangle);
                imageops::resize(&small, image.width(), image.height(), FilterType::Triangle)
            }
            Self::FrameRate(_) => image,
        }
    }
}

fn occlude(mut image: RgbImage, squares: &[[f32; 3]], share: f32, place: [f32; 2]) -> RgbImage {
    let side = image.width() as f32;
    for [x, y, half] in squares {
        let (room, length) = (2.0 * half * (1.0 - share.sqrt()), 2.0 * half * share.sqrt());
        let edge = |centre: &f32, at: f32| side * (centre - half + at * room);
        let [left, top] = [edge(x, place[0]), edge(y, place[1])];
        let span = |from: f32, end: u32| {
            let pixel = |at: f32| at.round().clamp(0.0, end as f32) as u32;
            pixel(from)..pixel(from + side * length)
        };
        let (rows, columns) = (span(top, image.height()), span(left, image.width()));
        for (x, y) in rows.flat_map(|y| columns.clone().map(move |x| (x, y))) {
            image.put_pixel(x, y, BLOCK);
        }
    }
    image
}

/// Averages pictures moved along a line of `length` pixels; the edge is repeated beyond the picture.
fn blur(image: &RgbImage, length: f32, direction: f32) -> RgbImage {
    let count = (length.ceil() as i32).max(1);
    let moves: Vec<(i32, i32)> = (0..=count)
        .map(|i| {
            let along = length * (i as f32 / count as f32 - 0.5);
            ((along * direction.cos()).round() as i32, (along * direction.sin()).round() as i32)
        })
        .collect();
    let (width, height) = (image.width() as i32, image.height() as i32);
    RgbImage::from_fn(image.width(), image.height(), |x, y| {
        let mut sum = [0u32; 3];
        for (dx, dy) in &moves {
            let (x, y) = ((x as i32 + dx).clamp(0, width - 1), (y as i32 + dy).clamp(0, height - 1));
            let pixel = image.get_pixel(x as u32, y as u32).0;
            (0..3).for_each(|channel| sum[channel] += u32::from(pixel[channel]));
        }
        Rgb(sum.map(|sum| (sum / moves.len() as u32) as u8))
    })
}

fn noise(mut image: RgbImage, sigma: f32, rng: &mut impl Rng) -> RgbImage {
    use rand_distr::{Distribution, StandardNormal};
    for value in image.iter_mut() {
        let drawn: f32 = StandardNormal.sample(rng);
        *value = (f32::from(*value) + sigma * drawn).round().clamp(0.0, 255.0) as u8;
    }
    image
}

fn expose(mut image: RgbImage, stops: f32) -> RgbImage {
    let factor = 2f32.powf(stops / GAMMA);
    image.iter_mut().for_each(|value| *value = (f32::from(*value) * factor).round().min(255.0) as u8);
    image
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn picture() -> RgbImage {
        RgbImage::from_fn(64, 64, |x, y| Rgb([(4 * x) as u8, (4 * y) as u8, ((x * 7 + y * 13) % 256) as u8]))
    }

    fn degraded(how: Degradation, squares: &[[f32; 3]]) -> RgbImage {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let episode = Episode { block: [0.0, 1.0], direction: 0.0 };
        how.apply(picture(), squares, &episode, &mut rng)
    }

    #[test]
    fn a_block_hides_its_share_of_the_square_and_nothing_else() {
        let out = degraded(Degradation::Occlusion(0.25), &[[0.5, 0.5, 0.25]]);
        // The square is 16..48; half its side is hidden at the lower left.
        let changed: Vec<(u32, u32)> = (0..64)
            .flat_map(|y| (0..64).map(move |x| (x, y)))
            .filter(|(x, y)| out.get_pixel(*x, *y) == &BLOCK)
            .collect();
        assert_eq!(changed.len(), 16 * 16);
        assert!(changed.iter().all(|(x, y)| (16..32).contains(x) && (32..48).contains(y)));
        assert_eq!(degraded(Degradation::Occlusion(0.5), &[]), picture());
    }

    #[test]
    fn blur_along_a_line_keeps_a_ramp_along_it_and_columns_across_it() {
        let out = degraded(Degradation::Blur(0.1), &[]);
        for y in 8..56 {
            for x in 8..56 {
                let ([r, g, _], [r0, g0, _]) = (out.get_pixel(x, y).0, picture().get_pixel(x, y).0);
                assert!(r.abs_diff(r0) <= 1 && g.abs_diff(g0) <= 1, "{x} {y}");
            }
        }
        assert_ne!(out, picture());
    }

    #[test]
    fn noise_and_exposure_have_the_size_that_is_asked_for() {
        let grey = RgbImage::from_pixel(200, 200, Rgb([128; 3]));
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let out = noise(grey.clone(), 10.0, &mut rng);
        let mean = out.iter().map(|v| f64::from(*v)).sum::<f64>() / 120_000.0;
        let sigma = (out.iter().map(|v| (f64::from(*v) - mean).powi(2)).sum::<f64>() / 120_000.0).sqrt();
        assert!((mean - 128.0).abs() < 0.2 && (sigma - 10.0).abs() < 0.2, "{mean} {sigma}");
        // A stop is twice the light: 128 in 255 becomes 128 · 2^(1/2.2) = 175.4.
        assert_eq!(expose(grey.clone(), 1.0).get_pixel(0, 0).0, [175; 3]);
        assert_eq!(expose(grey, 8.0).get_pixel(0, 0).0, [255; 3]);
    }

    #[test]
    fn a_coarse_picture_keeps_its_mean_and_loses_its_detail() {
        let out = degraded(Degradation::Resolution(8), &[]);
        let mean = |image: &RgbImage| image.iter().map(|v| f64::from(*v)).sum::<f64>() / (64.0 * 64.0 * 3.0);
        assert!((mean(&out) - mean(&picture())).abs() < 1.5);
        let rough = |image: &RgbImage| {
            (1..64).map(|x| i64::from(image.get_pixel(x, 9).0[2].abs_diff(image.get_pixel(x - 1, 9).0[2]))).sum::<i64>()
        };
        assert!(rough(&out) * 4 < rough(&picture()));
    }
}
