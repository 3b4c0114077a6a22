//! Images to learn presence from: frames as they are, frames whose hands are cut off or covered, and pictures without hands.

use ::image::RgbImage;
use half::f16;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::super::augment::Augmentation;
use super::super::config::AugmentConfig;
use super::super::keypoints::{self, Points};
use crate::hand::N_KEYPOINTS;
use crate::image::Preparation;
use crate::image::procedural::Picture;
use crate::model::presence::N_POINTS;

/// Keypoints in view from which a hand counts as present. With fewer, and at least one, it is neither present nor absent.
pub const PRESENT: usize = 3;
/// Probability that a hand in view is covered, whole or in part.
const COVERED: f64 = 0.4;
/// Part of a hand's bounding box that a cover reaches over its edge, on each side: the skin around the outermost keypoints.
const MARGIN: f32 = 0.2;

/// True content of an image.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// Positions of the keypoints, left hand first, as shares of the image's sides; not finite = not in view, NaN = unknown.
    pub places: [[f32; 2]; N_POINTS],
}

impl Truth {
    /// Returns the truth of a picture without hands.
    pub fn no_hands() -> Self {
        Self { places: [[f32::INFINITY; 2]; N_POINTS] }
    }

    /// Takes the keypoints of both hands from the points of a frame.
    pub fn of(points: &Points) -> Self {
        Self { places: std::array::from_fn(|index| points[index]) }
    }

    /// Returns true if the left and the right hand are in view; None if that is unknown, or too little of it is to say.
    pub fn presence(&self) -> [Option<bool>; 2] {
        [0, 1].map(|hand| {
            let places = &self.places[hand * N_KEYPOINTS..(hand + 1) * N_KEYPOINTS];
            if places.iter().any(|place| place[0].is_nan()) {
                return None;
            }
            match places.iter().filter(|place| keypoints::patch(**place, 1).is_some()).count() {
                0 => Some(false),
                seen if seen >= PRESENT => Some(true),
                _ => None,
            }
        })
    }
}

/// Images with their tokens and their truth.
#[derive(Debug, Default)]
pub struct Samples {
    /// (N, P, dv) tokens of all images.
    pub tokens: Vec<f16>,
    /// (N) true content.
    pub truths: Vec<Truth>,
    /// True for a frame as it is, false for a changed one or a picture.
    pub unchanged: Vec<bool>,
}

/// Returns the changes that views of training frames get: crops that cut hands off, other scales and colours.
fn views() -> AugmentConfig {
    AugmentConfig {
        brightness: 0.3,
        contrast: 0.3,
        saturation: 0.3,
        hue: 0.15,
        crop: 0.65,
        view_scale: 0.2,
        view_scale_probability: 0.8,
        mirror: 0.5,
    }
}

/// Returns a changed view of a frame, normalised, (3, side, side), and its truth. `pixels`: (side, side, 3).
pub fn changed(
    pixels: &[u8],
    points: &Points,
    mirrorable: bool,
    preparation: &Preparation,
    seed: u64,
) -> (Vec<f32>, Truth) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut pixels, mut points) = (pixels.to_vec(), *points);
    for hand in 0..2 {
        if rng.random_bool(COVERED) {
            cover(&mut pixels, &mut points, hand, preparation.side, &mut rng);
        }
    }
    let augmentation = Augmentation::draw(&views(), mirrorable, &mut rng);
    let mut out = vec![0.0; pixels.len()];
    augmentation.apply(&pixels, preparation.side, preparation.mean, preparation.std, &mut out);
    (out, Truth::of(&keypoints::augmented(points, &augmentation)))
}

/// Covers a part of a hand's bounding box, in two of three cases the whole, by a rectangle of colour or noise.
fn cover(pixels: &mut [u8], points: &mut Points, hand: usize, side: usize, rng: &mut impl Rng) {
    let own = hand * N_KEYPOINTS..(hand + 1) * N_KEYPOINTS;
    let seen = points[own].iter().filter(|place| keypoints::patch(**place, 1).is_some());
    let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
    for place in seen {
        for axis in 0..2 {
            (low[axis], high[axis]) = (low[axis].min(place[axis]), high[axis].max(place[axis]));
        }
    }
    if low[0] > high[0] {
        return;
    }
    let whole = rng.random_range(0..3) < 2;
    for axis in 0..2 {
        let extent = high[axis] - low[axis];
        let margin = (MARGIN * extent).max(0.03);
        (low[axis], high[axis]) = (low[axis] - margin, high[axis] + margin);
        if !whole {
            let share = rng.random_range(0.3..0.8);
            match rng.random_bool(0.5) {
                true => low[axis] += share * extent,
                false => high[axis] -= share * extent,
            }
        }
    }
    let span = |axis: usize| {
        let pixel = |share: f32| (share * side as f32).clamp(0.0, side as f32) as usize;
        pixel(low[axis])..pixel(high[axis])
    };
    let (colour, noisy): ([u8; 3], bool) = (rng.random(), rng.random_bool(0.3));
    for y in span(1) {
        for x in span(0) {
            let pixel = if noisy { rng.random() } else { colour };
            pixels[3 * (y * side + x)..3 * (y * side + x) + 3].copy_from_slice(&pixel);
        }
    }
    for place in points[..N_POINTS].iter_mut() {
        if (0..2).all(|axis| (low[axis]..=high[axis]).contains(&place[axis])) {
            *place = [f32::INFINITY; 2];
        }
    }
}

