//! Touch from a stream of images, one encoder pass per image.

use std::collections::VecDeque;
use std::path::Path;

use ::image::RgbImage;
use candle_core::{DType, Device, Tensor};

use super::{Checkpoint, Config, EgoTac, Metadata, Precision};
use crate::error::{Error, Result};
use crate::tactile::{N_FIELD, TactileField};

/// Frames kept per observation step, at most: bounds the memory under a camera much faster than `frame_dt`.
const KEPT_PER_STEP: usize = 8;

/// What may differ from run to run of the same checkpoint.
#[derive(Debug, Clone)]
pub struct Options {
    /// Where the network runs.
    pub device: Device,
    /// Number format it runs in; used by [`Predictor::load`].
    pub precision: Precision,
    /// Silence after which the stream counts as a new one, s; None = twice the window, at least 1 s.
    pub max_gap_secs: Option<f64>,
}

impl Default for Options {
    /// The CPU, f32, and the default silence.
    fn default() -> Self {
        Self { device: Device::Cpu, precision: Precision::F32, max_gap_secs: None }
    }
}

/// Touch at the instant of one image.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    /// The stamp of the image, s.
    pub stamp_secs: f64,
    /// Force (N; NaN if the force head was never trained) and contact probability.
    pub field: TactileField,
    /// Whether the window still repeats the oldest frame, since the stream does not reach back far enough.
    pub warming_up: bool,
    /// Whether this image began a new stream: the first one, a jump back in time or a long silence.
    pub restarted: bool,
}

/// Runs a checkpoint on a stream of images.
///
/// Each image is encoded once; its tokens, already projected for temporal fusion, are kept. The window of an image
/// at t holds, for i = T-1 .. 0, the kept frame nearest to t - i x `frame_dt`.
#[derive(Debug, Clone)]
pub struct Predictor {
    checkpoint: Checkpoint,
    device: Device,
    max_gap_secs: f64,
    frames: VecDeque<CachedFrame>, // oldest first, stamps strictly increasing
}

#[derive(Debug, Clone)]
struct CachedFrame {
    stamp_secs: f64,
    projected: Tensor, // (1, P, d)
}

impl Predictor {
    /// Loads a checkpoint.
    ///
    /// # Errors
    /// As [`Checkpoint::load`], and if an option is out of range.
    pub fn load(path: &Path, options: Options) -> Result<Self> {
        Self::new(Checkpoint::load_as(path, &options.device, options.precision)?, options)
    }

    /// Runs a checkpoint that is already on `options.device`.
    ///
    /// # Errors
    /// If an option is out of range.
    pub fn new(checkpoint: Checkpoint, options: Options) -> Result<Self> {
        let window = checkpoint.model.config().horizon.saturating_sub(1) as f64 * checkpoint.metadata.frame_dt;
        let max_gap_secs = options.max_gap_secs.unwrap_or((2.0 * window).max(1.0));
        if max_gap_secs.is_nan() || max_gap_secs <= 0.0 {
            return Err(Error::value("max_gap_secs", "seconds > 0", max_gap_secs));
        }
        Ok(Self { checkpoint, device: options.device, max_gap_secs, frames: VecDeque::new() })
    }

    /// What the checkpoint says beside its weights.
    pub fn metadata(&self) -> &Metadata {
        &self.checkpoint.metadata
    }

    /// Geometry of the network.
    pub fn config(&self) -> &Config {
        self.model().config()
    }

    /// The network itself.
    pub fn model(&self) -> &EgoTac {
        &self.checkpoint.model
    }

    /// SHA-256 of the checkpoint's file.
    pub fn sha256(&self) -> &str {
        &self.checkpoint.sha256
    }

    /// Frames kept now.
    pub fn cached_frames(&self) -> usize {
        self.frames.len()
    }

    /// Stamps of the frames kept now, s, oldest first: pushing these frames again after a reset restores the stream.
    pub fn kept_stamps(&self) -> impl Iterator<Item = f64> {
        self.frames.iter().map(|frame| frame.stamp_secs)
    }

    /// Forgets the stream so far.
    pub fn reset(&mut self) {
        self.frames.clear();
    }

    /// Predicts touch at the instant of `image`.
    ///
    /// A stamp before the last one, or a long silence, begins a new stream. The same stamp again replaces the image.
    ///
    /// # Errors
    /// If the stamp is not finite, the image is empty, or the network's output is not finite. The stream is then as
    /// if the image had not come.
    pub fn push(&mut self, image: &RgbImage, stamp_secs: f64) -> Result<Prediction> {
        let input = self.metadata().preparation(self.config()).apply(image)?;
        self.push_prepared(input, stamp_secs)
    }

