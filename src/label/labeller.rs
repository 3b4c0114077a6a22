//! Makers of labels, and the time that they take.

use super::journal::Journal;
use crate::dataset::ImageSource;
use crate::error::Result;

/// Maker of labels: a network, or the geometry of hands and objects.
pub trait Labeller {
    /// Labels the images of unit `unit` of `source` that `journal` lacks; calls `progress` after every image. An image without
    /// a label gets the reason in its place.
    ///
    /// # Errors
    /// If the unit can't be read to its end, or the journal can't be written. The journal then holds the labels of all images
    /// before the failure, and the next run goes on there.
    fn label_unit(
        &mut self,
        source: &dyn ImageSource,
        unit: usize,
        journal: &mut Journal,
        progress: &mut dyn FnMut(),
    ) -> Result<InferenceTiming>;
}

/// Parts of the inference time, s.
#[derive(Debug, Clone, Copy, Default)]
pub struct InferenceTiming {
    /// Time in the network, s.
    pub network_secs: f64,
    /// Time of waiting for images, s.
    pub waiting_secs: f64,
    /// Time of writing the journal, s.
    pub journal_secs: f64,
}

impl InferenceTiming {
    /// Adds the times of another unit.
    pub(super) fn add(&mut self, other: &Self) {
        self.network_secs += other.network_secs;
        self.waiting_secs += other.waiting_secs;
        self.journal_secs += other.journal_secs;
    }
}
