//! Touch from a stream of images, one encoder pass per image.

mod batch;
mod focus;
mod frames;
mod hands;
mod input;
mod reuse;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use ::image::RgbImage;
use candle_core::{Device, Tensor};

use super::engine::ChangedPatches;
use super::presence::N_POINTS;
use super::stages::FrameTokens;
use super::unknown::Unknown;
use super::{Checkpoint, Config, EgoTac, HandEstimate, Metadata, Precision, Spread, View, familiarity};
use crate::error::{Error, Result};
use crate::hand::{FieldMap, N_KEYPOINTS, Side, Topology};
use crate::image::{Framing, Preparation, Resize};
use crate::tactile::{Certainty, TactileField};
pub use focus::Focus;
use focus::{Before, Focused};
use frames::{Frames, Steps};
use hands::Hands;
pub use input::{InputPreparation, Prepared};
use reuse::Reuse;

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
    /// Network of whole pictures that finds the hands for one that sees single hands; None = the shipped network.
    pub locator: Option<PathBuf>,
    /// Form of touch that is unknown.
    pub unknown: Unknown,
    /// Familiarity below which touch is unknown, 0 to 1. None = the checkpoint's threshold.
    pub familiarity_threshold: Option<f32>,
    /// Presence of a hand below which its touch is unknown, 0 to 1. None = the checkpoint's threshold.
    pub presence_threshold: Option<f32>,
    /// Mean absolute change of a patch, grey levels of 8 bits: an image none of whose patches differs more from the last encoded one
    /// takes its tokens, which saves the encoder's time. 0 = every image is encoded.
    pub reuse_below: f32,
    /// Patches of an image that the encoder computes anew; None = all. Needs a network that estimates keypoints, on the CPU.
    pub focus: Option<Focus>,
}

