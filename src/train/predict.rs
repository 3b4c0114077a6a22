//! Batch prediction of whole episodes, with the same windows as a stream.

use std::collections::BTreeMap;

use candle_core::{Device, Tensor};

use super::data::Dataset;
use super::sampler::window;
use crate::error::{Error, Result};
use crate::image::Preparation;
use crate::image::normalise;
use crate::model::{EgoTac, Metadata};
use crate::tactile::TactileSequence;

/// Frames that are encoded, and whose windows are decoded, at once: enough for large matrix products, few enough that the
/// images of a block fit in memory.
const BLOCK: usize = 32;

/// Predicts touch for every frame of a dataset, store by store, with time stamps and episodes: force in N, never negative
/// (NaN if the force head was not trained), and contact probability. Each frame is encoded once.
///
/// # Errors
/// If a store can't be read, or the network gives a number that is not finite.
pub fn predict(
    model: &EgoTac,
    metadata: &Metadata,
    dataset: &Dataset,
    device: &Device,
    mut progress: impl FnMut(usize),
) -> Result<TactileSequence> {
    let preparation = metadata.preparation(model.config());
    let horizon = model.config().horizon;
    let (topology, force_kind) = (Some(metadata.topology), Some(metadata.force_kind));
    let mut fields = TactileSequence { topology, force_kind, ..Default::default() };
    for (store, episode) in dataset.episodes() {
        let times = dataset.timestamps(store);
        let mut projected: BTreeMap<usize, Tensor> = BTreeMap::new(); // (P, d) by frame
        for start in episode.clone().step_by(BLOCK) {
            let block = start..(start + BLOCK).min(episode.end);
            let images = dataset.read(store, block.clone(), false)?.images;
            let tokens = model.frame_tokens(&input(&images, &preparation, device)?)?.projected;
            for (at, frame) in block.clone().enumerate() {
                projected.insert(frame, tokens.get(at)?);
            }
            let windows: Vec<Vec<usize>> =
                block.clone().map(|newest| window(times, episode.start, newest, horizon, metadata.frame_dt)).collect();
            let places: Option<Vec<&Tensor>> = windows.iter().flatten().map(|frame| projected.get(frame)).collect();
            let places = places.ok_or_else(|| Error::value("window", "frames already encoded", "a dropped one"))?;
            let (force, contact) = model.head_outputs(&places)?.first_step(metadata)?;
            fields.force.extend(force);
            fields.contact.extend(contact);
            // No later window reaches back further than the first one of the next block.
            if block.end < episode.end {
                let oldest = window(times, episode.start, block.end, horizon, metadata.frame_dt)[0];
                projected = projected.split_off(&oldest);
            }
            progress(block.len());
        }
        fields.timestamps.extend_from_slice(&times[episode]);
        fields.episode_ends.push(fields.timestamps.len());
    }
    Ok(fields)
}

/// Normalises images, `(N, side, side, 3)`, into the input of the network, `(N, 3, side, side)`.
pub(super) fn input(images: &[u8], preparation: &Preparation, device: &Device) -> Result<Tensor> {
    let side = preparation.side;
    let mut values = Vec::with_capacity(images.len());
    for pixels in images.chunks_exact(side * side * 3) {
        let image = ::image::RgbImage::from_raw(side as u32, side as u32, pixels.to_vec())
            .ok_or_else(|| Error::shape("image", format!("({side}, {side}, 3)"), [pixels.len()]))?;
        values.extend(normalise(&image, preparation.mean, preparation.std));
    }
    Ok(Tensor::from_vec(values, (images.len() / (side * side * 3), 3, side, side), device)?)
}
