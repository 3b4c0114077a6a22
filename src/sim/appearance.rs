//! Random appearance: colours, patterns and lights, so that a network learns shapes rather than colours.

use glam::DVec3;
use rand::Rng;

/// Red, green and blue, each 0 to 1.
pub type Rgb = [f64; 3];

/// Skin tones from light to dark; drawn tones lie between neighbours.
const SKIN: [Rgb; 6] = [
    [0.97, 0.82, 0.73],
    [0.92, 0.73, 0.61],
    [0.82, 0.61, 0.47],
    [0.66, 0.46, 0.33],
    [0.47, 0.31, 0.22],
    [0.32, 0.20, 0.14],
];

/// Colours and lights of the surroundings.
#[derive(Debug, Clone, PartialEq)]
pub struct Appearance {
    /// Both colours of the table's pattern.
    pub table: [Rgb; 2],
    /// Pattern of the table: `flat`, `checker` or `gradient`.
    pub table_pattern: &'static str,
    /// Repeats of the pattern across the table.
    pub table_repeat: f64,
    /// Upper and lower colour of the background.
    pub background: [Rgb; 2],
    /// Colour of the floor.
    pub floor: Rgb,
    /// Brightness of the ambient light, 0 to 1.
    pub ambient: f64,
    /// Lamps: position, m, and brightness, 0 to 1.
    pub lamps: Vec<(DVec3, f64)>,
}

impl Appearance {
    /// Draws an appearance.
    pub fn sample(rng: &mut impl Rng) -> Self {
        let base = colour(rng, 0.05..0.55, 0.25..0.95);
        let other = base.map(|c| (c * rng.random_range(0.7..1.15)).clamp(0.0, 1.0));
        let table_pattern = ["flat", "checker", "gradient"][rng.random_range(0..3)];
        let lamp = |rng: &mut dyn rand::RngCore, power: f64| {
            let position =
                DVec3::new(rng.random_range(-1.2..1.2), rng.random_range(-1.0..1.0), rng.random_range(0.9..1.8));
            (position, power * rng.random_range(0.7..1.2))
        };
        Self {
            table: [base, other],
            table_pattern,
            table_repeat: rng.random_range(2.0_f64..14.0).round(),
            background: [colour(rng, 0.0..0.4, 0.3..0.9), colour(rng, 0.0..0.4, 0.2..0.8)],
            floor: colour(rng, 0.0..0.5, 0.15..0.8),
            ambient: rng.random_range(0.2..0.4),
            lamps: vec![lamp(rng, 0.5), lamp(rng, 0.25)],
        }
    }
}

/// Draws a skin tone.
pub fn skin(rng: &mut impl Rng) -> Rgb {
    let place = rng.random_range(0.0..(SKIN.len() - 1) as f64);
    let (low, part) = (place as usize, place.fract());
    let warmth = rng.random_range(-0.02..0.02);
    let mix = |c: usize| SKIN[low][c] + (SKIN[low + 1][c] - SKIN[low][c]) * part;
    [mix(0) + warmth, mix(1), mix(2) - warmth].map(|c| c.clamp(0.0, 1.0))
}

/// Draws a pattern for a surface of the given colour, and the pattern's second colour.
pub fn texture(rng: &mut impl Rng, base: Rgb) -> (&'static str, Rgb) {
    let pattern = ["checker", "gradient", "flat"][rng.random_range(0..3)];
    (pattern, base.map(|c| (c * rng.random_range(0.4..1.3)).clamp(0.0, 1.0)))
}

/// Draws a colour of any hue with saturation and value in the given ranges.
pub fn colour(rng: &mut impl Rng, saturation: std::ops::Range<f64>, value: std::ops::Range<f64>) -> Rgb {
    let hue = rng.random_range(0.0..6.0);
    let (s, v) = (rng.random_range(saturation), rng.random_range(value));
    // https://en.wikipedia.org/wiki/HSL_and_HSV, HSV to RGB, alternative form
    let channel = |n: f64| {
        let k = (n + hue) % 6.0;
        v - v * s * k.min(4.0 - k).clamp(0.0, 1.0)
    };
    [channel(5.0), channel(3.0), channel(1.0)]
}
