//! Touch that a policy is given.

use serde::{Deserialize, Serialize};

use super::senses::TOUCH;

/// Source of a policy's touch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Arm {
    /// None: zeros.
    Image,
    /// Touch that the shipped network predicts from the pictures.
    ImagePredictedTouch,
    /// The simulator's.
    ImageTrueTouch,
}

impl Arm {
    /// All arms; the others are compared with the first.
    pub const ALL: [Self; 3] = [Self::Image, Self::ImagePredictedTouch, Self::ImageTrueTouch];

    /// Returns the name in files and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Image => "image",
            Self::ImagePredictedTouch => "image_predicted_touch",
            Self::ImageTrueTouch => "image_true_touch",
        }
    }

    /// Returns the touch of this arm.
    pub fn touch<'a>(self, true_touch: &'a [f32], predicted_touch: &'a [f32]) -> &'a [f32] {
        match self {
            Self::Image => &[0.0; TOUCH],
            Self::ImagePredictedTouch => predicted_touch,
            Self::ImageTrueTouch => true_touch,
        }
    }
}
