//! View of a network: the part of a picture that it gets.

use std::fmt;
use std::str::FromStr;

use crate::error::{Error, Result};
use crate::image::Resize;

/// Conversion of pictures to the network's square input.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum View {
    /// That of the checkpoint, which the network was trained with.
    #[default]
    Checkpoint,
    /// The centre of the picture: what lies beside it is not seen.
    Crop,
    /// The whole picture with black bars: hands are smaller.
    Letterbox,
    /// The whole picture, squeezed: hands change their proportions.
    Squash,
}

impl View {
    /// All views.
    pub const ALL: [View; 4] = [View::Checkpoint, View::Crop, View::Letterbox, View::Squash];
    /// Names of the views, for options.
    pub const NAMES: [&'static str; 4] = ["checkpoint", "crop", "letterbox", "squash"];

    /// Name: `checkpoint`, `crop`, `letterbox` or `squash`.
    pub fn name(self) -> &'static str {
        Self::NAMES[self as usize]
    }

    /// Returns the conversion; None = that of the checkpoint.
    pub fn resize(self) -> Option<Resize> {
        match self {
            View::Checkpoint => None,
            View::Crop => Some(Resize::Crop),
            View::Letterbox => Some(Resize::Letterbox),
            View::Squash => Some(Resize::Squash),
        }
    }
}

impl fmt::Display for View {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for View {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let found = Self::ALL.into_iter().find(|view| view.name() == name);
        found.ok_or_else(|| Error::unknown("view", name, Self::NAMES))
    }
}