    /// [`Predictor::push`] of an image that is prepared already, on another thread for instance; see
    /// [`Metadata::preparation`]. `input`: `(3, side, side)`.
    ///
    /// # Errors
    /// As [`Predictor::push`], and if the input has another size.
    pub fn push_prepared(&mut self, input: Vec<f32>, stamp_secs: f64) -> Result<Prediction> {
        if !stamp_secs.is_finite() {
            return Err(Error::value("image stamp", "finite seconds", stamp_secs));
        }
        let side = self.config().image;
        if input.len() != 3 * side * side {
            return Err(Error::shape("input", format!("[3, {side}, {side}]"), [input.len()]));
        }
        let input = Tensor::from_vec(input, (1, 3, side, side), &self.device)?;
        let projected = self.model().project(&self.model().encode(&input)?)?;

        let restarted = self.restarts_at(stamp_secs);
        if restarted {
            self.frames.clear();
        }
        if self.frames.back().is_some_and(|newest| newest.stamp_secs == stamp_secs) {
            self.frames.pop_back();
        }
        self.frames.push_back(CachedFrame { stamp_secs, projected });
        self.forget_what_no_window_needs();

        let (window, warming_up) = self.window(stamp_secs);
        let (force, logits) = self.model().heads(&self.model().fuse_frames(&window)?)?;
        let field = self.field(&first_step(&force)?, &first_step(&logits)?);
        // A frame that breaks the network must not stay in the windows to come.
        let field = field.inspect_err(|_| drop(self.frames.pop_back()))?;
        Ok(Prediction { stamp_secs, field, warming_up, restarted })
    }

    fn restarts_at(&self, stamp_secs: f64) -> bool {
        self.frames.back().is_none_or(|newest| {
            let step = stamp_secs - newest.stamp_secs;
            step < 0.0 || step > self.max_gap_secs
        })
    }

    /// The frames nearest to t - i x `frame_dt`, oldest first, and whether the oldest stands in for earlier ones.
    fn window(&self, stamp_secs: f64) -> (Vec<&Tensor>, bool) {
        let dt = self.metadata().frame_dt;
        let reach = self.config().horizon - 1;
        let nearest = |i: usize| {
            let wanted = stamp_secs - i as f64 * dt;
            let distance = |frame: &&CachedFrame| (frame.stamp_secs - wanted).abs();
            self.frames.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))
        };
        let window = (0..=reach).rev().filter_map(nearest).map(|frame| &frame.projected).collect();
        let oldest_wanted = stamp_secs - reach as f64 * dt;
        let warming_up = self.frames.front().is_some_and(|oldest| oldest.stamp_secs > oldest_wanted + 0.5 * dt);
        (window, warming_up)
    }

    /// Drops frames that lie before every window to come, and thins out those of a camera far faster than the steps.
    fn forget_what_no_window_needs(&mut self) {
        let Some(newest) = self.frames.back().map(|frame| frame.stamp_secs) else { return };
        let steps = self.config().horizon;
        let oldest_wanted = newest - (steps - 1) as f64 * self.metadata().frame_dt;
        // The last frame before the window may still be the nearest one.
        while self.frames.get(1).is_some_and(|second| second.stamp_secs <= oldest_wanted) {
            self.frames.pop_front();
        }
        if self.frames.len() > KEPT_PER_STEP * steps {
            // The frame whose neighbours are closest leaves the smallest gap; the newest and oldest stay.
            let gap = |i: &usize| self.frames[i + 1].stamp_secs - self.frames[i - 1].stamp_secs;
            if let Some(least) = (1..self.frames.len() - 1).min_by(|a, b| gap(a).total_cmp(&gap(b))) {
                self.frames.remove(least);
            }
        }
    }

    /// Newtons and probabilities from what the heads gave, (1556) each.
    fn field(&self, force: &[f32], logits: &[f32]) -> Result<TactileField> {
        for (name, values) in [("force", force), ("contact logits", logits)] {
            if values.len() != N_FIELD {
                return Err(Error::shape(name, format!("[{N_FIELD}]"), [values.len()]));
            }
            if let Some(bad) = values.iter().position(|value| !value.is_finite()) {
                return Err(Error::value(format!("network output, {name}[{bad}]"), "a finite number", values[bad]));
            }
        }
        let Metadata { topology, force_scale, has_force, .. } = *self.metadata();
        let newtons = |output: &f32| if has_force { (force_scale * output).max(0.0) } else { f32::NAN };
        Ok(TactileField {
            topology,
            force: force.iter().map(newtons).collect(),
            contact: logits.iter().map(|logit| sigmoid(*logit)).collect(),
        })
    }
}

/// Step 0 of `(1, K, 1556)`.
fn first_step(output: &Tensor) -> Result<Vec<f32>> {
    Ok(output.narrow(1, 0, 1)?.flatten_all()?.to_dtype(DType::F32)?.to_vec1()?)
}

/// 1 / (1 + e⁻ˣ), without overflow for any finite x.
fn sigmoid(x: f32) -> f32 {
    let e = (-x.abs()).exp();
    if x >= 0.0 { 1.0 / (1.0 + e) } else { e / (1.0 + e) }
}
