//! Touch from a stream of images, one encoder pass per image.

mod batch;
mod reuse;

use std::path::Path;
use std::sync::Arc;

use ::image::RgbImage;
use candle_core::{Device, Tensor};

use super::presence::N_POINTS;
use super::stages::FrameTokens;
use super::unknown::Unknown;
use super::{Checkpoint, Config, EgoTac, HandEstimate, Metadata, Precision, Spread, View, familiarity, window};
use crate::error::{Error, Result};
use crate::hand::{FieldMap, N_KEYPOINTS, Side, Topology};
use crate::image::{Preparation, Resize};
use crate::tactile::{Certainty, TactileField};
use reuse::Reuse;

/// Frames kept per observation step, at most. Bounds the memory under a camera much faster than `frame_dt`.
const KEPT_PER_STEP: usize = 8;

/// Options of a predictor that are not part of the checkpoint.
#[derive(Debug, Clone)]
pub struct Options {
    /// Device that runs the network.
    pub device: Device,
    /// Number format of the network; used by [`Predictor::load`].
    pub precision: Precision,
    /// Longest interval between two images of a stream, s; a longer one starts a new stream. None = twice the length of
    /// the window, at least 1 s.
    pub max_gap_secs: Option<f64>,
    /// Conversion of pictures to the network's input.
    pub view: View,
    /// Form of touch that is unknown.
    pub unknown: Unknown,
    /// Familiarity below which touch is unknown, 0 to 1. None = the checkpoint's threshold.
    pub familiarity_threshold: Option<f32>,
    /// Presence of a hand below which its touch is unknown, 0 to 1. None = the checkpoint's threshold.
    pub presence_threshold: Option<f32>,
    /// Mean absolute change of a patch, grey levels of 8 bits: an image none of whose patches differs more from the last encoded one
    /// takes its tokens, which saves the encoder's time. 0 = every image is encoded.
    pub reuse_below: f32,
}

impl Default for Options {
    /// Runs on the CPU in f32, with the default interval and the checkpoint's view; unknown touch is NaN.
    fn default() -> Self {
        Self {
            device: Device::Cpu,
            precision: Precision::F32,
            max_gap_secs: None,
            view: View::default(),
            unknown: Unknown::default(),
            familiarity_threshold: None,
            presence_threshold: None,
            reuse_below: 0.0,
        }
    }
}

/// Touch at the instant of one image.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    /// Stamp of the image, s.
    pub stamp_secs: f64,
    /// Force (N; NaN if the force head was never trained) and contact probability; where touch is unknown, the form that
    /// [`Options::unknown`] names.
    pub field: TactileField,
    /// Estimates about the image, and the hands whose touch is unknown.
    pub certainty: Certainty,
    /// Presence and keypoints of the left and the right hand in this image; None if the checkpoint does not estimate them.
    pub hands: Option<[HandEstimate; 2]>,
    /// True if the stream does not reach back to the start of the window, so that the oldest frame is repeated.
    pub warming_up: bool,
    /// True if this image started a new stream: the first one, a jump back in time, or an interval that is too long.
    pub restarted: bool,
    /// True if the image was not encoded, but took the tokens of an earlier one; see [`Options::reuse_below`].
    pub reused: bool,
}

impl Prediction {
    /// Returns the keypoints of both hands in the image, which was prepared by `preparation` and has this width and height,
    /// pixels: (42) of x, y, pixels from its left and upper edge, and confidence, 0 to 1; left hand first, each in the order of
    /// [`HandEstimate::keypoints`]. NaN for a hand whose touch is not known. None if the checkpoint does not estimate them.
    pub fn keypoints(&self, preparation: &Preparation, width: u32, height: u32) -> Option<[[f32; 3]; N_POINTS]> {
        let hands = self.hands?;
        Some(std::array::from_fn(|point| {
            let side = Side::BOTH[point / N_KEYPOINTS];
            if !self.certainty.counts(side) {
                return [f32::NAN; 3];
            }
            let keypoint = hands[side as usize].keypoints[point % N_KEYPOINTS];
            let [x, y] = keypoint.pixel(preparation, width as usize, height as usize);
            [x as f32, y as f32, keypoint.confidence]
        }))
    }
}

