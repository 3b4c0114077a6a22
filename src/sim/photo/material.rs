//! Procedural textures of surfaces: wood, cloth, tiles, plaster, print, dead leaves.

use image::{Rgb as Pixel, RgbImage};
use rand::Rng;

use super::noise::{Noise, unit};
use crate::sim::appearance::{Rgb, colour};

/// Side of a texture, pixels.
pub(crate) const TEXTURE_SIDE: u32 = 256;
/// Number of discs of dead leaves.
const LEAVES: u64 = 700;

/// Kind of a surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Surface {
    /// Planks with grain.
    Wood,
    /// Woven cloth.
    Cloth,
    /// Tiles with joints.
    Tiles,
    /// Plaster, stone, painted metal: cloudy, one colour.
    Plaster,
    /// Printed matter: lines of words, boxes.
    Print,
    /// Overlapping discs of all sizes and colours, whose statistics are those of photographs.
    Leaves,
}

/// Drawn texture of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Material {
    /// Kind.
    pub surface: Surface,
    /// First colour.
    pub base: Rgb,
    /// Second colour: grain, joints, ink.
    pub other: Rgb,
    /// Repeats across the surface.
    pub repeat: f64,
    /// Seed of the pattern.
    pub seed: u64,
    /// Share of light that is reflected as by a mirror, 0 to 1.
    pub gloss: f64,
}

impl Material {
    /// Draws the material of a table.
    pub(super) fn table(rng: &mut impl Rng) -> Self {
        let surface =
            pick(rng, &[Surface::Wood, Surface::Wood, Surface::Wood, Surface::Cloth, Surface::Plaster, Surface::Print]);
        Self { repeat: rng.random_range(1.0_f64..3.0).round(), ..Self::of(surface, rng) }
    }

    /// Draws the material of a floor.
    pub(super) fn floor(rng: &mut impl Rng) -> Self {
        let surface = pick(rng, &[Surface::Tiles, Surface::Wood, Surface::Cloth, Surface::Plaster, Surface::Leaves]);
        Self { repeat: rng.random_range(4.0_f64..10.0).round(), ..Self::of(surface, rng) }
    }

    /// Draws the material of walls and of what stands before them.
    pub(super) fn wall(rng: &mut impl Rng) -> Self {
        let surface = pick(rng, &[Surface::Plaster, Surface::Leaves, Surface::Leaves, Surface::Tiles, Surface::Print]);
        Self { repeat: rng.random_range(1.0_f64..3.0).round(), ..Self::of(surface, rng) }
    }

    /// Draws the material of an object.
    pub(super) fn object(rng: &mut impl Rng) -> Self {
        let all = [Surface::Print, Surface::Plaster, Surface::Plaster, Surface::Wood, Surface::Cloth, Surface::Leaves];
        Self { repeat: 1.0, ..Self::of(pick(rng, &all), rng) }
    }

    fn of(surface: Surface, rng: &mut impl Rng) -> Self {
        let (base, other) = match surface {
            Surface::Wood => {
                // From pale birch over oak to dark walnut.
                let (light, warmth) = (rng.random_range(0.25..0.85), rng.random_range(0.5..0.8));
                let base = [light, light * (0.55 + 0.35 * warmth), light * (0.25 + 0.5 * warmth)];
                (base, base.map(|c| c * rng.random_range(0.45..0.75)))
            }
            Surface::Print => {
                let paper = colour(rng, 0.0..0.25, 0.6..1.0);
                (paper, colour(rng, 0.0..0.9, 0.0..0.5))
            }
            _ => {
                // Few surfaces of rooms have strong colours.
                let strong = rng.random::<f64>().powi(2) * 0.75;
                let base = colour(rng, 0.0..strong + 0.05, 0.15..0.95);
                // Darker or lighter, never the same.
                let factor = if rng.random::<bool>() { 0.5..0.85 } else { 1.15..1.4 };
                (base, base.map(|c| (c * rng.random_range(factor.clone())).clamp(0.0, 1.0)))
            }
        };
        Self { surface, base, other, repeat: 1.0, seed: rng.random(), gloss: rng.random_range(0.0..0.5) }
    }

