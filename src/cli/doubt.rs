//! Options of commands that run a network: touch that it does not know.

use crate::model::Unknown;
use crate::model::predictor::Options;

/// Rule for touch that is unknown.
#[derive(Debug, clap::Args)]
pub struct Doubt {
    /// Form of touch that the network does not know, because the image is unlike those of its training or the hand is not in
    /// it: nan (mask 0), zero (mask 0), or guess (the network's output as it is, mask 1).
    #[arg(long, value_name = "FORM", default_value = "nan")]
    unknown: Unknown,
    /// Familiarity of an image below which touch is unknown, 0 to 1 [default: the checkpoint's].
    #[arg(long, value_name = "SHARE")]
    familiarity_threshold: Option<f32>,
    /// Presence of a hand below which its touch is unknown, 0 to 1 [default: the checkpoint's].
    #[arg(long, value_name = "PROBABILITY")]
    presence_threshold: Option<f32>,
}

impl Doubt {
    /// Returns predictor options with this rule.
    pub fn apply(&self, options: Options) -> Options {
        Options {
            unknown: self.unknown,
            familiarity_threshold: self.familiarity_threshold,
            presence_threshold: self.presence_threshold,
            ..options
        }
    }
}
