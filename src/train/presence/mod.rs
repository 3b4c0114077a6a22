//! Fit of [`Presence`](crate::model::Presence) to tokens of a network whose weights stay as they are.
//!
//! It learns from frames of stores that say where the hands are, as they are and changed (cut off at the edge, covered,
//! mirrored, in other colours), and from procedural pictures without hands. Stores of scenes without hands help much:
//! `egotac sim generate --hands none`.

mod head;
mod samples;
mod score;

use std::ops::Range;

use candle_core::{Device, Tensor};
use candle_nn::optim::{AdamW, Optimizer, ParamsAdamW};
use half::f16;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::data::Dataset;
use super::familiarity::{Parts, split};
use super::predict::input;
use crate::error::{Error, Result};
use crate::image::normalise;
use crate::model::familiarity::MIN_FRAMES;
use crate::model::{EgoTac, Presence};
use head::Head;
use samples::{Samples, Truth};
pub use score::Score;

/// Frames read and encoded at once.
const BLOCK: usize = 32;
/// Samples of a step.
const BATCH: usize = 64;
/// Learning rate at the start; it falls to 0 as a cosine.
const LEARNING_RATE: f64 = 4e-3;
/// Changed views of each training frame, beside the frame itself.
const VIEWS: usize = 2;
/// One picture without hands for this number of frames.
const FRAMES_PER_PICTURE: usize = 2;
/// Added to the seeds of pictures, so that those of tests, which count from 0, are others.
const PICTURE_SEED: u64 = 1 << 40;

/// Size of a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Training frames, at most; evenly spread over the stores. A frame becomes three samples of 26 kB each in a network of
    /// 101 tokens.
    pub frames: usize,
    /// Passes over the samples.
    pub epochs: usize,
    /// Seed of weights, views and order.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { frames: 4096, epochs: 15, seed: 0 }
    }
}

/// Result of a fit.
#[derive(Debug, Clone)]
pub struct Fitted {
    /// Tensors of the checkpoint by name.
    pub tensors: std::collections::BTreeMap<String, Tensor>,
    /// Score on held-out frames and pictures.
    pub score: Score,
}

