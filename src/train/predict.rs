//! Touch for whole episodes, with windows as a stream would form them, many frames at a time.

use std::collections::BTreeMap;

use candle_core::{DType, Device, Tensor};

use super::data::Dataset;
use super::sampler::window;
use crate::error::{Error, Result};
use crate::image::Preparation;
use crate::image::normalise;
use crate::model::{EgoTac, Metadata};
use crate::tactile::TactileSequence;

/// Frames whose windows are decoded at once.
const BLOCK: usize = 32;

/// Predicts touch for every frame of a dataset, store by store: force in N, never negative (NaN if the force head was
/// never trained), and contact probability. Each frame is encoded once.
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
    let mut fields = TactileSequence { topology: Some(metadata.topology), ..Default::default() };
    for (store, episode) in dataset.episodes() {
        let times = dataset.timestamps(store);
        let mut projected: BTreeMap<usize, Tensor> = BTreeMap::new(); // (P, d) by frame
        for start in episode.clone().step_by(BLOCK) {
            let block = start..(start + BLOCK).min(episode.end);
            let images = dataset.read(store, block.clone(), false)?.images;
            let tokens = model.project(&model.encode(&input(&images, &preparation, device)?)?)?;
            for (at, frame) in block.clone().enumerate() {
                projected.insert(frame, tokens.get(at)?);
            }
            let windows: Vec<Vec<usize>> =
                block.clone().map(|newest| window(times, episode.start, newest, horizon, metadata.frame_dt)).collect();
            let places: Option<Vec<&Tensor>> = windows.iter().flatten().map(|frame| projected.get(frame)).collect();
            let places = places.ok_or_else(|| Error::value("window", "frames already encoded", "a dropped one"))?;
            let (p, d) = places[0].dims2()?;
            let stacked = Tensor::stack(&places, 0)?.reshape((block.len(), horizon, p, d))?;
            let (force, logits) = model.heads(&model.fuse(&stacked)?)?;
            append(&mut fields, metadata, &force, &logits)?;
            // Later windows reach back no further than the next block's first one does.
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

fn input(images: &[u8], preparation: &Preparation, device: &Device) -> Result<Tensor> {
    let side = preparation.side;
    let mut values = Vec::with_capacity(images.len());
    for pixels in images.chunks_exact(side * side * 3) {
        let image = ::image::RgbImage::from_raw(side as u32, side as u32, pixels.to_vec())
            .ok_or_else(|| Error::shape("image", format!("({side}, {side}, 3)"), [pixels.len()]))?;
        values.extend(normalise(&image, preparation.mean, preparation.std));
    }
    Ok(Tensor::from_vec(values, (images.len() / (side * side * 3), 3, side, side), device)?)
}

/// Appends step 0 of what the heads gave, `(B, K, 1556)` each.
fn append(fields: &mut TactileSequence, metadata: &Metadata, force: &Tensor, logits: &Tensor) -> Result<()> {
    let first = |output: &Tensor, name: &str| -> Result<Vec<f32>> {
        let values = output.narrow(1, 0, 1)?.flatten_all()?.to_dtype(DType::F32)?.to_vec1::<f32>()?;
        match values.iter().find(|value| !value.is_finite()) {
            Some(bad) => Err(Error::value(format!("network output, {name}"), "finite numbers", bad)),
            None => Ok(values),
        }
    };
    let newtons = |x: f32| if metadata.has_force { (metadata.force_scale * x).max(0.0) } else { f32::NAN };
    fields.force.extend(first(force, "force")?.into_iter().map(newtons));
    // Through f64, where no finite f32 overflows the exponential.
    let sigmoid = |x: f32| (1.0 / (1.0 + (-f64::from(x)).exp())) as f32;
    fields.contact.extend(first(logits, "contact logits")?.into_iter().map(sigmoid));
    Ok(())
}
