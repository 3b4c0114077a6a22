//! Report on a labelled data set, one self-contained HTML page: `egotac report`.

mod frames;
mod page;
mod regions;
mod samples;
mod trace;

use std::path::Path;

use crate::dataset::{Labelled, format::open_images};
use crate::error::Result;
use crate::hand::{HandModel, Side, Topology};
use crate::score::metrics::{self, EvalOptions, Metrics, baseline};
use crate::tactile::TactileSequence;

pub use page::page;
pub use regions::{RegionRow, region_rows};
pub(crate) use samples::scale;
pub use samples::{Sample, samples};
pub(crate) use trace::totals;
pub use trace::{Trace, traces};

/// Content of the page.
#[derive(Debug, Clone)]
pub struct PageSettings {
    /// Number of sample frames.
    pub frames: usize,
    /// Largest number of episodes whose total force is plotted.
    pub episodes: usize,
    /// Hands to draw the labels on; None = the built-in hands.
    pub hands: Option<[HandModel; 2]>,
}

/// Returns the page about the labels at `path`.
///
/// # Errors
/// If the labels or their images can't be read, or the hands are on another topology.
pub fn html(path: &Path, settings: &PageSettings) -> Result<String> {
    let labelled = Labelled::read(path)?;
    let hands = hands_of(settings.hands.as_ref(), labelled.labels.topology)?;
    let images = open_images(path, labelled.info.as_ref());
    let samples = samples(&labelled, images.as_deref(), hands.as_ref(), settings.frames)?;
    let scores = match &labelled.truth {
        Some(truth) => scores(&labelled.labels, truth)?,
        None => Vec::new(),
    };
    let rows = hands.as_ref().map(|hands| region_rows(&labelled, hands)).unwrap_or_default();
    Ok(page(path, &labelled, &samples, &traces(&labelled, settings.episodes), &rows, &scores))
}

/// Returns the hands on which labels of `topology` are drawn: `files`, or else the built-in ones; None if the labels need files.
///
/// # Errors
/// If the files are on another topology.
pub(crate) fn hands_of(files: Option<&[HandModel; 2]>, topology: Option<Topology>) -> Result<Option<[HandModel; 2]>> {
    match (files, topology) {
        (Some(hands), topology) => {
            let topology = topology.unwrap_or_default();
            hands.iter().try_for_each(|hand| topology.must_match(hand.topology))?;
            Ok(Some(hands.clone()))
        }
        (None, Some(Topology::Mano)) => Ok(None),
        (None, _) => Ok(Some(Side::BOTH.map(HandModel::builtin))),
    }
}

/// Scores the labels, and beside them no touch at all and the truth of the frame before.
fn scores(labels: &TactileSequence, truth: &TactileSequence) -> Result<Vec<(&'static str, Metrics)>> {
    let zero = baseline::zero().sequence(truth.n_frames());
    let persistence = baseline::persistence(truth, None);
    let fields = [("labels against truth", labels), ("zero", &zero), ("persistence", &persistence)];
    let score = |fields: &TactileSequence| metrics::evaluate(fields, truth, &EvalOptions::default());
    fields.into_iter().map(|(name, fields)| score(fields).map(|scores| (name, scores))).collect()
}