/// Draws picture `index` without hands: each kind in turn.
pub fn picture(index: usize, side: usize, seed: u64) -> RgbImage {
    let kind = Picture::ALL[index % Picture::ALL.len()];
    kind.draw(side as u32, side as u32, seed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{IMAGENET_MEAN, IMAGENET_STD};
    use crate::train::keypoints::N_POINTS as ALL_POINTS;

    /// A left hand on a grid in the middle of the image, and no right hand.
    fn points() -> Points {
        let mut points = [[f32::INFINITY; 2]; ALL_POINTS];
        for (k, place) in points[..N_KEYPOINTS].iter_mut().enumerate() {
            *place = [0.4 + 0.04 * (k % 5) as f32, 0.4 + 0.04 * (k / 5) as f32];
        }
        points
    }

    #[test]
    fn a_hand_is_present_from_three_keypoints_in_view_and_absent_without_any() {
        let with = |seen: usize| {
            let mut truth = Truth::of(&points());
            truth.places[seen..N_KEYPOINTS].iter_mut().for_each(|place| *place = [1.2, 0.5]);
            truth.presence()
        };
        assert_eq!([0, 1, 2, 3, 21].map(|seen| with(seen)[0]), [Some(false), None, None, Some(true), Some(true)]);
        assert_eq!(with(21)[1], Some(false));
        let mut unknown = Truth::of(&points());
        unknown.places[4] = [f32::NAN; 2];
        assert_eq!(unknown.presence()[0], None);
        assert_eq!(Truth::no_hands().presence(), [Some(false); 2]);
    }

    #[test]
    fn a_keypoint_is_covered_exactly_where_its_pixel_changed() {
        let side = 100;
        for seed in 0..200 {
            let (mut pixels, mut covered) = (vec![7u8; side * side * 3], points());
            cover(&mut pixels, &mut covered, 0, side, &mut ChaCha8Rng::seed_from_u64(seed));
            for (place, before) in covered.iter().zip(&points()[..N_KEYPOINTS]) {
                let [x, y] = before.map(|share| (share * side as f32) as usize);
                let centre = before.map(|share| (share * side as f32).fract());
                let changed = pixels[3 * (y * side + x)..3 * (y * side + x) + 3] != [7; 3];
                // The edge of the cover may cut the keypoint's pixel.
                let at_edge = centre.iter().any(|fraction| !(0.02..0.98).contains(fraction));
                let edges = [(x.wrapping_sub(1), y), (x + 1, y), (x, y.wrapping_sub(1)), (x, y + 1)];
                let inner = edges.iter().all(|(x, y)| (pixels[3 * (y * side + x)..][..3] != [7; 3]) == changed);
                assert!(!inner || at_edge || place[0].is_infinite() == changed, "seed {seed}: {before:?}");
            }
        }
    }

    #[test]
    fn mirrored_views_swap_the_hands_and_crops_cut_them_off() {
        let preparation = Preparation {
            side: 32,
            resize: Default::default(),
            filter: Default::default(),
            mean: IMAGENET_MEAN,
            std: IMAGENET_STD,
        };
        let of = |mirrorable, seed| changed(&[90; 32 * 32 * 3], &points(), mirrorable, &preparation, seed).1.presence();
        let seen: Vec<_> = (0..300).map(|seed| of(false, seed)).collect();
        let count = |hand: usize, state| seen.iter().filter(|presence| presence[hand] == state).count();
        assert!(
            count(0, Some(true)) > 100 && count(0, Some(false)) > 50,
            "{} {}",
            count(0, Some(true)),
            count(0, Some(false))
        );
        assert_eq!(count(1, Some(false)), 300, "there is no right hand");
        assert!((0..300).any(|seed| of(true, seed) == [Some(false), Some(true)]), "none is mirrored");
    }
}
