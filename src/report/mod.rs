//! One self-contained HTML page about a labelled data set: `egotac report`.

mod page;
mod regions;
mod samples;
mod trace;

use std::path::Path;

use crate::error::Result;
use crate::hand::{HandModel, Topology};
use crate::label::{Labelled, images_of};
use crate::score::metrics::{self, EvalOptions};

pub use page::page;
pub use regions::{RegionRow, region_rows};
pub use samples::{Sample, samples};
pub use trace::{Trace, traces};

/// What goes on the page.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Frames that are shown.
    pub frames: usize,
    /// Episodes whose traces are shown.
    pub episodes: usize,
    /// Hands to draw labels on that are not on the built-in one.
    pub hands: Option<[HandModel; 2]>,
}

/// Writes the page about the labels at `path`.
///
/// # Errors
/// If the labels or their images can't be read, or the hands are of another topology.
pub fn html(path: &Path, settings: &Settings) -> Result<String> {
    let labelled = Labelled::read(path)?;
    let builtin = || crate::hand::Side::BOTH.map(HandModel::builtin);
    let hands = match (&settings.hands, labelled.labels.topology) {
        (Some(hands), topology) => {
            let topology = topology.unwrap_or_default();
            hands.iter().try_for_each(|hand| topology.must_match(hand.topology))?;
            Some(hands.clone())
        }
        (None, Some(Topology::Mano)) => None,
        (None, _) => Some(builtin()),
    };
    let images = images_of(path, labelled.about.as_ref());
    let samples = samples(&labelled, images.as_deref(), hands.as_ref(), settings.frames)?;
    let report = match &labelled.truth {
        Some(truth) => Some(metrics::evaluate(&labelled.labels, truth, &EvalOptions::default())?),
        None => None,
    };
    let rows = hands.as_ref().map(|hands| region_rows(&labelled, hands)).unwrap_or_default();
    Ok(page(path, &labelled, &samples, &traces(&labelled, settings.episodes), &rows, report.as_ref()))
}