impl Default for Options {
    /// Runs on the CPU in f32, with the default interval and the checkpoint's view; unknown touch is NaN.
    fn default() -> Self {
        Self {
            device: Device::Cpu,
            precision: Precision::F32,
            max_gap_secs: None,
            view: View::default(),
            locator: None,
            unknown: Unknown::default(),
            familiarity_threshold: None,
            presence_threshold: None,
            reuse_below: 0.0,
            focus: None,
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
    /// Share of the image's patches that all layers of the encoder computed, 0 to 1: below 1 with [`Options::focus`], and 0 if the
    /// image took the tokens of an earlier one ([`Options::reuse_below`]).
    pub encoded: f32,
}

impl Prediction {
    /// True if the image was not encoded, but took the tokens of an earlier one.
    pub fn is_reused(&self) -> bool {
        self.encoded == 0.0
    }

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
/// [`super::window`] for the frames of a window.
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
    /// Frames of a network of whole pictures.
    frames: Frames,
    /// Locator and frames of a network that sees single hands.
    hands: Option<Box<Hands>>,
    reuse: Reuse,
    focused: Focused,
    /// MANO files whose vertices the fields are carried over to; None = the checkpoint's topology.
    mano: Option<Arc<FieldMap>>,
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
        let mut hands = match checkpoint.metadata.framing {
            Framing::Whole => None,
            Framing::Hands if options.reuse_below > 0.0 => {
                let expected = "0 for a network that sees single hands, which are cut out of each picture anew";
                return Err(Error::value("reuse_below", expected, options.reuse_below));
            }
            Framing::Hands => Some(Box::new(Hands::load(&options)?)),
        };
        // The network that sees the whole picture.
        let metadata = hands.as_mut().map_or(&mut checkpoint.metadata, |hands| &mut hands.locator.metadata);
        let doubt = &mut metadata.doubt;
        doubt.familiarity = options.familiarity_threshold.unwrap_or(doubt.familiarity);
        doubt.presence = options.presence_threshold.unwrap_or(doubt.presence);
        doubt.check()?;
        let own = metadata.resize;
        let other_view = options.view.resize().filter(|resize| *resize != own);
        metadata.resize = other_view.unwrap_or(own);
        if let Some(focus) = &options.focus {
            check_focus(focus, &checkpoint, &options.device)?;
        }
        checkpoint.model = checkpoint.model.record();
        let Options { device, unknown, reuse_below, focus, .. } = options;
        let (reuse, focused, frames) = (Reuse::new(reuse_below)?, Focused::new(focus), Frames::default());
        Ok(Self { checkpoint, device, max_gap_secs, unknown, other_view, frames, hands, reuse, focused, mano: None })
    }

    /// Returns the predictor with the output of the force head as force, also where no force ever trained it; otherwise such
    /// forces are unknown (NaN). The paper scores its network without force supervision so.
    #[must_use]
    pub fn with_untrained_force(mut self) -> Self {
        self.checkpoint.metadata.has_force = true;
        self
    }

    /// Returns the predictor with another form of touch that is unknown.
    #[must_use]
    pub fn with_unknown(mut self, unknown: Unknown) -> Self {
        self.unknown = unknown;
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

    /// Network that sees the whole picture: the locator of a network that sees single hands.
    fn whole(&self) -> &Checkpoint {
        self.hands.as_ref().map_or(&self.checkpoint, |hands| &hands.locator)
    }

    /// Returns the conversion of pictures to what [`Predictor::push_prepared`] takes.
    pub fn preparation(&self) -> InputPreparation {
        let whole = self.whole();
        let preparation = whole.metadata.preparation(whole.model.config());
        InputPreparation { whole: preparation, framing: self.metadata().framing }
    }

    /// Locator of a network that sees single hands: its metadata; None for a network of whole pictures.
    pub fn locator(&self) -> Option<&Metadata> {
        self.hands.as_ref().map(|hands| &hands.locator.metadata)
    }

    /// True if unfamiliar images can be told.
    pub fn estimates_familiarity(&self) -> bool {
        self.whole().familiarity.is_some()
    }

    /// True if absent hands can be told.
    pub fn estimates_presence(&self) -> bool {
        self.whole().presence.is_some()
    }

    /// Intervals of predicted forces; None if the checkpoint has none.
    pub fn spread(&self) -> Option<&Spread> {
        self.checkpoint.spread.as_ref()
    }

    /// Returns a warning if the checkpoint estimates no familiarity or no presence, so that it reports touch that it can't know; None
    /// if it estimates both.
    pub fn warning(&self) -> Option<String> {
        let name = &self.whole().metadata.name;
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

    /// Number of frames kept now; frames of the two hands count each.
    pub fn cached_frames(&self) -> usize {
        self.all_frames().map(Frames::len).sum()
    }

    /// Stamps of the frames kept now, s, oldest first for each hand. Pushing these frames again after a reset restores the stream, if
    /// every image is encoded.
    pub fn kept_stamps(&self) -> impl Iterator<Item = f64> {
        self.all_frames().flat_map(Frames::stamps)
    }

    fn all_frames(&self) -> impl Iterator<Item = &Frames> {
        std::iter::once(&self.frames).chain(self.hands.iter().flat_map(|hands| &hands.frames))
    }

    /// Drops all frames: the next image starts a new stream.
    pub fn reset(&mut self) {
        self.frames.clear();
        if let Some(hands) = &mut self.hands {
            hands.reset();
        }
        self.reuse.forget();
        self.focused.forget();
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
        let input = self.preparation().apply(image)?;
        self.push_prepared(input, stamp_secs)
    }

    /// As [`Predictor::push`], with an image that is already prepared by [`Predictor::preparation`], for instance on another
    /// thread. A network of whole pictures takes the numbers alone too, `(3, side, side)`.
    ///
    /// # Errors
    /// As [`Predictor::push`], and if the input has another size.
    pub fn push_prepared(&mut self, input: impl Into<Prepared>, stamp_secs: f64) -> Result<Prediction> {
        let input = input.into();
        self.check(&input.whole, stamp_secs)?;
        if self.hands.is_some() {
            return self.push_hands(&input, stamp_secs);
        }
        let input = input.whole;
        if let Some(tokens) = self.reusable(&input) {
            return self.push_reused(&tokens, stamp_secs);
        }
        let side = self.config().image;
        let image = Tensor::from_slice(&input, (1, 3, side, side), &self.device)?;
        let (encoded, share) = self.encode(&image, stamp_secs)?;
        let encoded = Arc::new(encoded);
        let prediction = self.push_encoded(&encoded, stamp_secs)?;
        self.reuse.keep(&input, &encoded);
        self.focused.keep(&encoded, share == 1.0, prediction.hands, side / self.config().patch);
        Ok(Prediction { encoded: share, ..prediction })
    }

    /// Encodes an image, `(1, 3, side, side)`, whole or in part. Returns the share of its patches that all layers computed, too.
    fn encode(&self, image: &Tensor, stamp_secs: f64) -> Result<(FrameTokens, f32)> {
        // The image before a new stream says nothing about this one.
        let continues = !self.restarts_after(self.frames.stamps().last(), stamp_secs);
        if let Some(Before { after, near, tokens }) = self.focused.before().filter(|_| continues)
            && let Some(tokens) = self.model().part_tokens(image, ChangedPatches { after, patches: near }, tokens)?
        {
            let patches = (self.config().image / self.config().patch).pow(2);
            return Ok((tokens, near.len() as f32 / patches as f32));
        }
        Ok((self.model().frame_tokens(image)?, 1.0))
    }

    /// Predicts touch from the tokens of an earlier image.
    fn push_reused(&mut self, tokens: &Arc<FrameTokens>, stamp_secs: f64) -> Result<Prediction> {
        Ok(Prediction { encoded: 0.0, ..self.push_encoded(tokens, stamp_secs)? })
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
        let side = self.whole().model.config().image;
        if input.len() != 3 * side * side {
            return Err(Error::shape("input", format!("[3, {side}, {side}]"), [input.len()]));
        }
        Ok(())
    }

    /// Predicts touch at the instant of an encoded image; the end of [`Predictor::push_prepared`].
    fn push_encoded(&mut self, encoded: &FrameTokens, stamp_secs: f64) -> Result<Prediction> {
        let (mut certainty, hands) = judge(&self.checkpoint, &encoded.encoded);
        let (restarted, steps) = (self.restarts_after(self.frames.stamps().last(), stamp_secs), self.steps());
        // A copy of the list (the tokens are shared) that replaces it only on success.
        let frames = if restarted { Frames::default() } else { self.frames.clone() };
        let frames = frames.with(stamp_secs, encoded.projected.clone(), steps);
        let (force, contact) = self.model().head_outputs(&frames.window(steps))?.first_step(self.metadata())?;
        let field = TactileField { topology: self.metadata().topology, force, contact };
        let field = self.finished(field, &mut certainty)?;
        let warming_up = frames.are_warming_up(steps);
        self.frames = frames;
        Ok(Prediction { stamp_secs, field, certainty, hands, warming_up, restarted, encoded: 1.0 })
    }

    /// Gives unknown touch its form, and carries a field over to MANO's vertices if there are any.
    fn finished(&self, mut field: TactileField, certainty: &mut Certainty) -> Result<TactileField> {
        self.unknown.apply(&mut field, certainty);
        match &self.mano {
            Some(mano) => field.carried(mano, Topology::Mano),
            None => Ok(field),
        }
    }

    fn steps(&self) -> Steps {
        Steps { horizon: self.config().horizon, frame_dt: self.metadata().frame_dt }
    }

    /// True if an image with this stamp starts a new stream behind one of the stamp `newest`, s; None = there is none.
    fn restarts_after(&self, newest: Option<f64>, stamp_secs: f64) -> bool {
        newest.is_none_or(|newest| {
            let step = stamp_secs - newest;
            step < 0.0 || step > self.max_gap_secs
        })
    }
}

/// Checks that a network can encode images in part.
fn check_focus(focus: &Focus, checkpoint: &Checkpoint, device: &Device) -> Result<()> {
    let refused = |expected: &str, got: &str| Err(Error::value("focus", expected, got));
    if !checkpoint.metadata.framing.is_whole() {
        return refused("none for a network that sees single hands, which are cut out of each picture", "a focus");
    }
    if checkpoint.presence.is_none() {
        return refused("a network that estimates keypoints (`egotac model presence`)", "one that does not");
    }
    if !device.is_cpu() {
        return refused("a network on the CPU", "one on a GPU");
    }
    focus.check(checkpoint.model.config().vision_depth)
}

/// Judges a frame by its tokens, `(P, dv)`.
fn judge(network: &Checkpoint, tokens: &[f32]) -> (Certainty, Option<[HandEstimate; 2]>) {
    let config = network.model.config();
    let feature = familiarity::features(tokens, config.tokens(), config.vision_width);
    let familiarity = network.familiarity.as_ref().map(|statistics| statistics.of(&feature));
    let hands = network.presence.as_ref().map(|weights| weights.of(tokens));
    let presence = hands.map_or([None; 2], |hands| hands.map(|hand| Some(hand.presence)));
    (network.metadata.doubt.judge(familiarity, presence), hands)
}
