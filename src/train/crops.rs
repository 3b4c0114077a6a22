//! Stores of single hands: squares cut out around the hands of a store, for networks that see one hand at a time.
//!
//! Every hand in view becomes an episode of a right hand; pictures of left hands are mirrored. Squares are around the projected
//! keypoints of the recorded poses, as a perfect tracker would find them. Labels are those of the one hand, in the place of the right
//! hand; the left hand's place is unknown.

use std::ops::Range;
use std::path::Path;

use ::image::RgbImage;
use serde_json::json;

use super::keypoints::{self, Points};
use crate::dataset::zarr::{
    ArraySpec, Contact, Dtype, FRAME_VALIDITY, MANO_PROXIMITY, TIMESTAMPS, Values, ZarrReader, ZarrWriter, read_labels,
};
use crate::dataset::{Attributes, EpisodeReader, EpisodeWriter, Frame};
use crate::error::{Error, Result};
use crate::hand::{N_KEYPOINTS, Side};
use crate::image::{Framing, Preparation, Resize, Square};
use crate::tactile::{ForceKind, N_FIELD, TactileField, TactileSequence, Validity, episode_ranges};

/// Frames whose pictures are read at once.
const BLOCK: usize = 64;

/// One hand in one episode.
#[derive(Debug, Clone, PartialEq)]
struct CropPart {
    /// Frames of the episode within the store.
    frames: Range<usize>,
    side: Side,
    /// Square of each frame.
    squares: Vec<Square>,
}

/// Writes the hands of the store `from` as the store `out`, with pictures of `side` x `side` pixels; `producer` names the program.
/// Returns the number of pictures.
///
/// # Errors
/// If a store can't be read or written, `from` holds single hands itself, has no poses of camera and hands, or no hand is in view.
pub fn write(from: &Path, out: &Path, side: u32, producer: &str) -> Result<usize> {
    let reader = ZarrReader::open(from)?;
    if !reader.framing()?.is_whole() {
        return Err(Error::file(from, "expected whole pictures, got pictures of single hands"));
    }
    if !keypoints::has_poses(&reader) {
        return Err(Error::file(from, "expected poses of camera and hands, as `egotac sim` writes them, got none"));
    }
    let parts = parts(&reader)?;
    if parts.is_empty() {
        return Err(Error::file(from, "expected a hand in view, got none"));
    }
    let attributes = Attributes { producer: producer.into(), ..reader.attributes().clone() };
    let extra = reader.has(MANO_PROXIMITY).then(|| ArraySpec::new(MANO_PROXIMITY, [N_FIELD], Dtype::U8));
    let mut writer = ZarrWriter::create(out, attributes, Contact::Truth, extra.into_iter().collect())?;
    writer.set_attribute(Framing::KEY, json!(Framing::Hands.name()));
    if let Some(kind) = reader.raw_attributes().get(ForceKind::ATTRIBUTE) {
        writer.set_attribute(ForceKind::ATTRIBUTE, kind.clone());
    }
    for part in &parts {
        let mut squares = part.squares.iter();
        for first in part.frames.clone().step_by(BLOCK) {
            let block = first..(first + BLOCK).min(part.frames.end);
            for (frame, near) in hands(&reader, block, part.side, &mut squares, side)? {
                writer.push_with(frame, near.map(|near| (MANO_PROXIMITY, near)).into_iter().collect())?;
            }
        }
        writer.end_episode()?;
    }
    let written = writer.n_frames();
    writer.finish()?;
    Ok(written)
}

/// Cuts one hand out of consecutive frames; returns each frame with its contact by distance, if the store has it.
fn hands<'a>(
    reader: &ZarrReader,
    frames: Range<usize>,
    hand: Side,
    squares: &mut impl Iterator<Item = &'a Square>,
    side: u32,
) -> Result<Vec<(Frame, Option<Values>)>> {
    let labels = read_labels(reader, frames.clone())?;
    let stamps = reader.read(TIMESTAMPS, frames.clone())?.into_f64();
    let near = reader.has(MANO_PROXIMITY).then(|| reader.read_u8(MANO_PROXIMITY, frames.clone())).transpose()?;
    let images = reader.images(frames)?;
    let cut = |(at, (image, square)): (usize, (&RgbImage, &Square))| {
        let frame = Frame {
            timestamp: stamps[at],
            camera_ego_rgb: square.cut(image, side, hand == Side::Left)?,
            field: TactileField {
                topology: reader.attributes().topology,
                force: one_hand(&labels.force, at, hand, 0.0),
                contact: one_hand(&labels.contact, at, hand, 0.0),
            },
            force_valid: one_hand(&labels.mask_force, at, hand, 0),
            contact_valid: one_hand(&labels.mask_contact, at, hand, 0),
            validity: Validity::from_code(FRAME_VALIDITY, labels.validity[at])?,
            left_hand_pose: None,
            right_hand_pose: None,
        };
        Ok((frame, near.as_ref().map(|near| Values::U8(one_hand(near, at, hand, 0)))))
    };
    images.iter().zip(squares).enumerate().map(cut).collect()
}