/// Runs a checkpoint on a stream of images.
///
/// Each image is encoded once. Its tokens, projected for temporal fusion, are kept as long as a window may need them; see
/// [`window`] for the frames of a window.
///
/// ```
/// use egotac::model::{predictor::Options, shipped};
/// use egotac::{Predictor, Side};
///
/// # fn main() -> egotac::Result<()> {
/// let mut predictor = Predictor::load(&shipped::path()?, Options::default())?;
/// for frame in 0..3 {
///     let image = egotac::crates::image::RgbImage::new(640, 480);
///     let prediction = predictor.push(&image, 0.04 * f64::from(frame))?; // image and its stamp, s
///     // A black image is unlike all that the network was trained on: touch is unknown.
///     assert!(prediction.certainty.is_unfamiliar());
///     assert!(prediction.field.total_force(Side::Left).is_nan()); // N
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Predictor {
    checkpoint: Checkpoint,
    device: Device,
    max_gap_secs: f64,
    unknown: Unknown,
    /// Conversion of pictures that replaces the checkpoint's.
    other_view: Option<Resize>,
    frames: Vec<CachedFrame>, // oldest first, stamps strictly increasing
    reuse: Reuse,
    /// MANO files whose vertices the fields are carried over to; None = the checkpoint's topology.
    mano: Option<Arc<FieldMap>>,
}

#[derive(Debug, Clone)]
struct CachedFrame {
    stamp_secs: f64,
    tokens: Tensor, // (1, P, d), projected
}

impl Predictor {
    /// Loads a checkpoint.
    ///
    /// # Errors
    /// As [`Checkpoint::load`], and if an option is out of range.
    pub fn load(path: &Path, options: Options) -> Result<Self> {
        Self::new(Checkpoint::load_as(path, &options.device, options.precision)?, options)
    }

    /// Creates a predictor from a checkpoint that is already on `options.device`.
    ///
    /// # Errors
    /// If an option is out of range.
    pub fn new(mut checkpoint: Checkpoint, options: Options) -> Result<Self> {
        let window = checkpoint.model.config().horizon.saturating_sub(1) as f64 * checkpoint.metadata.frame_dt;
        let max_gap_secs = options.max_gap_secs.unwrap_or((2.0 * window).max(1.0));
        if max_gap_secs.is_nan() || max_gap_secs <= 0.0 {
            return Err(Error::value("max_gap_secs", "seconds > 0", max_gap_secs));
        }
        let doubt = &mut checkpoint.metadata.doubt;
        doubt.familiarity = options.familiarity_threshold.unwrap_or(doubt.familiarity);
        doubt.presence = options.presence_threshold.unwrap_or(doubt.presence);
        doubt.check()?;
        let Options { device, unknown, view, reuse_below, .. } = options;
        let reuse = Reuse::new(reuse_below)?;
        let own = checkpoint.metadata.resize;
        let other_view = view.resize().filter(|resize| *resize != own);
        checkpoint.metadata.resize = other_view.unwrap_or(own);
        Ok(Self { checkpoint, device, max_gap_secs, unknown, other_view, frames: Vec::new(), reuse, mano: None })
    }

    /// Returns the predictor with the output of the force head as force, also where no force ever trained it; otherwise such
    /// forces are unknown (NaN). The paper scores its network without force supervision so.
    #[must_use]
    pub fn with_untrained_force(mut self) -> Self {
        self.checkpoint.metadata.has_force = true;
        self
    }

    /// Form of touch that is unknown.
    pub fn unknown(&self) -> Unknown {
        self.unknown
    }

    /// Conversion of pictures by [`Options::view`], if the checkpoint has another; None = that of the checkpoint.
    pub fn other_view(&self) -> Option<Resize> {
        self.other_view
    }

    /// True if the checkpoint can tell unfamiliar images.
    pub fn estimates_familiarity(&self) -> bool {
        self.checkpoint.familiarity.is_some()
    }

    /// True if the checkpoint can tell absent hands.
    pub fn estimates_presence(&self) -> bool {
        self.checkpoint.presence.is_some()
    }

    /// Intervals of predicted forces; None if the checkpoint has none.
    pub fn spread(&self) -> Option<&Spread> {
        self.checkpoint.spread.as_ref()
    }

