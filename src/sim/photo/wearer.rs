//! The person who wears the camera: clothes, and what is worn at the wrists.

use rand::Rng;

use crate::sim::appearance::{Rgb, colour};

/// Drawn wearer.
#[derive(Debug, Clone, PartialEq)]
pub struct Wearer {
    /// Colour of shirt and sleeves.
    pub shirt: Rgb,
    /// Colour of the trousers.
    pub trousers: Rgb,
    /// Half width of the trunk, m.
    pub half_width: f64,
    /// Distance of the trunk's front behind the eye, m.
    pub behind: f64,
    /// Length of the sleeves from the elbow to the wrist, as a share of the forearm.
    pub sleeve: f64,
    /// Trackers on the wrists, if any.
    pub tracker: Option<Tracker>,
}

/// Device on each wrist, with wires to the hand.
#[derive(Debug, Clone, PartialEq)]
pub struct Tracker {
    /// True for a box on the back of the wrist, false for a band with a disc, as a watch has.
    pub is_box: bool,
    /// Half size, m.
    pub half_size: f64,
    /// Colour.
    pub colour: Rgb,
    /// Turn around the forearm from its back, rad.
    pub turn: f64,
    /// Colours of the wires.
    pub wires: Vec<Rgb>,
}

impl Wearer {
    /// Draws a wearer.
    pub(super) fn sample(rng: &mut impl Rng) -> Self {
        Self {
            shirt: colour(rng, 0.0..0.7, 0.1..0.95),
            trousers: colour(rng, 0.0..0.5, 0.05..0.6),
            half_width: rng.random_range(0.13..0.2),
            behind: rng.random_range(-0.02..0.12),
            sleeve: rng.random_range(0.2..1.0),
            tracker: (rng.random::<f64>() < 0.5).then(|| Tracker {
                is_box: rng.random::<bool>(),
                half_size: rng.random_range(0.012..0.028),
                colour: colour(rng, 0.0..0.3, 0.02..0.9),
                turn: rng.random_range(-1.6..1.6),
                wires: (0..rng.random_range(0..4)).map(|_| colour(rng, 0.0..1.0, 0.05..0.8)).collect(),
            }),
        }
    }
}