/// Puts the touch predicted on the pictures of [`write`] back in place: frames and hands of the store `from`. A hand out of
/// view has none; force stays unknown if no force was predicted.
///
/// # Errors
/// If the store can't be read, or `predicted` has another number of frames.
pub fn put_back(from: &Path, predicted: &TactileSequence) -> Result<TactileSequence> {
    let reader = ZarrReader::open(from)?;
    let n = reader.len();
    let no_force = if predicted.force.iter().all(|force| force.is_nan()) { f32::NAN } else { 0.0 };
    let mut whole = TactileSequence {
        topology: Some(reader.attributes().topology),
        timestamps: reader.read(TIMESTAMPS, 0..n)?.into_f64(),
        episode_ends: reader.episode_ends().to_vec(),
        force: vec![no_force; n * N_FIELD],
        contact: vec![0.0; n * N_FIELD],
        ..TactileSequence::default()
    };
    let mut row = 0;
    for part in parts(&reader)? {
        if predicted.n_frames() < row + part.frames.len() {
            let expected = format!("(>= {}, {N_FIELD})", row + part.frames.len());
            return Err(Error::shape("predicted contact", expected, [predicted.n_frames(), N_FIELD]));
        }
        for frame in part.frames {
            let own = frame * N_FIELD..(frame + 1) * N_FIELD;
            let (force, contact) = (predicted.force_at(row), predicted.contact_at(row));
            whole.force[own.clone()][part.side.range()].copy_from_slice(&force[Side::Right.range()]);
            whole.contact[own][part.side.range()].copy_from_slice(&contact[Side::Right.range()]);
            row += 1;
        }
    }
    Ok(whole)
}

/// Returns for each frame of a store the squares around the hands in view.
///
/// # Errors
/// If an array can't be read.
pub fn hand_squares(reader: &ZarrReader) -> Result<Vec<Vec<Square>>> {
    let mut frames = vec![Vec::new(); reader.len()];
    for part in parts(reader)? {
        for (frame, square) in part.frames.zip(part.squares) {
            frames[frame].push(square);
        }
    }
    Ok(frames)
}

/// Returns the hands in view, episode by episode, left before right.
fn parts(reader: &ZarrReader) -> Result<Vec<CropPart>> {
    let (height, width) = reader.image_size();
    // Places are then shares of the picture's own sides.
    let whole =
        Preparation { side: 1, resize: Resize::Squash, filter: Default::default(), mean: [0.0; 3], std: [1.0; 3] };
    let points = keypoints::read(reader, 0..reader.len(), &whole)?;
    let mut parts = Vec::new();
    for frames in episode_ranges(reader.episode_ends()) {
        for side in Side::BOTH {
            if let Some(squares) = squares(&points[frames.clone()], side, width as u32, height as u32) {
                parts.push(CropPart { frames: frames.clone(), side, squares });
            }
        }
    }
    Ok(parts)
}

/// Returns the squares around a hand in pictures of this size; a frame without it in view has the square of the frame before or, at the
/// start, of the first frame that has one. `None` if it is never in view.
fn squares(points: &[Points], side: Side, width: u32, height: u32) -> Option<Vec<Square>> {
    let first = side as usize * N_KEYPOINTS;
    let of = |points: &Points| {
        let pixel = |[x, y]: &[f32; 2]| [f64::from(*x) * f64::from(width), f64::from(*y) * f64::from(height)];
        Square::around_hand(points[first..first + N_KEYPOINTS].iter().map(pixel), width, height)
    };
    let seen: Vec<Option<Square>> = points.iter().map(of).collect();
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squares_surround_the_hand_and_outlast_its_absence() {
        let mut frames = vec![[[f32::NAN; 2]; keypoints::N_POINTS]; 4];
        frames[1][N_KEYPOINTS] = [0.4, 0.2];
        frames[1][N_KEYPOINTS + 5] = [0.6, 0.3];
        frames[3][N_KEYPOINTS] = [0.5, 0.5];
        let found = squares(&frames, Side::Right, 100, 100).unwrap();
        assert_eq!((found[0], found[2]), (found[1], found[1]));
        let Square { centre: [x, y], half } = found[1];
        assert!((x - 50.0).abs() < 1e-4 && (y - 25.0).abs() < 1e-4 && (half - 16.0).abs() < 1e-4, "{:?}", found[1]);
        assert_eq!(found[3], Square { centre: [50.0; 2], half: 5.0 });
        assert_eq!(squares(&frames, Side::Left, 100, 100), None);
    }
}
