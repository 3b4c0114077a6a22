//! What labelled data sets are put together from.

use std::path::{Path, PathBuf};

use super::journal::{Heads, Labels};
use super::summary::About;
use crate::error::Result;
use crate::hand::Topology;

/// A kind of labelled data set.
pub trait Output: Send + Sync {
    /// Puts the data set together at `at`, which will be renamed to `out`. What an earlier, killed attempt left at `at`
    /// may be used or replaced. Damage that is found in the input goes into the summary of `about`, and `about` into the
    /// output.
    ///
    /// # Errors
    /// If the input can't be read, the output can't be written, or the journals are not those of this input.
    fn assemble(&self, journals: &Journals, about: &mut About, at: &Path, out: &Path) -> Result<()>;

    /// Refuses fields of `topology` where the output could not take them: before the work, not after it.
    ///
    /// # Errors
    /// If the output would be no proper data set.
    fn check(&self, topology: Topology) -> Result<()> {
        let _ = topology;
        Ok(())
    }

    /// What the data set at `out` says about its labels; None if it says nothing.
    fn about(&self, out: &Path) -> Option<About>;
}

/// The finished journals of all units.
#[derive(Debug)]
pub struct Journals {
    folder: PathBuf,
    topology: Topology,
}

impl Journals {
    /// Those in `folder`, with fields of `topology`.
    pub fn new(folder: &Path, topology: Topology) -> Self {
        Self { folder: folder.to_path_buf(), topology }
    }

    /// Where the journal of unit `unit` lies.
    pub fn path(&self, unit: usize) -> PathBuf {
        self.folder.join(format!("{unit:06}.labels"))
    }

    /// What the fields' vertices mean.
    pub fn topology(&self) -> Topology {
        self.topology
    }

    /// Labels of unit `unit`, in the order of its images.
    ///
    /// # Errors
    /// If there is no such journal.
    pub fn labels(&self, unit: usize) -> Result<Labels> {
        Labels::open(&self.path(unit), self.topology)
    }

    /// What the blocks of unit `unit` say about their images, in order.
    ///
    /// # Errors
    /// If there is no such journal.
    pub fn heads(&self, unit: usize) -> Result<Heads> {
        Heads::open(&self.path(unit))
    }
}
