//! Labels of a source, and the outputs that hold them.

use std::path::Path;

use super::label_frame::LabelFrame;
use super::label_info::LabelInfo;
use crate::error::{Error, Result};
use crate::hand::Topology;

/// Labels of all units of a source, complete and on disk; an output reads them unit by unit, as often as it needs.
pub trait SourceLabels: Send + Sync {
    /// Returns the vertex numbering of the fields.
    fn topology(&self) -> Topology;

    /// Returns the labels of unit `unit` in the order of its images.
    ///
    /// # Errors
    /// If they can't be read.
    fn labels(&self, unit: usize) -> Result<LabelFrames<'_>>;

    /// Returns the source's notes of unit `unit` in order, without reading the fields.
    ///
    /// # Errors
    /// If they can't be read.
    fn notes(&self, unit: usize) -> Result<Notes<'_>>;
}

/// Labels in order.
pub type LabelFrames<'a> = Box<dyn Iterator<Item = Result<LabelFrame>> + Send + 'a>;

/// Notes in order.
pub type Notes<'a> = Box<dyn Iterator<Item = Result<String>> + Send + 'a>;

/// Returns the next label; an error if the source has more images than labels.
///
/// # Errors
/// If there is no further label for unit `unit`, or it can't be read.
pub(super) fn next_label(labels: &mut dyn Iterator<Item = Result<LabelFrame>>, unit: &str) -> Result<LabelFrame> {
    let label = labels.next().transpose()?;
    label.ok_or_else(|| Error::value(unit, "the images that were labelled", "more images"))
}

/// A data set that holds labels.
pub trait LabelOutput: Send + Sync {
    /// Writes the data set to `at`, which the caller then renames to `out`. The method may reuse or replace files that an
    /// earlier, killed attempt left at `at`. It adds damage found in the input to the summary of `info`, and writes `info`
    /// into the output.
    ///
    /// # Errors
    /// If the input can't be read, the output can't be written, or the labels belong to another input.
    fn assemble(&self, labels: &dyn SourceLabels, info: &mut LabelInfo, at: &Path, out: &Path) -> Result<()>;

    /// Checks that the output can hold fields of `topology`. The check runs before inference, so that no work is lost.
    ///
    /// # Errors
    /// If the output would be invalid.
    fn check(&self, topology: Topology) -> Result<()> {
        let _ = topology;
        Ok(())
    }

    /// True if the output can hold keypoints of the hands.
    fn holds_keypoints(&self) -> bool {
        true
    }

    /// Reads the description of the labels in the data set at `out`; None without one.
    fn info(&self, out: &Path) -> Option<LabelInfo>;
}
