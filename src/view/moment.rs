//! All that is shown of one image.

use ::image::RgbImage;

use super::projection::Sight;
use crate::hand::{HandParams, Side, Topology};
use crate::model::Prediction;
use crate::tactile::{N_FIELD, TactileField};

/// All that is shown of one image.
#[derive(Debug, Clone)]
pub struct Moment {
    /// Index of the image in its source.
    pub frame: usize,
    /// Index of the episode.
    pub episode: usize,
    /// Time of the image, s.
    pub stamp_secs: f64,
    /// The image, or the reason why it can't be shown.
    pub image: std::result::Result<RgbImage, String>,
    /// Labelled or predicted touch; NaN = unknown.
    pub touch: TactileField,
    /// True touch; NaN = unknown, None = the source has no truth.
    pub truth: Option<TactileField>,
    /// Likeness of the image to those of the network's training, 0 to 1; None = not estimated.
    pub familiarity: Option<f32>,
    /// Presence of the left and the right hand, 0 to 1; None = not estimated.
    pub presence: [Option<f32>; 2],
    /// Reason why touch of a hand is not known; empty = it is known, or nobody says.
    pub reason: String,
    /// True if the network's window was not full yet.
    pub warming_up: bool,
    /// Parameters of the left and the right hand; None = unknown.
    pub hands: [Option<HandParams>; 2],
    /// The camera's sight of the hands; None = unknown.
    pub sight: Option<Sight>,
}

impl Moment {
    /// Creates a moment whose touch is unknown.
    pub fn unknown(frame: usize, episode: usize, stamp_secs: f64, touch: TactileField) -> Self {
        Self {
            frame,
            episode,
            stamp_secs,
            image: Err("no image".into()),
            touch,
            truth: None,
            familiarity: None,
            presence: [None; 2],
            reason: String::new(),
            warming_up: false,
            hands: [None, None],
            sight: None,
        }
    }

    /// Takes over a network's prediction for the image.
    pub fn predicted(&mut self, prediction: Prediction) {
        let Prediction { field, certainty, warming_up, .. } = prediction;
        self.reason = certainty.reason();
        (self.touch, self.warming_up) = (field, warming_up);
        (self.familiarity, self.presence) = (certainty.familiarity, certainty.presence);
    }
}

/// Creates a field of which nothing is known.
pub(super) fn unknown_field(topology: Topology) -> TactileField {
    TactileField { topology, force: vec![f32::NAN; N_FIELD], contact: vec![f32::NAN; N_FIELD] }
}

/// Returns the total force of both hands, N; None = unknown.
pub(super) fn totals(field: &TactileField) -> [Option<f32>; 2] {
    Side::BOTH.map(|side| known(field.total_force(side)))
}

/// Returns None for a value that is not known.
pub(super) fn known(value: f32) -> Option<f32> {
    value.is_finite().then_some(value)
}
