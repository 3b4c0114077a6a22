//! Statistics of a network's features over its training frames, for [`Familiarity`].

use std::ops::Range;

use candle_core::Device;

use super::data::Dataset;
use super::predict::input;
use crate::error::Result;
use crate::model::familiarity::{self, MIN_FRAMES};
use crate::model::{EgoTac, Familiarity};

/// Number of frames of each of the two sets, at most: ten frames for each number of the covariance of the small presets, some
/// ten seconds of work.
const MAX_FRAMES: usize = 4096;
/// Number of frames read and encoded at once.
const BLOCK: usize = 32;
/// One of this number of episodes is held out where no held-out stores are given.
const HELD_OUT: usize = 5;

/// Parts of a dataset's episodes: store and frames of each.
pub(super) type Parts = Vec<(usize, Range<usize>)>;

/// Measures the features of training frames and their distances on held-out frames, evenly spread over both. Without
/// held-out stores, every fifth training episode is held out, or the last fifth of a single one.
///
/// # Errors
/// If a store can't be read, there are too few frames, or the network gives a number that is not finite.
pub fn measure(
    model: &EgoTac,
    training: &Dataset,
    held_out: Option<&Dataset>,
    device: &Device,
    progress: &mut dyn FnMut(usize),
) -> Result<Familiarity> {
    let mut features = |dataset, parts: &Parts| features(model, dataset, parts, device, progress);
    let (training, held_out) = match held_out {
        Some(held_out) => (features(training, &training.episodes())?, features(held_out, &held_out.episodes())?),
        None => {
            let (kept, out) = split(training.episodes());
            (features(training, &kept)?, features(training, &out)?)
        }
    };
    Familiarity::fit(model.config().vision_width, &training, &held_out)
}

/// As [`measure`]; None if there are too few frames to say anything, as in trials of a few images.
///
/// # Errors
/// As [`measure`].
pub fn measure_if_enough(
    model: &EgoTac,
    training: &Dataset,
    held_out: Option<&Dataset>,
    device: &Device,
) -> Result<Option<Familiarity>> {
    let enough = match held_out {
        Some(held_out) => training.n_frames().min(held_out.n_frames()) >= MIN_FRAMES,
        None => training.n_frames() >= HELD_OUT * (MIN_FRAMES + 1),
    };
    match enough {
        true => measure(model, training, held_out, device, &mut |_| ()).map(Some),
        false => Ok(None),
    }
}

/// Splits episodes into those to fit and those held out.
pub(super) fn split(episodes: Parts) -> (Parts, Parts) {
    if let [(store, only)] = episodes.as_slice() {
        let border = only.end - only.len() / HELD_OUT;
        return (vec![(*store, only.start..border)], vec![(*store, border..only.end)]);
    }
    let (mut kept, mut out) = (Vec::new(), Vec::new());
    for (index, episode) in episodes.into_iter().enumerate() {
        // The second of two episodes is held out, the fifth and the tenth of ten.
        let held_out = index % HELD_OUT == 1;
        if held_out { &mut out } else { &mut kept }.push(episode);
    }
    (kept, out)
}

/// Computes the features of at most [`MAX_FRAMES`] frames, (N, dv).
fn features(
    model: &EgoTac,
    dataset: &Dataset,
    parts: &Parts,
    device: &Device,
    progress: &mut dyn FnMut(usize),
) -> Result<Vec<f32>> {
    let frames: usize = parts.iter().map(|(_, frames)| frames.len()).sum();
    let stride = frames.div_ceil(MAX_FRAMES).max(1);
    let (tokens, width) = (model.config().tokens(), model.config().vision_width);
    let pixels = 3 * model.config().image.pow(2);
    let mut features = Vec::new();
    let mut before = 0;
    for (store, part) in parts {
        for start in part.clone().step_by(BLOCK) {
            let block = start..(start + BLOCK).min(part.end);
            let wanted: Vec<usize> = (0..block.len()).filter(|at| (before + at).is_multiple_of(stride)).collect();
            before += block.len();
            if wanted.is_empty() {
                continue;
            }
            let images = dataset.read(*store, block, false)?.images;
            let chosen: Vec<u8> =
                wanted.iter().flat_map(|at| &images[at * pixels..(at + 1) * pixels]).copied().collect();
            let encoded = model.frame_tokens(&input(&chosen, dataset.preparation(), device)?)?.encoded;
            features.extend(familiarity::features(&encoded, tokens, width));
            progress(wanted.len());
        }
    }
    Ok(features)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn training_and_held_out_episodes_are_disjoint_and_whole() {
        for n in [1usize, 2, 3, 10, 23] {
            let episodes: Parts = (0..n).map(|i| (i % 2, 100 * i..100 * i + 50)).collect();
            let (kept, out) = split(episodes.clone());
            assert!(!kept.is_empty() && !out.is_empty(), "{n}");
            let frames = |parts: &Parts| parts.iter().flat_map(|(_, part)| part.clone()).collect::<Vec<_>>();
            let mut all = [frames(&kept), frames(&out)].concat();
            all.sort_unstable();
            assert_eq!(all, frames(&episodes), "{n}");
            assert!(n == 1 || out.iter().all(|part| episodes.contains(part)), "{n}");
        }
    }
}
