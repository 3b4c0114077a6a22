//! Labels read back from any format, with truth beside them.

use std::path::Path;

use super::format::Format;
use super::label_info::LabelInfo;
use super::{lerobot, mcap, tensors, zarr};
use crate::error::{Error, Result};
use crate::tactile::TactileSequence;

/// Labels of a data set, all in memory.
#[derive(Debug, Clone)]
pub struct Labelled {
    /// The labels, with timestamps and episodes of their frames.
    pub labels: TactileSequence,
    /// Truth for the same frames; None if the data set has none beside the labels.
    pub truth: Option<TactileSequence>,
    /// Description of the labels; None if they were not written by egotac.
    pub info: Option<LabelInfo>,
}

impl Labelled {
    /// Reads the labels at `path`: a store, a bag or an MCAP file, a LeRobot data set, or a tensor file.
    ///
    /// # Errors
    /// If there are none, or they can't be read.
    pub fn read(path: &Path) -> Result<Self> {
        let labelled = match Format::of(path) {
            Some(Format::Store) => zarr::read_labelled(path),
            Some(Format::Bag) => mcap::read_labelled(path),
            Some(Format::LeRobot) => lerobot::read_labelled(path),
            Some(Format::Tensors) => tensors::read_labelled(path),
            _ => {
                Err(Error::file(path, "holds no labels: expected a store, a bag, a LeRobot data set or a tensor file"))
            }
        }?;
        for sequence in [Some(&labelled.labels), labelled.truth.as_ref()].into_iter().flatten() {
            sequence.check().map_err(|error| Error::file(path, error))?;
        }
        Ok(labelled)
    }
}
