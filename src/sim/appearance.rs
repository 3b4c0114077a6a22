//! Random appearance: colours, patterns and lights, so that a network learns shapes rather than colours.

use glam::DVec3;
use rand::Rng;

use super::range::UniformRange;
use super::scene::{HandLook, LookSpec};

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

/// Side of a square of the glove's pattern, m: about the pitch of tactile sensor pads.
const GLOVE_PITCH: f64 = 0.007;
/// Thickness of a glove's fabric, m.
const GLOVE_THICKNESS: f64 = 0.0015;
/// Brightness of a recoloured glove's sensor pads relative to the fabric between them: the pattern survives a change of colour.
const RECOLOURED_PADS: f64 = 0.86;

/// Glove that covers a hand in the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Glove {
    /// Colour of the fabric.
    pub fabric: Rgb,
    /// Colour of the sensor pads.
    pub pads: Rgb,
    /// Side of a square of the pattern, m.
    pub pitch: f64,
    /// Thickness, m.
    pub thickness: f64,
}

impl Glove {
    /// Draws the glove of a look; `None` for bare hands. `skin` is the colour of the person's skin.
    pub fn sample(look: HandLook, skin: Rgb, rng: &mut impl Rng) -> Option<Self> {
        let (fabric, pads) = match look {
            HandLook::Bare => return None,
            HandLook::Glove => (colour(rng, 0.0..0.35, 0.06..0.25), colour(rng, 0.0..0.5, 0.35..0.6)),
            HandLook::Recoloured => (skin, skin.map(|c| RECOLOURED_PADS * c)),
        };
        Some(Self { fabric, pads, pitch: GLOVE_PITCH, thickness: GLOVE_THICKNESS })
    }
}

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
    /// Draws an appearance. The default look draws the same numbers whatever other looks may draw.
    pub fn sample(look: &LookSpec, rng: &mut impl Rng) -> Self {
        let base = colour(rng, span(look.table_saturation), 0.25..0.95);
        let other = base.map(|c| (c * rng.random_range(0.7..1.15)).clamp(0.0, 1.0));
        let table_pattern = look.table_patterns[rng.random_range(0..look.table_patterns.len())].name();
        let lamp = |rng: &mut dyn rand::RngCore, power: f64| {
            let position = DVec3::new(
                rng.random_range(-1.2..1.2),
                rng.random_range(-1.0..1.0),
                rng.random_range(span(look.lamp_height)),
            );
            (position, power * rng.random_range(0.7..1.2))
        };
        let surroundings = |usual: std::ops::Range<f64>| look.surroundings_saturation.map_or(usual, span);
        let mut drawn = Self {
            table: [base, other],
            table_pattern,
            table_repeat: rng.random_range(2.0_f64..14.0).round(),
            background: [colour(rng, surroundings(0.0..0.4), 0.3..0.9), colour(rng, surroundings(0.0..0.4), 0.2..0.8)],
            floor: colour(rng, surroundings(0.0..0.5), 0.15..0.8),
            ambient: rng.random_range(span(look.ambient)),
            lamps: vec![lamp(rng, 0.5), lamp(rng, 0.25)],
        };
        let factor = look.lamps.sample(rng);
        drawn.lamps.iter_mut().for_each(|(_, power)| *power *= factor);
        drawn
    }
}

/// Returns a range that numbers can be drawn from; a fixed value gets a width of a billionth.
fn span(range: UniformRange) -> std::ops::Range<f64> {
    range.low()..range.high().max(range.low() + 1e-9)
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
