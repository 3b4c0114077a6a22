//! Pictures cut out around one hand: data of the per-frame baseline, as estimators with a hand detector see it.
//!
//! Every hand in view becomes an episode of a right hand; pictures of left hands are mirrored. The detector is perfect: a
//! square around the hand's projected keypoints. Labels are those of the one hand, in the place of the right hand.

use std::ops::Range;
use std::path::Path;

use egotac::dataset::zarr::{
    ArraySpec, Contact, Dtype, MANO_PROXIMITY, TIMESTAMPS, Values, ZarrReader, ZarrWriter, read_labels,
};
use egotac::dataset::{Attributes, EpisodeReader, EpisodeWriter, Frame};
use egotac::error::{Error, Result};
use egotac::hand::{N_KEYPOINTS, Side};
use egotac::image::Preparation;
use egotac::tactile::{N_FIELD, TactileField, TactileSequence, Validity, episode_ranges};
use egotac::train::keypoints::{self, Points};
use image::{Rgb, RgbImage};

/// Side of the square relative to the extent of the keypoints: room for the flesh around them and for the touched object.
const MARGIN: f32 = 1.6;
/// Least side of the square, as a share of the picture's side.
const MIN_SIDE: f32 = 0.1;

/// One hand in one episode.
#[derive(Debug, Clone, PartialEq)]
struct Part {
    /// Frames of the episode within the store.
    frames: Range<usize>,
    side: Side,
    /// Centre (x, y) and half side of each frame's square, as shares of the picture's side.
    squares: Vec<[f32; 3]>,
}

/// Writes the hands of the store `from` as the store `out`, with pictures of `side` x `side` pixels.
///
/// # Errors
/// If a store can't be read or written, or no hand is in view.
pub fn write(from: &Path, out: &Path, side: u32) -> Result<()> {
    let reader = ZarrReader::open(from)?;
    let parts = parts(&reader)?;
    if parts.is_empty() {
        return Err(Error::file(from, "expected a hand in view for the per-frame baseline, got none"));
    }
    let attributes = Attributes { producer: "egotac experiment".into(), ..reader.attributes().clone() };
    let by_distance = reader.has(MANO_PROXIMITY);
    let extra = by_distance.then(|| ArraySpec::new(MANO_PROXIMITY, [N_FIELD], Dtype::U8));
    let mut writer = ZarrWriter::create(out, attributes, Contact::Truth, extra.into_iter().collect())?;
    for part in &parts {
        let labels = read_labels(&reader, part.frames.clone())?;
        let stamps = reader.read(TIMESTAMPS, part.frames.clone())?.into_f64();
        let near = if by_distance { reader.read_u8(MANO_PROXIMITY, part.frames.clone())? } else { Vec::new() };
        for (at, image) in reader.images(part.frames.clone())?.iter().enumerate() {
            let frame = Frame {
                timestamp: stamps[at],
                camera_ego_rgb: cut_out(image, part.squares[at], side, part.side == Side::Left),
                field: TactileField {
                    topology: reader.attributes().topology,
                    force: one_hand(&labels.force, at, part.side, 0.0),
                    contact: one_hand(&labels.contact, at, part.side, 0.0),
                },
                force_valid: one_hand(&labels.mask_force, at, part.side, 0),
                contact_valid: one_hand(&labels.mask_contact, at, part.side, 0),
                validity: Validity::Valid,
                left_hand_pose: None,
                right_hand_pose: None,
            };
            let near = by_distance.then(|| (MANO_PROXIMITY, Values::U8(one_hand(&near, at, part.side, 0))));
            writer.push_with(frame, near.into_iter().collect())?;
        }
        writer.end_episode()?;
    }
    writer.finish()
}

/// Puts the contacts predicted on the pictures of [`write`] back in place: frames and hands of the store `from`. A hand out of
/// view has no contact; force is unknown.
///
/// # Errors
/// If the store can't be read, or `predicted` has another number of frames.
pub fn put_back(from: &Path, predicted: &TactileSequence) -> Result<TactileSequence> {
    let reader = ZarrReader::open(from)?;
    let n = reader.len();
    let mut whole = TactileSequence {
        topology: Some(reader.attributes().topology),
        timestamps: reader.read(TIMESTAMPS, 0..n)?.into_f64(),
        episode_ends: reader.episode_ends().to_vec(),
        force: vec![f32::NAN; n * N_FIELD],
        contact: vec![0.0; n * N_FIELD],
        ..TactileSequence::default()
    };
    let mut row = 0;
    for part in parts(&reader)? {
        if predicted.n_frames() < row + part.frames.len() {
            return Err(Error::shape(
                "predicted contact",
                format!("(>= {}, {N_FIELD})", row + part.frames.len()),
                [predicted.n_frames(), N_FIELD],
            ));
        }
        for frame in part.frames {
            let hand = &predicted.contact_at(row)[Side::Right.range()];
            whole.contact[frame * N_FIELD..(frame + 1) * N_FIELD][part.side.range()].copy_from_slice(hand);
            row += 1;
        }
    }
    Ok(whole)
}

/// Returns for each frame of a store the square around each hand in view: centre (x, y) and half side, as shares of the
/// picture's side.
///
/// # Errors
/// If an array can't be read.
pub fn hand_squares(reader: &ZarrReader) -> Result<Vec<Vec<[f32; 3]>>> {
    let mut frames = vec![Vec::new(); reader.len()];
    for part in parts(reader)? {
        for (frame, square) in part.frames.zip(part.squares) {
            frames[frame].push(square);
        }
    }
    Ok(frames)
}