    /// Paints the texture: [`TEXTURE_SIDE`] pixels a side, without a seam where it repeats.
    pub(crate) fn paint(&self) -> RgbImage {
        match self.surface {
            Surface::Leaves => self.paint_leaves(),
            Surface::Print => self.paint_print(),
            _ => RgbImage::from_fn(TEXTURE_SIDE, TEXTURE_SIDE, |x, y| {
                let place = |k: u32| f64::from(k) / f64::from(TEXTURE_SIDE);
                pixel(self.colour_at(place(x), place(y)))
            }),
        }
    }

    /// Returns the colour at a place, in periods.
    fn colour_at(&self, u: f64, v: f64) -> Rgb {
        let fine = Noise::new(self.seed, 4);
        match self.surface {
            Surface::Wood => {
                // Four planks; along each, rings stretched by the grain.
                let plank = (4.0 * v).floor();
                let shift = unit(self.seed, [1, plank as u64, 0]);
                let warp = fine.at(u + shift, v, [2, 8]);
                let grain = fine.at(u + shift, v + 0.02 * warp, [3, 64]);
                let ring = 0.5 + 0.5 * (24.0 * (4.0 * v + 1.5 * warp)).sin();
                let joint = if (4.0 * v).fract() < 0.02 { 0.5 } else { 1.0 };
                let tone = joint * (0.85 + 0.3 * unit(self.seed, [2, plank as u64, 0]));
                mix(self.base, self.other, 0.65 * grain + 0.25 * ring).map(|c| c * tone)
            }
            Surface::Cloth => {
                let thread = |t: f64| 0.5 + 0.5 * (std::f64::consts::TAU * 64.0 * t).sin();
                let over = (64.0 * u).floor() as i64 + (64.0 * v).floor() as i64;
                let weave = if over % 2 == 0 { thread(u) } else { thread(v) };
                let stain = fine.at(u, v, [4, 4]);
                mix(self.base, self.other, 0.4 * weave + 0.4 * stain)
            }
            Surface::Tiles => {
                let (i, j) = ((4.0 * u).floor(), (4.0 * v).floor());
                let joint = (4.0 * u).fract() < 0.04 || (4.0 * v).fract() < 0.04;
                let tone = 0.9 + 0.2 * unit(self.seed, [3, i as u64, j as u64]);
                let cloud = 0.3 * fine.at(u, v, [8, 8]);
                if joint { self.other.map(|c| 0.7 * c) } else { mix(self.base, self.other, cloud).map(|c| c * tone) }
            }
            _ => mix(self.base, self.other, 1.4 * fine.at(u, v, [5, 5]) - 0.3),
        }
    }

    /// Paints discs over each other whose radii fall off with their third power.
    fn paint_leaves(&self) -> RgbImage {
        let mut picture = RgbImage::from_pixel(TEXTURE_SIDE, TEXTURE_SIDE, pixel(self.base));
        let side = f64::from(TEXTURE_SIDE);
        for leaf in 0..LEAVES {
            let random = |k: u64| unit(self.seed, [4, leaf, k]);
            // The density r^-3 between 2 % and 35 % of the side, by inversion.
            let (low, high) = (0.02_f64.powi(-2), 0.35_f64.powi(-2));
            let radius = side * (low + (high - low) * random(0)).powf(-0.5);
            let (x, y) = (side * random(1), side * random(2));
            let own = mix(self.base, self.other, 2.0 * random(3) - 0.5);
            let leaf_colour = std::array::from_fn(|c| own[c] * 0.6 + 0.4 * random(4 + c as u64));
            let reach = radius.ceil() as i64;
            for dy in -reach..=reach {
                let half = (radius * radius - (dy * dy) as f64).max(0.0).sqrt() as i64;
                for dx in -half..=half {
                    let wrap = |at: f64, by: i64| (at as i64 + by).rem_euclid(i64::from(TEXTURE_SIDE)) as u32;
                    picture.put_pixel(wrap(x, dx), wrap(y, dy), pixel(leaf_colour));
                }
            }
        }
        picture
    }

