//! Predictions of a finished network, as on streams of pictures.

use std::path::Path;

use egotac::dataset::EpisodeReader;
use egotac::dataset::zarr::{TIMESTAMPS, ZarrReader};
use egotac::error::{Error, Result};
use egotac::model::predictor::{self, Prediction};
use egotac::model::{Predictor, Unknown};
use egotac::tactile::{TactileSequence, episode_ranges};
use image::RgbImage;

use super::Setup;
use super::recipe::Recipe;

/// Frames whose pictures are read at once.
const BLOCK: usize = 64;

/// Place of a frame: store, episode and frame within the store, stamp.
#[derive(Debug, Clone, Copy)]
pub struct Place<'a> {
    /// The store.
    pub store: &'a Path,
    /// Number of the episode within the store.
    pub episode: usize,
    /// First frame of the episode.
    pub start: usize,
    /// Number of the frame within the store.
    pub frame: usize,
    /// Stamp, s.
    pub stamp: f64,
}

/// Loads the network of an experiment as a predictor whose streams are whole episodes.
///
/// # Errors
/// If it can't be read, or is one of random weights.
pub fn predictor(setup: &Setup) -> Result<Predictor> {
    let path = setup.network.path.as_deref().ok_or_else(|| Error::value("--checkpoint", "a checkpoint", "none"))?;
    // Experiments compare what networks say, also of pictures unlike those of their training.
    let unknown = Unknown::Guess;
    Predictor::load(path, predictor::Options { max_gap_secs: Some(f64::MAX), unknown, ..Default::default() })
}

/// Predicts touch on every frame of stores, as on a stream of pictures; `change` may alter each one.
///
/// # Errors
/// If a store can't be read, or the network's output is not finite.
pub fn predict(
    predictor: &mut Predictor,
    recipes: &[Recipe],
    change: &mut dyn FnMut(Place, RgbImage) -> Result<RgbImage>,
) -> Result<TactileSequence> {
    predict_watched(predictor, recipes, change, &mut |_| ())
}

/// As [`predict`]; `watch` sees each prediction.
///
/// # Errors
/// As [`predict`].
pub fn predict_watched(
    predictor: &mut Predictor,
    recipes: &[Recipe],
    change: &mut dyn FnMut(Place, RgbImage) -> Result<RgbImage>,
    watch: &mut dyn FnMut(&Prediction),
) -> Result<TactileSequence> {
    let mut all = TactileSequence::default();
    for recipe in recipes {
        let reader = ZarrReader::open(&recipe.path)?;
        let stamps = reader.read(TIMESTAMPS, 0..reader.len())?.into_f64();
        let mut own = TactileSequence::default();
        for (episode, frames) in episode_ranges(reader.episode_ends()).enumerate() {
            predictor.reset();
            for first in frames.clone().step_by(BLOCK) {
                let block = first..(first + BLOCK).min(frames.end);
                for (frame, image) in block.clone().zip(reader.images(block)?) {
                    let place =
                        Place { store: &recipe.path, episode, start: frames.start, frame, stamp: stamps[frame] };
                    let prediction = predictor.push(&change(place, image)?, stamps[frame])?;
                    watch(&prediction);
                    own.push(&prediction.field)?;
                }
            }
        }
        own.episode_ends = reader.episode_ends().to_vec();
        own.timestamps = stamps;
        all.append(&own)?;
    }
    Ok(all)
}
