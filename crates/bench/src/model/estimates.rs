//! Cost of the estimates beside the network: familiarity, presence, keypoints.

use std::path::Path;
use std::time::Instant;

use candle_core::Device;
use egotac::Result;
use egotac::model::predictor::Options;
use egotac::model::{Checkpoint, Precision, Predictor};
use egotac::statistics::median;
use serde::Serialize;

use super::image;

/// Images before the first measured one, of each stream.
const WARM_UP: usize = 10;

/// Times of a stream with and without the estimates.
#[derive(Debug, Clone, Serialize)]
pub struct Estimates {
    /// Median time of an image without them, ms.
    pub without_ms: f64,
    /// Median time of an image with them, ms.
    pub with_ms: f64,
    /// Median over the images of the relative difference of the two times.
    pub share: f64,
    /// Images of each stream.
    pub images: usize,
}

/// Sends the same images through two streams in turn, which alternate in who is first.
///
/// # Errors
/// If the checkpoint can't be read.
pub fn measure(path: &Path, precision: Precision, images: usize) -> Result<Estimates> {
    let checkpoint = Checkpoint::load_as(path, &Device::Cpu, precision)?;
    let bare = Checkpoint { familiarity: None, presence: None, ..checkpoint.clone() };
    let mut streams = [Predictor::new(bare, Options::default())?, Predictor::new(checkpoint, Options::default())?];
    let mut times = [Vec::new(), Vec::new()];
    let preparation = streams[0].metadata().preparation(streams[0].config());
    let picture = egotac::image::decode(&image::jpeg()?)?;
    for index in 0..WARM_UP + images {
        let input = preparation.apply(&picture)?;
        for turn in 0..2 {
            let at = (index + turn) % 2;
            let began = Instant::now();
            streams[at].push_prepared(input.clone(), 0.04 * index as f64)?;
            if index >= WARM_UP {
                times[at].push(1e3 * began.elapsed().as_secs_f64());
            }
        }
    }
    let pairs = times[0].iter().zip(&times[1]);
    let share = median(pairs.map(|(without, with)| with / without - 1.0));
    let [without_ms, with_ms] = times.map(median);
    Ok(Estimates { without_ms, with_ms, share, images })
}
