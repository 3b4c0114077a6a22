//! Pictures as a predictor takes them, prepared on any thread.

use ::image::RgbImage;

use crate::error::{Error, Result};
use crate::image::{Framing, Preparation, Square};

/// Conversion of pictures to what a predictor takes.
#[derive(Debug, Clone, PartialEq)]
pub struct InputPreparation {
    /// Conversion of the whole picture: for the network, or for the locator of one that sees hands.
    pub whole: Preparation,
    /// Part of the world that the network sees.
    pub framing: Framing,
}

/// A picture that is prepared for a predictor.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Prepared {
    /// Whole picture, `(3, side, side)`.
    pub whole: Vec<f32>,
    /// The picture itself, for a network that sees hands, whose places are not known yet.
    pub picture: Option<RgbImage>,
    /// Squares around the left and the right hand, pixels, from a tracker that knows better than the locator; None = ask the locator.
    pub squares: [Option<Square>; 2],
}

impl InputPreparation {
    /// Prepares a picture.
    ///
    /// # Errors
    /// As [`Preparation::apply`].
    pub fn apply(&self, picture: &RgbImage) -> Result<Prepared> {
        let whole = self.whole.apply(picture)?;
        let picture = (!self.framing.is_whole()).then(|| picture.clone());
        Ok(Prepared { whole, picture, ..Prepared::default() })
    }

    /// Prepares pixels of another owner; see [`Preparation::apply_pixels`].
    ///
    /// # Errors
    /// As [`Preparation::apply_pixels`].
    pub fn apply_pixels(&self, pixels: &[u8], width: u32, height: u32) -> Result<Prepared> {
        let whole = self.whole.apply_pixels(pixels, width, height)?;
        let copy = || RgbImage::from_raw(width, height, pixels.to_vec());
        let picture = if self.framing.is_whole() { None } else { copy() };
        Ok(Prepared { whole, picture, ..Prepared::default() })
    }
}

impl Prepared {
    /// Returns the picture with squares around the left and the right hand that a tracker has found, pixels; None = not found, which
    /// leaves that hand to the locator.
    #[must_use]
    pub fn with_squares(mut self, squares: [Option<Square>; 2]) -> Self {
        self.squares = squares;
        self
    }

    /// Returns the picture for a network that sees hands.
    pub(super) fn picture(&self) -> Result<&RgbImage> {
        let missing = || Error::value("input", "a picture, from which hands are cut out", "the prepared whole alone");
        self.picture.as_ref().ok_or_else(missing)
    }
}

impl From<Vec<f32>> for Prepared {
    fn from(whole: Vec<f32>) -> Self {
        Self { whole, ..Self::default() }
    }
}