/// Fits presence and keypoints, and scores them on held-out frames; without held-out stores, every fifth training episode is
/// held out, or the last fifth of a single one. `keypoints`: weight and bias of a trained layer of keypoint logits, to begin
/// with. `progress` gets the numbers of images and of steps done.
///
/// # Errors
/// If a store can't be read, there are too few frames whose hands are known, or the network gives a number that is not finite.
pub fn fit(
    model: &EgoTac,
    training: &Dataset,
    held_out: Option<&Dataset>,
    settings: &Settings,
    keypoints: Option<(Tensor, Tensor)>,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Fitted> {
    let known = |dataset: &Dataset| -> Parts {
        dataset.episodes().into_iter().filter(|(store, _)| dataset.knows_hands(*store)).collect()
    };
    let (kept, out) = match held_out {
        Some(held_out) => (known(training), known(held_out)),
        None => split(known(training)),
    };
    let mut encode = |dataset: &Dataset, parts: &Parts, frames: usize, views: usize, seed: u64| {
        samples(model, dataset, parts, frames, views, seed, &mut |images| progress(images, 0))
    };
    let learned = encode(training, &kept, settings.frames, VIEWS, settings.seed)?;
    let scored = encode(held_out.unwrap_or(training), &out, settings.frames / 2, 1, settings.seed ^ u64::MAX >> 1)?;
    let width = model.config().vision_width;
    let head = Head::new(width, keypoints, settings.seed)?;
    optimise(&head, &learned, model.config().tokens(), settings, &mut |steps| progress(0, steps))?;
    let tensors = head.tensors();
    let Some(presence) = Presence::from_weights(&tensors)? else {
        return Err(Error::value("presence", "all of its tensors", "some of them"));
    };
    Ok(Fitted { score: Score::of(&presence, &scored, model.config().tokens() * width), tensors })
}

/// As [`fit`], with small settings; None if there are too few frames whose hands are known to say anything.
///
/// # Errors
/// As [`fit`].
pub fn fit_if_enough(
    model: &EgoTac,
    training: &Dataset,
    seed: u64,
    keypoints: Option<(Tensor, Tensor)>,
) -> Result<Option<Fitted>> {
    let frames: usize = training
        .episodes()
        .iter()
        .filter(|(store, _)| training.knows_hands(*store))
        .map(|(_, frames)| frames.len())
        .sum();
    let settings = Settings { seed, frames: 2048, ..Settings::default() };
    match frames >= 5 * (MIN_FRAMES + 1) {
        true => fit(model, training, None, &settings, keypoints, &mut |_, _| ()).map(Some),
        false => Ok(None),
    }
}

/// Encodes at most `most` frames, each as it is and in `views` changed views, and pictures without hands.
fn samples(
    model: &EgoTac,
    dataset: &Dataset,
    parts: &Parts,
    most: usize,
    views: usize,
    seed: u64,
    progress: &mut dyn FnMut(usize),
) -> Result<Samples> {
    let frames: usize = parts.iter().map(|(_, frames)| frames.len()).sum();
    if frames < MIN_FRAMES {
        let expected = format!("at least {MIN_FRAMES} training and as many held-out ones");
        return Err(Error::value("frames with known poses of camera and hands", expected, frames));
    }
    let stride = frames.div_ceil(most.max(1)).max(1);
    let (preparation, mut found) = (dataset.preparation(), Samples::default());
    let (side, pixels) = (preparation.side, 3 * preparation.side.pow(2));
    let mut before = 0;
    for (store, part) in parts {
        let Some(points) = dataset.keypoints(*store) else { continue };
        for start in part.clone().step_by(BLOCK) {
            let block = start..(start + BLOCK).min(part.end);
            let wanted: Vec<usize> = (0..block.len()).filter(|at| (before + at).is_multiple_of(stride)).collect();
            before += block.len();
            if wanted.is_empty() {
                continue;
            }
            let images = dataset.read(*store, block.clone(), false)?.images;
            let image = |at: usize| &images[at * pixels..(at + 1) * pixels];
            let chosen: Vec<u8> = wanted.iter().flat_map(|at| image(*at)).copied().collect();
            let truths = wanted.iter().map(|at| Truth::of(&points[block.start + at])).collect();
            found.encode(model, &input(&chosen, preparation, &Device::Cpu)?, truths, true)?;
            let of = |at: usize, view: usize| {
                let seed = seed.wrapping_add(((*store as u64) << 40) + (VIEWS * (block.start + at) + view) as u64);
                samples::changed(image(at), &points[block.start + at], dataset.mirrorable(*store), preparation, seed)
            };
            let all: Vec<(usize, usize)> = wanted.iter().flat_map(|at| (0..views).map(|view| (*at, view))).collect();
            let (inputs, truths): (Vec<Vec<f32>>, Vec<Truth>) =
                all.into_par_iter().map(|(at, view)| of(at, view)).unzip();
            found.encode(model, &tensor(inputs, side)?, truths, false)?;
            progress(wanted.len() * (1 + views));
        }
    }
    let pictures = frames.div_ceil(stride) / FRAMES_PER_PICTURE;
    for start in (0..pictures).step_by(BLOCK) {
        let block: Range<usize> = start..(start + BLOCK).min(pictures);
        let draw = |index: usize| {
            let picture = samples::picture(index, side, (seed ^ PICTURE_SEED).wrapping_add(index as u64));
            normalise(&picture, preparation.mean, preparation.std)
        };
        let inputs: Vec<Vec<f32>> = block.clone().into_par_iter().map(draw).collect();
        found.encode(model, &tensor(inputs, side)?, vec![Truth::no_hands(); block.len()], false)?;
        progress(block.len());
    }
    Ok(found)
}

/// Returns images, (3, side, side) each, as one tensor.
fn tensor(images: Vec<Vec<f32>>, side: usize) -> Result<Tensor> {
    let n = images.len();
    Ok(Tensor::from_vec(images.concat(), (n, 3, side, side), &Device::Cpu)?)
}

impl Samples {
    /// Adds images, (N, 3, side, side).
    fn encode(&mut self, model: &EgoTac, images: &Tensor, truths: Vec<Truth>, unchanged: bool) -> Result<()> {
        let encoded = model.frame_tokens(images)?.encoded;
        self.tokens.extend(encoded.iter().map(|value| f16::from_f32(*value)));
        self.unchanged.resize(self.unchanged.len() + truths.len(), unchanged);
        self.truths.extend(truths);
        Ok(())
    }
}

/// Fits the weights to the samples by AdamW.
fn optimise(
    head: &Head,
    samples: &Samples,
    n_tokens: usize,
    settings: &Settings,
    progress: &mut dyn FnMut(usize),
) -> Result<()> {
    let (n, frame) = (samples.truths.len(), samples.tokens.len() / samples.truths.len());
    let steps = (settings.epochs * n).div_ceil(BATCH);
    let parameters = ParamsAdamW { lr: LEARNING_RATE, weight_decay: 1e-4, ..ParamsAdamW::default() };
    let mut optimizer = AdamW::new(head.vars(), parameters)?;
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    let mut order: Vec<usize> = Vec::new();
    for step in 0..steps {
        while order.len() < BATCH.min(n) {
            let mut epoch: Vec<usize> = (0..n).collect();
            epoch.shuffle(&mut rng);
            order.splice(0..0, epoch);
        }
        let chosen = order.split_off(order.len() - BATCH.min(n));
        let tokens: Vec<f32> = chosen
            .iter()
            .flat_map(|index| samples.tokens[index * frame..(index + 1) * frame].iter().map(|value| value.to_f32()))
            .collect();
        let tokens = Tensor::from_vec(tokens, (chosen.len(), n_tokens, frame / n_tokens), &Device::Cpu)?;
        let truths: Vec<&Truth> = chosen.iter().map(|index| &samples.truths[*index]).collect();
        let turn = std::f64::consts::PI * step as f64 / steps as f64;
        optimizer.set_learning_rate(0.5 * LEARNING_RATE * (1.0 + turn.cos()));
        optimizer.backward_step(&head.loss(&tokens, &truths)?)?;
        progress(1);
    }
    Ok(())
}
