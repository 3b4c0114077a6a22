//! Encoder work that is saved where no hand is: patches far from the hands of the last image keep their tokens.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::model::presence::HandEstimate;
use crate::model::stages::FrameTokens;

/// Which patches of an image the encoder computes anew.
///
/// All patches pass the first `after` layers. The others are passed only by the patches near the hands that the last image showed;
/// the tokens of the rest stay those of the last image. An image is encoded whole if the last one showed no hand, if nearly all
/// patches are near a hand, and after `every` images: a hand that enters beside one that is seen is noticed then.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Focus {
    /// Layers of the encoder that all patches pass.
    pub after: usize,
    /// Distance from the box around a hand's keypoints up to which patches are near, sides of a patch.
    pub reach: f32,
    /// Images from one that is encoded whole to the next, at least 1.
    pub every: usize,
}

/// Share of the patches from which on an image is encoded whole: little would be saved.
const NEARLY_ALL: f64 = 0.9;
/// Presence from which on a hand counts as seen.
const SEEN: f32 = 0.5;

impl Focus {
    /// Checks the numbers for a network of `layers` layers.
    ///
    /// # Errors
    /// If there are fewer layers, or a number is out of range.
    pub fn check(&self, layers: usize) -> Result<()> {
        if self.after > layers {
            return Err(Error::value("focus.after", format!("0 to {layers} layers"), self.after));
        }
        if !(self.reach >= 0.0 && self.reach.is_finite()) {
            return Err(Error::value("focus.reach", "sides of a patch, >= 0", self.reach));
        }
        if self.every == 0 {
            return Err(Error::value("focus.every", "1 or more images", self.every));
        }
        Ok(())
    }
}

/// Last image of a stream that is encoded in parts.
#[derive(Debug, Clone, Default)]
pub(super) struct Focused {
    focus: Option<Focus>,
    last: Option<Last>,
}

#[derive(Debug, Clone)]
struct Last {
    tokens: Arc<FrameTokens>,
    /// Patches near the hands; None = the next image is encoded whole.
    near: Option<Vec<usize>>,
    /// Images since one was encoded whole.
    since_whole: usize,
}

/// What the last image gives to one that is encoded in part.
pub(super) struct Before<'a> {
    /// Layers that all patches pass.
    pub after: usize,
    /// Patches near the hands, ascending.
    pub near: &'a [usize],
    /// Tokens of the image.
    pub tokens: &'a FrameTokens,
}

impl Focused {
    /// Creates the memory of a stream.
    pub fn new(focus: Option<Focus>) -> Self {
        Self { focus, last: None }
    }

    /// True if images are encoded in parts.
    pub fn is_on(&self) -> bool {
        self.focus.is_some()
    }

    /// Returns what the next image needs to be encoded in part; None if it is encoded whole.
    pub fn before(&self) -> Option<Before<'_>> {
        let (focus, last) = (self.focus.as_ref()?, self.last.as_ref()?);
        let near = last.near.as_deref().filter(|_| last.since_whole + 1 < focus.every)?;
        Some(Before { after: focus.after, near, tokens: &last.tokens })
    }

    /// Keeps an image, which was encoded `whole` or in part, with the hands that it shows; its patches form a square of `grid` x `grid`.
    pub fn keep(&mut self, tokens: &Arc<FrameTokens>, whole: bool, hands: Option<[HandEstimate; 2]>, grid: usize) {
        let Some(focus) = self.focus else { return };
        let since_whole = match &self.last {
            Some(last) if !whole => last.since_whole + 1,
            _ => 0,
        };
        let seen = hands.iter().flatten().filter(|hand| hand.presence >= SEEN);
        let boxes: Vec<[[f32; 2]; 2]> = seen.map(around).collect();
        self.last = Some(Last { tokens: Arc::clone(tokens), near: near(&boxes, focus.reach, grid), since_whole });
    }

    /// Forgets the last image.
    pub fn forget(&mut self) {
        self.last = None;
    }
}

/// Returns the corners of the box around the keypoints of a hand, as shares of the sides of the input.
fn around(hand: &HandEstimate) -> [[f32; 2]; 2] {
    let places = || hand.keypoints.iter().map(|keypoint| keypoint.place);
    let corner = |start: f32, of: fn(f32, f32) -> f32| {
        places().fold([start; 2], |corner, place| [of(corner[0], place[0]), of(corner[1], place[1])])
    };
    [corner(f32::INFINITY, f32::min), corner(f32::NEG_INFINITY, f32::max)]
}

/// Returns the patches of a square of `grid` x `grid` that lie within `reach` sides of a patch from a box; None if there is none, or
/// nearly all do.
fn near(boxes: &[[[f32; 2]; 2]], reach: f32, grid: usize) -> Option<Vec<usize>> {
    let within = |patch: &usize| {
        let centre = [patch % grid, patch / grid].map(|cell| cell as f32 + 0.5);
        boxes.iter().any(|[low, high]| {
            let side = grid as f32;
            (0..2).all(|axis| {
                let (low, high) = (low[axis] * side - reach - 0.5, high[axis] * side + reach + 0.5);
                (low..=high).contains(&centre[axis])
            })
        })
    };
    let near: Vec<usize> = (0..grid * grid).filter(within).collect();
    let few = (near.len() as f64) < NEARLY_ALL * (grid * grid) as f64;
    (few && !near.is_empty()).then_some(near)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patches_near_a_hand_are_those_around_its_box() {
        // A box in the middle of the patch in column 1, row 2, of 4 x 4.
        let small = [[0.3125, 0.5625], [0.4375, 0.6875]];
        assert_eq!(near(&[small], 0.0, 4), Some(vec![9]));
        assert_eq!(near(&[small], 1.0, 4), Some(vec![4, 5, 6, 8, 9, 10, 12, 13, 14]));
        let other = [[0.8, 0.1], [0.9, 0.2]];
        assert_eq!(near(&[small, other], 0.0, 4), Some(vec![3, 9]));
        assert_eq!(near(&[], 1.0, 4), None, "no hand is seen");
        assert_eq!(near(&[[[0.0; 2], [1.0; 2]]], 0.0, 4), None, "nearly all");
        assert_eq!(near(&[[[f32::NAN; 2]; 2]], 0.0, 4), None);
    }

    #[test]
    fn numbers_out_of_range_are_refused() {
        let good = Focus { after: 2, reach: 1.0, every: 5 };
        assert!(good.check(2).is_ok());
        for (bad, name) in [
            (Focus { after: 3, ..good }, "focus.after"),
            (Focus { reach: -1.0, ..good }, "focus.reach"),
            (Focus { reach: f32::NAN, ..good }, "focus.reach"),
            (Focus { every: 0, ..good }, "focus.every"),
        ] {
            assert!(bad.check(2).unwrap_err().to_string().contains(name));
        }
    }
}