    /// Paints lines of words and some boxes.
    fn paint_print(&self) -> RgbImage {
        let mut picture = RgbImage::from_pixel(TEXTURE_SIDE, TEXTURE_SIDE, pixel(self.base));
        let (ink, accent) = (pixel(self.other), pixel(self.other.map(|c| 1.0 - c)));
        let rows = 10 + (30.0 * unit(self.seed, [5, 0, 0])) as u32;
        let pitch = TEXTURE_SIDE / rows;
        for row in 0..rows {
            let mut x = pitch;
            let mut word = 0;
            while x + 4 < TEXTURE_SIDE - pitch / 2 {
                let random = |k: u64| unit(self.seed, [6 + k, u64::from(row), word]);
                let length = 2 + (4.0 * f64::from(pitch) * random(0)) as u32;
                if random(1) < 0.85 {
                    fill(&mut picture, [x, row * pitch + pitch / 4], [length, (pitch / 2).max(1)], ink);
                }
                (x, word) = (x + length + pitch / 3 + 1, word + 1);
            }
        }
        for index in 0..3 {
            let random = |k: u64| unit(self.seed, [12, index, k]);
            let at = [0, 1].map(|k| (f64::from(TEXTURE_SIDE) * random(k)) as u32);
            let size = [2, 3].map(|k| 16 + (80.0 * random(k)) as u32);
            fill(&mut picture, at, size, if random(4) < 0.5 { ink } else { accent });
        }
        picture
    }
}

/// Fills a rectangle, cut off at the border.
fn fill(picture: &mut RgbImage, [x, y]: [u32; 2], [width, height]: [u32; 2], colour: Pixel<u8>) {
    for j in y..(y + height).min(picture.height()) {
        for i in x..(x + width).min(picture.width()) {
            picture.put_pixel(i, j, colour);
        }
    }
}

fn pick<T: Copy>(rng: &mut impl Rng, all: &[T]) -> T {
    all[rng.random_range(0..all.len())]
}

/// Mixes two colours; `part` of the second one, below 0 and above 1 extrapolated.
pub(super) fn mix(a: Rgb, b: Rgb, part: f64) -> Rgb {
    std::array::from_fn(|c| (a[c] + (b[c] - a[c]) * part).clamp(0.0, 1.0))
}

/// Converts a colour to 8 bits.
pub(super) fn pixel(colour: Rgb) -> Pixel<u8> {
    Pixel(colour.map(|c| (255.0 * c).round().clamp(0.0, 255.0) as u8))
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Largest mean difference between neighbouring columns, and the one across the seam.
    fn steps(picture: &RgbImage) -> (f64, f64) {
        let step = |a: u32, b: u32| {
            let rows = 0..picture.height();
            let differences = rows.flat_map(|y| {
                let [a, b] = [a, b].map(|x| picture.get_pixel(x, y).0);
                (0..3).map(move |channel| f64::from(a[channel].abs_diff(b[channel])))
            });
            differences.sum::<f64>()
        };
        let inner = (0..picture.width() - 1).map(|x| step(x, x + 1)).fold(0.0, f64::max);
        (inner, step(picture.width() - 1, 0))
    }

    #[test]
    fn no_texture_has_a_seam_or_a_single_colour() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for surface in
            [Surface::Wood, Surface::Cloth, Surface::Tiles, Surface::Plaster, Surface::Print, Surface::Leaves]
        {
            let picture = Material::of(surface, &mut rng).paint();
            let (inner, seam) = steps(&picture);
            // Joints of tiles are as steep across the seam as inside.
            assert!(seam <= 1.1 * inner && inner > 0.0, "{surface:?}: {seam} across the seam, at most {inner} inside");
        }
    }
}
