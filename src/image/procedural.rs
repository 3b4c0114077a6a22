//! Pictures that show no hand, made by rules: tests of what a network says about images unlike those of its training.

use ::image::imageops::{FilterType, resize};
use ::image::{Rgb, Rgb32FImage, RgbImage};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Kind of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Picture {
    /// Black.
    Black,
    /// One colour.
    Colour,
    /// A linear passage between two colours.
    Gradient,
    /// An independent value per pixel and channel.
    Noise,
    /// Octaves of smooth noise with amplitudes in proportion to their wavelength: the spectrum of natural pictures, 1/f.
    Pink,
    /// Opaque discs over each other, with as many of each size as natural pictures have edges (dead leaves).
    DeadLeaves,
}

impl Picture {
    /// All kinds.
    pub const ALL: [Picture; 6] =
        [Self::Black, Self::Colour, Self::Gradient, Self::Noise, Self::Pink, Self::DeadLeaves];

    /// Name for tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Black => "black",
            Self::Colour => "one colour",
            Self::Gradient => "gradient",
            Self::Noise => "noise",
            Self::Pink => "1/f noise",
            Self::DeadLeaves => "dead leaves",
        }
    }

    /// Draws a picture of `width` by `height` pixels; equal seeds give equal pictures.
    pub fn draw(self, width: u32, height: u32, seed: u64) -> RgbImage {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        match self {
            Self::Black => RgbImage::new(width, height),
            Self::Colour => RgbImage::from_pixel(width, height, Rgb(random.random())),
            Self::Gradient => gradient(width, height, &mut random),
            Self::Noise => RgbImage::from_fn(width, height, |_, _| Rgb(random.random())),
            Self::Pink => pink(width, height, &mut random),
            Self::DeadLeaves => dead_leaves(width, height, &mut random),
        }
    }
}

fn gradient(width: u32, height: u32, random: &mut impl Rng) -> RgbImage {
    let (from, to): ([u8; 3], [u8; 3]) = (random.random(), random.random());
    let angle: f32 = random.random_range(0.0..std::f32::consts::TAU);
    let (along_x, along_y) = (angle.cos(), angle.sin());
    let reach = 0.5 * (along_x.abs() + along_y.abs());
    RgbImage::from_fn(width, height, |x, y| {
        let (x, y) = (x as f32 / width as f32 - 0.5, y as f32 / height as f32 - 0.5);
        let share = 0.5 + 0.5 * (along_x * x + along_y * y) / reach;
        Rgb(std::array::from_fn(|c| (f32::from(from[c]) * (1.0 - share) + f32::from(to[c]) * share) as u8))
    })
}

fn pink(width: u32, height: u32, random: &mut impl Rng) -> RgbImage {
    let mut sum = Rgb32FImage::new(width, height);
    let (mut cells, mut total) = (2u32, 0.0);
    while cells <= width.min(height) {
        let amplitude = 1.0 / cells as f32;
        total += amplitude;
        let grid =
            Rgb32FImage::from_fn(cells, cells, |_, _| Rgb(std::array::from_fn(|_| random.random_range(0.0..1.0))));
        for (sum, octave) in sum.iter_mut().zip(resize(&grid, width, height, FilterType::CatmullRom).iter()) {
            *sum += amplitude * octave;
        }
        cells *= 2;
    }
    let byte = |value: f32| (255.0 * value / total).clamp(0.0, 255.0) as u8;
    RgbImage::from_fn(width, height, |x, y| Rgb(sum.get_pixel(x, y).0.map(byte)))
}

fn dead_leaves(width: u32, height: u32, random: &mut impl Rng) -> RgbImage {
    let mut picture = RgbImage::from_pixel(width, height, Rgb(random.random()));
    let (least, most) = (0.01 * width as f32, 0.3 * width as f32);
    for _ in 0..2000 {
        // Radii with density r^-3 by inversion of the cumulative distribution.
        let share: f32 = random.random();
        let radius = (least.powi(-2) * (1.0 - share) + most.powi(-2) * share).powf(-0.5);
        let (x, y) = (random.random_range(0.0..width as f32), random.random_range(0.0..height as f32));
        let colour = Rgb(random.random());
        let span = |centre: f32, end: u32| (centre - radius).max(0.0) as u32..((centre + radius) as u32 + 1).min(end);
        for row in span(y, height) {
            for column in span(x, width) {
                if (column as f32 - x).hypot(row as f32 - y) <= radius {
                    picture.put_pixel(column, row, colour);
                }
            }
        }
    }
    picture
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_seeds_give_equal_pictures_and_others_differ() {
        for kind in Picture::ALL {
            let draw = |seed| kind.draw(48, 36, seed);
            assert_eq!(draw(1), draw(1), "{}", kind.name());
            assert_eq!(draw(1) == draw(2), kind == Picture::Black, "{}", kind.name());
        }
    }

    #[test]
    fn pink_noise_has_most_of_its_power_at_low_frequencies_and_white_noise_has_not() {
        // Share of the power in differences of neighbours: 2 of white noise's variance, little of 1/f.
        let roughness = |kind: Picture| {
            let picture = kind.draw(64, 64, 3);
            let grey = |x, y| f32::from(picture.get_pixel(x, y)[0]);
            let pixels: Vec<(u32, u32)> = (0..63).flat_map(|y| (0..63).map(move |x| (x, y))).collect();
            let n = pixels.len() as f32;
            let mean = pixels.iter().map(|(x, y)| grey(*x, *y)).sum::<f32>() / n;
            let variance = pixels.iter().map(|(x, y)| (grey(*x, *y) - mean).powi(2)).sum::<f32>() / n;
            let steps = pixels.iter().map(|(x, y)| (grey(x + 1, *y) - grey(*x, *y)).powi(2)).sum::<f32>() / n;
            steps / variance
        };
        assert!((roughness(Picture::Noise) - 2.0).abs() < 0.2, "{}", roughness(Picture::Noise));
        assert!(roughness(Picture::Pink) < 0.2, "{}", roughness(Picture::Pink));
    }
}