/// Returns the hands in view, episode by episode, left before right.
fn parts(reader: &ZarrReader) -> Result<Vec<Part>> {
    let side = reader.image_size().1;
    let whole =
        Preparation { side, resize: Default::default(), filter: Default::default(), mean: [0.0; 3], std: [1.0; 3] };
    let points = keypoints::read(reader, 0..reader.len(), &whole)?;
    let mut parts = Vec::new();
    for frames in episode_ranges(reader.episode_ends()) {
        for side in Side::BOTH {
            if let Some(squares) = squares(&points[frames.clone()], side) {
                parts.push(Part { frames: frames.clone(), side, squares });
            }
        }
    }
    Ok(parts)
}

/// Returns the squares around a hand; a frame without it in view has the square of the frame before or, at the start, of
/// the first frame that has one. `None` if it is never in view.
fn squares(points: &[Points], side: Side) -> Option<Vec<[f32; 3]>> {
    let first = side as usize * N_KEYPOINTS;
    let of = |points: &Points| -> Option<[f32; 3]> {
        let seen = points[first..first + N_KEYPOINTS].iter().filter(|place| place[0].is_finite());
        let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        seen.for_each(|place| {
            (0..2).for_each(|axis| {
                low[axis] = low[axis].min(place[axis]);
                high[axis] = high[axis].max(place[axis]);
            });
        });
        let extent = (high[0] - low[0]).max(high[1] - low[1]);
        let outside = (0..2).any(|axis| low[axis] > 1.0 || high[axis] < 0.0);
        let half = 0.5 * (MARGIN * extent).clamp(MIN_SIDE, 1.0);
        (extent.is_finite() && !outside).then(|| [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), half])
    };
    let seen: Vec<Option<[f32; 3]>> = points.iter().map(of).collect();
    let mut last = *seen.iter().flatten().next()?;
    Some(
        seen.into_iter()
            .map(|square| {
                last = square.unwrap_or(last);
                last
            })
            .collect(),
    )
}

/// Moves one hand's values of a row to the right hand's place; the left hand's place gets `empty`.
fn one_hand<T: Copy>(values: &[T], row: usize, side: Side, empty: T) -> Vec<T> {
    let mut moved = vec![empty; N_FIELD];
    moved[Side::Right.range()].copy_from_slice(&values[row * N_FIELD..(row + 1) * N_FIELD][side.range()]);
    moved
}

/// Cuts a square out of a picture, bilinear, black beyond its edges.
fn cut_out(image: &RgbImage, [x, y, half]: [f32; 3], side: u32, mirrored: bool) -> RgbImage {
    let size = image.width() as f32;
    let pixel = |x: i64, y: i64| -> [f32; 3] {
        let inside = (0..i64::from(image.width())).contains(&x) && (0..i64::from(image.height())).contains(&y);
        if inside { image.get_pixel(x as u32, y as u32).0.map(f32::from) } else { [0.0; 3] }
    };
    RgbImage::from_fn(side, side, |column, row| {
        let column = if mirrored { side - 1 - column } else { column };
        let place = |centre: f32, at: u32| size * (centre + half * (2.0 * (at as f32 + 0.5) / side as f32 - 1.0)) - 0.5;
        let (px, py) = (place(x, column), place(y, row));
        let (left, top) = (px.floor(), py.floor());
        let (right, down) = (px - left, py - top);
        let (left, top) = (left as i64, top as i64);
        let corners = [pixel(left, top), pixel(left + 1, top), pixel(left, top + 1), pixel(left + 1, top + 1)];
        let weights = [(1.0 - right) * (1.0 - down), right * (1.0 - down), (1.0 - right) * down, right * down];
        Rgb(std::array::from_fn(|channel| {
            let sum: f32 = corners.iter().zip(weights).map(|(corner, weight)| weight * corner[channel]).sum();
            sum.round() as u8
        }))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_square_of_a_whole_picture_is_the_picture() {
        let image = RgbImage::from_fn(8, 8, |x, y| Rgb([30 * x as u8, 30 * y as u8, 7]));
        assert_eq!(cut_out(&image, [0.5, 0.5, 0.5], 8, false), image);
        let mirrored = cut_out(&image, [0.5, 0.5, 0.5], 8, true);
        assert!((0..8).all(|x| mirrored.get_pixel(x, 3) == image.get_pixel(7 - x, 3)));
        // A quarter of the picture, at the upper left, and black beyond its edge.
        let corner = cut_out(&image, [0.25, 0.25, 0.25], 4, false);
        assert!((0..4).all(|x| corner.get_pixel(x, 2) == image.get_pixel(x, 2)));
        assert_eq!(cut_out(&image, [-0.5, 0.5, 0.25], 4, false).get_pixel(0, 0), &Rgb([0, 0, 0]));
    }

    #[test]
    fn squares_surround_the_hand_and_outlast_its_absence() {
        let mut frames = vec![[[f32::NAN; 2]; keypoints::N_POINTS]; 4];
        frames[1][N_KEYPOINTS] = [0.4, 0.2];
        frames[1][N_KEYPOINTS + 5] = [0.6, 0.3];
        frames[3][N_KEYPOINTS] = [0.5, 0.5];
        let found = squares(&frames, Side::Right).unwrap();
        assert_eq!((found[0], found[2]), (found[1], found[1]));
        let [x, y, half] = found[1];
        assert!((x - 0.5).abs() < 1e-6 && (y - 0.25).abs() < 1e-6 && (half - 0.16).abs() < 1e-6, "{:?}", found[1]);
        assert_eq!(found[3], [0.5, 0.5, 0.05]);
        assert_eq!(squares(&frames, Side::Left), None);
    }
}
