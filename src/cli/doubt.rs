//! Options of commands that run a network: its view of pictures, and touch that it does not know.

use std::path::PathBuf;

use super::options;
use crate::model::predictor::Options;
use crate::model::{Unknown, View};

/// View of pictures, and rule for touch that is unknown.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Unknown touch")]
pub struct Doubt {
    /// View of pictures: crop (the centre), letterbox (all of it, hands smaller), squash (all of it, squeezed), or checkpoint (as
    /// the network was trained).
    #[arg(long, value_name = "VIEW", default_value = "checkpoint")]
    view: View,
    /// Network of whole pictures that finds the hands, for a network that sees single hands [default: the one shipped with egotac].
    #[arg(long, value_name = "FILE|shipped", value_parser = options::checkpoint())]
    locator: Option<PathBuf>,
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
    /// Returns predictor options with this view and this rule.
    pub fn apply(&self, options: Options) -> Options {
        Options {
            view: self.view,
            locator: self.locator.clone(),
            unknown: self.unknown,
            familiarity_threshold: self.familiarity_threshold,
            presence_threshold: self.presence_threshold,
            ..options
        }
    }
}
