//! Networks that see one hand at a time: a locator finds the hands in the whole picture, and squares around them are cut out of it at
//! its full resolution.
//!
//! The locator is a network of whole pictures. It tells which hands are there, how familiar the picture is, and where the keypoints
//! lie. A left hand is mirrored, so that the network knows right hands alone.

use std::path::PathBuf;

use candle_core::Tensor;

use super::frames::Frames;
use super::{Options, Prediction, Predictor, Prepared, judge};
use crate::error::{Error, Result};
use crate::hand::Side;
use crate::image::{Preparation, Resize, Square};
use crate::model::{Checkpoint, HandEstimate, Unknown, shipped};
use crate::tactile::{Doubt, TactileField};

/// Share of the most confident keypoint's confidence from which on a keypoint tells where the hand is.
const CONFIDENT: f32 = 0.5;

/// Locator, and the frames of each hand.
#[derive(Debug, Clone)]
pub(super) struct Hands {
    pub locator: Checkpoint,
    /// Frames of the left and of the right hand.
    pub frames: [Frames; 2],
    /// Stamp of the newest picture, s.
    newest: Option<f64>,
}

impl Hands {
    /// Loads the locator: the file that the options name, or the shipped network.
    ///
    /// # Errors
    /// If it can't be loaded, does not estimate presence, or sees hands itself.
    pub fn load(options: &Options) -> Result<Self> {
        let path: PathBuf = options.locator.clone().map_or_else(shipped::path, Ok)?;
        let locator = Checkpoint::load_as(&path, &options.device, options.precision)?;
        let needed = "a network of whole pictures that estimates presence, to find the hands";
        match (locator.metadata.framing.is_whole(), &locator.presence) {
            (true, Some(_)) => Ok(Self { locator, frames: Default::default(), newest: None }),
            (false, _) => Err(Error::file(&path, format!("expected {needed}, got one of single hands"))),
            (true, None) => Err(Error::file(&path, format!("expected {needed}, got one without presence"))),
        }
    }

    /// Drops all frames.
    pub fn reset(&mut self) {
        self.frames.iter_mut().for_each(Frames::clear);
        self.newest = None;
    }
}

impl Predictor {
    /// Predicts touch from squares around the hands; hands whose touch is unknown are not looked at, unless a guess is wanted.
    pub(super) fn push_hands(&mut self, input: &Prepared, stamp_secs: f64) -> Result<Prediction> {
        let Some(hands) = &self.hands else {
            return Err(Error::value("network", "one that sees single hands", "one of whole pictures"));
        };
        let picture = input.picture()?;
        let side = hands.locator.model.config().image;
        let whole = Tensor::from_slice(&input.whole, (1, 3, side, side), &self.device)?;
        let encoded = hands.locator.model.frame_tokens(&whole)?.encoded;
        let (mut certainty, estimates) = judge(&hands.locator, &encoded);
        for (doubt, _) in certainty.doubt.iter_mut().zip(input.squares).filter(|(_, square)| square.is_some()) {
            // A tracker saw the hand.
            *doubt = doubt.filter(|doubt| *doubt != Doubt::Absent);
        }

        let restarted = self.restarts_after(hands.newest, stamp_secs);
        let mut frames = if restarted { Default::default() } else { hands.frames.clone() };
        let steps = self.steps();
        let mut field = TactileField::unknown(self.metadata().topology);
        let mut warming_up = false;
        for hand in Side::BOTH {
            let is_known = certainty.doubt[hand as usize].is_none() || self.unknown == Unknown::Guess;
            let Some(estimate) = estimates.filter(|_| is_known).map(|estimates| estimates[hand as usize]) else {
                continue;
            };
            let found = || square(&estimate, &hands.locator, picture.dimensions());
            let square = match input.squares[hand as usize].or_else(found) {
                Some(square) => square,
                None if self.unknown == Unknown::Guess => middle(picture.dimensions()),
                None => {
                    certainty.doubt[hand as usize] = Some(Doubt::Absent);
                    continue;
                }
            };
            let tokens = self.hand_tokens(&square.cut(picture, self.config().image as u32, hand == Side::Left)?)?;
            let frames = &mut frames[hand as usize];
            *frames = frames.since(stamp_secs - self.max_gap_secs).with(stamp_secs, tokens, steps);
            let (force, contact) = self.model().head_outputs(&frames.window(steps))?.first_step(self.metadata())?;
            field.force[hand.range()].copy_from_slice(&force[Side::Right.range()]);
            field.contact[hand.range()].copy_from_slice(&contact[Side::Right.range()]);
            warming_up |= frames.are_warming_up(steps);
        }
        let field = self.finished(field, &mut certainty)?;
        if let Some(hands) = &mut self.hands {
            (hands.frames, hands.newest) = (frames, Some(stamp_secs));
        }
        Ok(Prediction { stamp_secs, field, certainty, hands: estimates, warming_up, restarted, encoded: 1.0 })
    }

    /// Encodes the picture of one hand.
    fn hand_tokens(&self, picture: &::image::RgbImage) -> Result<Tensor> {
        let side = self.config().image;
        let preparation = Preparation { resize: Resize::Squash, ..self.metadata().preparation(self.config()) };
        let image = Tensor::from_vec(preparation.apply(picture)?, (1, 3, side, side), &self.device)?;
        Ok(self.model().frame_tokens(&image)?.projected)
    }
}

/// Returns the square around a hand that the locator has found in a picture of this width and height; None if it lies beyond an edge.
fn square(estimate: &HandEstimate, locator: &Checkpoint, (width, height): (u32, u32)) -> Option<Square> {
    let preparation = locator.metadata.preparation(locator.model.config());
    let most = estimate.keypoints.iter().map(|keypoint| keypoint.confidence).fold(0.0, f32::max);
    let sure = estimate.keypoints.iter().filter(|keypoint| keypoint.confidence >= CONFIDENT * most);
    let pixels = sure.map(|keypoint| keypoint.pixel(&preparation, width as usize, height as usize));
    Square::around_hand(pixels, width, height)
}

/// Returns the largest square in the middle of a picture of this width and height.
fn middle((width, height): (u32, u32)) -> Square {
    let [x, y] = [width, height].map(|side| 0.5 * f64::from(side));
    Square { centre: [x, y], half: x.min(y) }
}