    /// Returns a warning for people if the checkpoint lacks an estimate of what it does not know; None if it has all.
    pub fn warning(&self) -> Option<String> {
        let name = &self.metadata().name;
        let (missing, whose, command) = match (self.estimates_familiarity(), self.estimates_presence()) {
            (true, true) => return None,
            (false, _) => ("how familiar an image is", "every image, whatever it shows", "familiarity"),
            (true, false) => ("which hands are in the image", "hands that are not in it too", "presence"),
        };
        Some(format!(
            "network {name} does not tell {missing}: touch is reported for {whose}; `egotac model {command}` adds that to a \
             checkpoint"
        ))
    }

    /// Returns the predictor with fields on the vertices of MANO files, whatever the checkpoint's topology: the total force of
    /// each hand is kept, contact is taken from the nearest vertex.
    #[must_use]
    pub fn with_mano(mut self, mano: Arc<FieldMap>) -> Self {
        self.mano = Some(mano);
        self
    }

    /// MANO files of [`Predictor::with_mano`].
    pub fn mano(&self) -> Option<&Arc<FieldMap>> {
        self.mano.as_ref()
    }

    /// Vertex numbering of the predicted fields; that of the network is in the metadata.
    pub fn topology(&self) -> Topology {
        if self.mano.is_some() { Topology::Mano } else { self.metadata().topology }
    }

    /// Metadata of the checkpoint.
    pub fn metadata(&self) -> &Metadata {
        &self.checkpoint.metadata
    }

    /// Geometry of the network.
    pub fn config(&self) -> &Config {
        self.model().config()
    }

    /// The network.
    pub fn model(&self) -> &EgoTac {
        &self.checkpoint.model
    }

    /// SHA-256 of the checkpoint's file.
    pub fn sha256(&self) -> &str {
        &self.checkpoint.sha256
    }

    /// Number of frames kept now.
    pub fn cached_frames(&self) -> usize {
        self.frames.len()
    }

    /// Stamps of the frames kept now, s, oldest first. Pushing these frames again after a reset restores the stream, if every image
    /// is encoded.
    pub fn kept_stamps(&self) -> impl Iterator<Item = f64> {
        self.frames.iter().map(|frame| frame.stamp_secs)
    }

    /// Drops all frames: the next image starts a new stream.
    pub fn reset(&mut self) {
        self.frames.clear();
        self.reuse.forget();
    }

    /// Predicts touch at the instant of `image`.
    ///
    /// A stamp before the last one, or too long after it, starts a new stream. An image with the stamp of the last one
    /// replaces it.
    ///
    /// # Errors
    /// If the stamp is not finite, the image is empty, or the network's output is not finite. The stream is then as
    /// if the image had not come.
    pub fn push(&mut self, image: &RgbImage, stamp_secs: f64) -> Result<Prediction> {
        let input = self.metadata().preparation(self.config()).apply(image)?;
        self.push_prepared(input, stamp_secs)
    }

    /// As [`Predictor::push`], with an image that is already prepared by [`Metadata::preparation`], for instance on another
    /// thread. `input`: `(3, side, side)`.
    ///
    /// # Errors
    /// As [`Predictor::push`], and if the input has another size.
    pub fn push_prepared(&mut self, input: Vec<f32>, stamp_secs: f64) -> Result<Prediction> {
        self.check(&input, stamp_secs)?;
        if let Some(tokens) = self.reusable(&input) {
            return self.push_reused(&tokens, stamp_secs);
        }
        let side = self.config().image;
        let image = Tensor::from_slice(&input, (1, 3, side, side), &self.device)?;
        let encoded = Arc::new(self.model().frame_tokens(&image)?);
        let prediction = self.push_encoded(&encoded, stamp_secs)?;
        self.reuse.keep(&input, &encoded);
        Ok(prediction)
    }

    /// Predicts touch from the tokens of an earlier image.
    fn push_reused(&mut self, tokens: &Arc<FrameTokens>, stamp_secs: f64) -> Result<Prediction> {
        Ok(Prediction { reused: true, ..self.push_encoded(tokens, stamp_secs)? })
    }

