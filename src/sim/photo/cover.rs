//! Painted surface of a hand: skin with pores and warm fingertips, or gloves of several kinds.

use image::RgbImage;
use rand::Rng;

use super::material::{mix, pixel};
use super::noise::Noise;
use crate::hand::Region;
use crate::sim::appearance::{Rgb, colour};
use crate::sim::rig::HandRig;

/// Side of a hand's texture, pixels.
const SIDE: u32 = 256;
/// Side of the map of nearest vertices, pixels.
const MAP_SIDE: u32 = 64;
/// Share of people who wear gloves.
const GLOVED: f64 = 0.5;
/// Thickness of a glove, m: latex, knitted, work glove.
const THICKNESS: std::ops::Range<f64> = 0.0002..0.002;

/// Cover of both hands of a person.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cover {
    /// Bare skin.
    Skin,
    /// Glove.
    Glove {
        /// Colour of the fabric.
        fabric: Rgb,
        /// Colour of the last links of the fingers; `None` = bare skin: a glove without fingertips.
        tips: Option<Rgb>,
        /// Colour of sensor pads, in a grid, if it has some.
        pads: Option<Rgb>,
        /// Number of threads along the hand's length; few = knitted.
        threads: f64,
        /// Thickness, m.
        thickness: f64,
    },
}

impl Cover {
    /// Draws a cover.
    pub(super) fn sample(rng: &mut impl Rng) -> Self {
        if rng.random::<f64>() >= GLOVED {
            return Self::Skin;
        }
        // Most work and sensor gloves are black, grey or white.
        let fabric = match rng.random_range(0..4) {
            0 | 1 => colour(rng, 0.0..0.2, 0.03..0.2),
            2 => colour(rng, 0.0..0.2, 0.3..0.95),
            _ => colour(rng, 0.3..0.9, 0.2..0.9),
        };
        let tips = match rng.random_range(0..4) {
            0 => None,
            1 => Some(colour(rng, 0.0..0.3, 0.4..0.9)),
            _ => Some(fabric),
        };
        let pads = (rng.random::<f64>() < 0.3).then(|| colour(rng, 0.0..0.5, 0.2..0.8));
        Self::Glove {
            fabric,
            tips,
            pads,
            threads: rng.random_range(20.0..90.0),
            thickness: rng.random_range(THICKNESS),
        }
    }

    /// Returns the thickness over the skin, m.
    pub(crate) fn thickness(&self) -> f64 {
        match self {
            Self::Skin => 0.0,
            Self::Glove { thickness, .. } => *thickness,
        }
    }

    /// Returns true if the fingertips are bare.
    pub(crate) fn shows_nails(&self) -> bool {
        matches!(self, Self::Skin | Self::Glove { tips: None, .. })
    }

    /// Paints the flat hand as seen from above; [`Flat`] maps vertices to places. `skin` is the tone of the person.
    pub(crate) fn paint(&self, rig: &HandRig, skin: Rgb, seed: u64) -> RgbImage {
        let flat = Flat::of(rig);
        let regions = rig.model.regions();
        let nearest = nearest_vertices(rig, &flat);
        let pores = Noise::new(seed, 2);
        let cloud = Noise::new(seed ^ 1, 4);
        RgbImage::from_fn(SIDE, SIDE, |x, y| {
            let [u, v] = [x, y].map(|k| (f64::from(k) + 0.5) / f64::from(SIDE));
            let cell = |t: f64| ((t * f64::from(MAP_SIDE)) as u32).min(MAP_SIDE - 1) as usize;
            let region = regions[nearest[cell(v) * MAP_SIDE as usize + cell(u)]];
            let is_tip = is_tip(region);
            let bare = || {
                let (pore, blotch) = (pores.at(u, v, [90, 90]) - 0.5, cloud.at(u, v, [6, 6]) - 0.5);
                // Fingertips and knuckles are redder.
                let warm = if is_tip { 0.06 } else { 0.0 } + 0.08 * blotch;
                let tone = 1.0 + 0.12 * pore + 0.12 * blotch;
                [skin[0] * tone + warm * 0.5, skin[1] * tone - warm * 0.5, skin[2] * tone - warm * 0.4]
            };
            pixel(match self {
                Self::Skin => bare(),
                Self::Glove { tips: None, .. } if is_tip => bare(),
                Self::Glove { fabric, tips, pads, threads, .. } => {
                    let thread =
                        (std::f64::consts::TAU * threads * v).sin() * (std::f64::consts::TAU * threads * u).sin();
                    let cloth = if is_tip { tips.unwrap_or(*fabric) } else { *fabric };
                    let cell = |t: f64| (t * 24.0).fract() < 0.6;
                    let cloth = if cell(u) && cell(v) { pads.unwrap_or(cloth) } else { cloth };
                    let tone = 1.0 + 0.15 * thread + 0.4 * (cloud.at(u, v, [8, 8]) - 0.5);
                    mix([0.0; 3], cloth, tone)
                }
            })
        })
    }
}

