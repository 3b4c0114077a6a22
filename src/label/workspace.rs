//! The hidden folder of an unfinished job, beside its output.

use std::fs;
use std::fs::File;
use std::path::{Path, PathBuf};

use super::journal::{Journal, JournalHeads, JournalLabels, Progress};
use crate::dataset::labels::{LabelFrames, Notes};
use crate::dataset::{Provenance, SourceLabels, Unit};
use crate::error::{Error, Result};
use crate::file;
use crate::hand::Topology;

/// Journals of the units of one output, and the output while it is assembled.
#[derive(Debug)]
pub struct Workspace {
    folder: PathBuf,
    topology: Topology,
}

impl Workspace {
    /// Opens the workspace of the output `out`, as an earlier process left it, or creates it.
    ///
    /// # Errors
    /// If it belongs to another input or other settings, or can't be written.
    pub fn open(out: &Path, provenance: &Provenance, units: &[Unit]) -> Result<Self> {
        let folder = folder_of(out)?;
        fs::create_dir_all(&folder).map_err(Error::io(&folder))?;
        let units: Vec<_> = units.iter().map(|unit| (&unit.name, unit.frames)).collect();
        let json = format!("{:#}\n", serde_json::json!({ "provenance": provenance, "units": units }));
        let job = folder.join("job.json");
        match fs::read_to_string(&job) {
            Ok(there) if there == json => {}
            Ok(_) => {
                let message = format!(
                    "holds an unfinished labelling of another input or with other settings; finish it with those, or remove {}",
                    folder.display()
                );
                return Err(Error::file(&folder, message));
            }
            Err(_) => file::write(&job, json.as_bytes())?,
        }
        Ok(Self { folder, topology: provenance.topology })
    }

    /// Locks the journal of one unit; None = another process holds it.
    ///
    /// # Errors
    /// If it can't be read or written.
    pub fn journal(&self, unit: usize) -> Result<Option<Journal>> {
        Journal::open(&self.journal_path(unit))
    }

    /// True if units `0..n` are all labelled to their ends.
    ///
    /// # Errors
    /// If a journal can't be read.
    pub fn is_complete(&self, n: usize) -> Result<bool> {
        for unit in 0..n {
            if !self.progress(unit)?.complete {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Returns the progress of one unit, which another process may be labelling.
    ///
    /// # Errors
    /// If its journal can't be read.
    pub fn progress(&self, unit: usize) -> Result<Progress> {
        let path = self.journal_path(unit);
        if path.exists() { Progress::read(&path) } else { Ok(Progress::default()) }
    }

    /// Returns the heads of the journal's blocks of one unit.
    ///
    /// # Errors
    /// If there is no such journal.
    pub fn heads(&self, unit: usize) -> Result<JournalHeads> {
        JournalHeads::open(&self.journal_path(unit))
    }

    /// Returns the path at which the output is assembled.
    pub fn unfinished(&self) -> PathBuf {
        self.folder.join("output")
    }

    /// Locks the assembly; None = another process assembles the output. The lock ends with the file.
    ///
    /// # Errors
    /// If the lock file can't be written.
    pub fn lock(&self) -> Result<Option<File>> {
        let path = self.folder.join("lock");
        let file = File::create(&path).map_err(Error::io(&path))?;
        Ok(file::lock(&file).then_some(file))
    }

    /// Renames the assembled output to `out` and removes the workspace.
    ///
    /// # Errors
    /// If another process created `out`, or it can't be written.
    pub fn publish(self, out: &Path) -> Result<()> {
        if out.exists() {
            return Err(Error::file(out, "was created by another process"));
        }
        fs::rename(self.unfinished(), out).map_err(Error::io(out))?;
        fs::remove_dir_all(&self.folder).map_err(Error::io(&self.folder))
    }

    fn journal_path(&self, unit: usize) -> PathBuf {
        self.folder.join(format!("{unit:06}.labels"))
    }
}

impl SourceLabels for Workspace {
    fn topology(&self) -> Topology {
        self.topology
    }

    fn labels(&self, unit: usize) -> Result<LabelFrames<'_>> {
        Ok(Box::new(JournalLabels::open(&self.journal_path(unit), self.topology)?))
    }

    fn notes(&self, unit: usize) -> Result<Notes<'_>> {
        let notes = self.heads(unit)?.flat_map(|head| match head {
            Ok(head) => head.notes.into_iter().map(Ok).collect(),
            Err(error) => vec![Err(error)],
        });
        Ok(Box::new(notes))
    }
}

/// Returns the workspace folder of `out`.
pub fn folder_of(out: &Path) -> Result<PathBuf> {
    let (Some(name), Some(parent)) = (out.file_name(), out.parent()) else {
        return Err(Error::file(out, "is not a name for an output"));
    };
    Ok(parent.join(format!(".{}.unfinished", name.to_string_lossy())))
}