    /// Returns the tokens of the last encoded image if `input` hardly differs from it.
    fn reusable(&self, input: &[f32]) -> Option<Arc<FrameTokens>> {
        self.reuse.tokens(input, self.config(), self.metadata().std)
    }

    /// Checks a prepared image, `(3, side, side)`, and its stamp.
    fn check(&self, input: &[f32], stamp_secs: f64) -> Result<()> {
        if !stamp_secs.is_finite() {
            return Err(Error::value("image stamp", "finite seconds", stamp_secs));
        }
        let side = self.config().image;
        if input.len() != 3 * side * side {
            return Err(Error::shape("input", format!("[3, {side}, {side}]"), [input.len()]));
        }
        Ok(())
    }

    /// Predicts touch at the instant of an encoded image; the end of [`Predictor::push_prepared`].
    fn push_encoded(&mut self, encoded: &FrameTokens, stamp_secs: f64) -> Result<Prediction> {
        let (mut certainty, hands) = self.judge(&encoded.encoded);
        let tokens = encoded.projected.clone();

        // A copy of the list (the tokens are shared) that replaces it only on success.
        let restarted = self.restarts_at(stamp_secs);
        let mut frames = if restarted { Vec::new() } else { self.frames.clone() };
        if frames.last().is_some_and(|newest| newest.stamp_secs == stamp_secs) {
            frames.pop();
        }
        frames.push(CachedFrame { stamp_secs, tokens });
        let stamps = self.forget_frames(&mut frames);

        let (horizon, frame_dt) = (self.config().horizon, self.metadata().frame_dt);
        let places = window::window(&stamps, horizon, frame_dt);
        let window: Vec<&Tensor> = places.iter().map(|place| &frames[*place].tokens).collect();
        let (force, contact) = self.model().head_outputs(&window)?.first_step(self.metadata())?;
        let mut field = TactileField { topology: self.metadata().topology, force, contact };
        self.unknown.apply(&mut field, &mut certainty);
        let field = match &self.mano {
            Some(mano) => field.carried(mano, Topology::Mano)?,
            None => field,
        };
        let warming_up = window::is_warming_up(&stamps, horizon, frame_dt);
        self.frames = frames;
        Ok(Prediction { stamp_secs, field, certainty, hands, warming_up, restarted, reused: false })
    }

    /// Judges a frame by its tokens, `(P, dv)`.
    fn judge(&self, tokens: &[f32]) -> (Certainty, Option<[HandEstimate; 2]>) {
        let feature = familiarity::features(tokens, self.config().tokens(), self.config().vision_width);
        let familiarity = self.checkpoint.familiarity.as_ref().map(|statistics| statistics.of(&feature));
        let hands = self.checkpoint.presence.as_ref().map(|weights| weights.of(tokens));
        let presence = hands.map_or([None; 2], |hands| hands.map(|hand| Some(hand.presence)));
        (self.metadata().doubt.judge(familiarity, presence), hands)
    }

    /// True if an image with this stamp starts a new stream.
    fn restarts_at(&self, stamp_secs: f64) -> bool {
        self.frames.last().is_none_or(|newest| {
            let step = stamp_secs - newest.stamp_secs;
            step < 0.0 || step > self.max_gap_secs
        })
    }

    /// Drops frames that no later window can contain, and thins out the frames of a camera far faster than the steps.
    /// Returns the stamps of the others.
    fn forget_frames(&self, frames: &mut Vec<CachedFrame>) -> Vec<f64> {
        let mut stamps: Vec<f64> = frames.iter().map(|frame| frame.stamp_secs).collect();
        let obsolete = window::obsolete(&stamps, self.config().horizon, self.metadata().frame_dt);
        frames.drain(..obsolete);
        stamps.drain(..obsolete);
        if stamps.len() > KEPT_PER_STEP * self.config().horizon {
            // The frame whose neighbours are closest leaves the smallest gap; the newest and oldest stay.
            let gap = |i: &usize| stamps[i + 1] - stamps[i - 1];
            if let Some(least) = (1..stamps.len() - 1).min_by(|a, b| gap(a).total_cmp(&gap(b))) {
                frames.remove(least);
                stamps.remove(least);
            }
        }
        stamps
    }
}