fn is_tip(region: Region) -> bool {
    use Region::{IndexTip, LittleTip, MiddleTip, RingTip, ThumbTip};
    matches!(region, ThumbTip | IndexTip | MiddleTip | RingTip | LittleTip)
}

/// Map from the vertices of the flat hand to places in its texture: seen along the palm's normal, the larger extent
/// fills the texture.
pub(crate) struct Flat {
    low: [f64; 2],
    scale: f64,
    axes: [glam::DVec3; 2],
}

impl Flat {
    /// Measures a hand.
    pub(crate) fn of(rig: &HandRig) -> Self {
        let axes = [rig.frame.thumb, rig.frame.fingers];
        let along = |k: usize| rig.vertices.iter().map(move |v| v.as_dvec3().dot(axes[k]));
        let low = [0, 1].map(|k| along(k).fold(f64::INFINITY, f64::min));
        let extent = [0, 1].map(|k| along(k).fold(f64::NEG_INFINITY, f64::max) - low[k]);
        Self { low, scale: 1.0 / extent[0].max(extent[1]), axes }
    }

    /// Returns the place of a point, each coordinate 0 to 1.
    pub(crate) fn place(&self, vertex: glam::Vec3) -> [f64; 2] {
        std::array::from_fn(|k| (vertex.as_dvec3().dot(self.axes[k]) - self.low[k]) * self.scale)
    }
}

/// Returns the nearest vertex to each cell of a square map.
fn nearest_vertices(rig: &HandRig, flat: &Flat) -> Vec<usize> {
    let places: Vec<[f64; 2]> = rig.vertices.iter().map(|vertex| flat.place(*vertex)).collect();
    let cells = (0..MAP_SIDE).flat_map(|y| (0..MAP_SIDE).map(move |x| [x, y]));
    cells
        .map(|cell| {
            let at = cell.map(|k| (f64::from(k) + 0.5) / f64::from(MAP_SIDE));
            let distance = |place: &[f64; 2]| (place[0] - at[0]).powi(2) + (place[1] - at[1]).powi(2);
            let by_distance = |a: &usize, b: &usize| distance(&places[*a]).total_cmp(&distance(&places[*b]));
            (0..places.len()).min_by(by_distance).unwrap_or_default()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::{HandModel, N_BETAS, Side};

    #[test]
    fn a_glove_without_fingertips_shows_skin_at_the_tips_and_fabric_on_the_palm() {
        let rig = HandRig::new(HandModel::builtin(Side::Right), [0.0; N_BETAS]).unwrap();
        let (skin, fabric) = ([0.9, 0.7, 0.6], [0.1, 0.1, 0.3]);
        let cover = Cover::Glove { fabric, tips: None, pads: None, threads: 40.0, thickness: 0.001 };
        let (picture, flat) = (cover.paint(&rig, skin, 1), Flat::of(&rig));
        for (vertex, region) in rig.vertices.iter().zip(rig.model.regions()) {
            let [u, v] = flat.place(*vertex).map(|t| ((t * f64::from(SIDE)) as u32).min(SIDE - 1));
            let red = picture.get_pixel(u, v).0[0];
            match region {
                Region::Palm => assert!(red < 80, "fabric expected at {u} {v}, red is {red}"),
                Region::MiddleTip => assert!(red > 150, "skin expected at {u} {v}, red is {red}"),
                _ => {}
            }
        }
    }
}
