//! The hidden folder of an unfinished job, beside its output.

use std::fs;
use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::journal::{Journal, JournalHeads, JournalLabels, Progress};
use crate::dataset::copy::remove;
use crate::dataset::labels::{LabelFrames, Notes};
use crate::dataset::{InputState, Provenance, SourceLabels, Unit};
use crate::error::{Error, Result};
use crate::file::turn::turn;
use crate::file::{self, input, limits};
use crate::hand::Topology;

/// End of the workspace's name.
const UNFINISHED: &str = "unfinished";
/// End of the workspace's name while it is removed.
const FINISHED: &str = "finished";
/// File that says whose labels the journals hold; every workspace has it.
const DESCRIPTION: &str = "job.json";
/// Difference of a workspace whose description can't be read.
const OLD: &str = "was left by another version of egotac; finish it with that one";

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
    /// If it belongs to another input or other settings, the input has changed since, or it can't be written.
    pub fn open(out: &Path, provenance: &Provenance, input: &InputState, units: &[Unit]) -> Result<Self> {
        let folder = hidden(out, UNFINISHED)?;
        remove(&hidden(out, FINISHED)?)?;
        turn();
        fs::create_dir_all(&folder).map_err(Error::io(&folder))?;
        let units = units.iter().map(|unit| (unit.name.clone(), unit.frames)).collect();
        let description = JobDescription { provenance: provenance.clone(), input: input.clone(), units };
        let json = serde_json::to_string_pretty(&description).map_err(|e| Error::file(&folder, e))?;
        let job = folder.join(DESCRIPTION);
        turn();
        if job.try_exists().map_err(Error::io(&job))? {
            let read = |json: &str| serde_json::from_str::<JobDescription>(json);
            // Compare both as read: a number may change in its last digit on the way.
            let there = read(&input::read_text(&job, limits::TEXT)?).map_err(|_| ());
            let here = read(&json).map_err(|e| Error::file(&folder, e))?;
            if let Some(difference) = there.map_or(Some(OLD.into()), |there| there.difference(&here)) {
                return Err(Error::file(&folder, format!("{difference}, or remove {}", folder.display())));
            }
        } else {
            file::write(&job, json.as_bytes())?;
        }
        Ok(Self { folder, topology: provenance.topology })
    }

    /// Removes what a process left that was killed between publishing `out` and its clean-up. A workspace that another
    /// process is about to remove itself stays.
    ///
    /// # Errors
    /// If it can't be removed.
    pub fn remove_leftovers(out: &Path) -> Result<()> {
        let folder = hidden(out, UNFINISHED)?;
        if folder.exists() {
            let workspace = Self { folder, topology: Topology::default() };
            match workspace.lock() {
                Ok(Some(_lock)) => workspace.remove(out)?,
                Ok(None) => {}
                // Another process has removed it meanwhile.
                Err(Error::Io { source, .. }) if source.kind() == ErrorKind::NotFound => {}
                Err(error) => return Err(error),
            }
        }
        remove(&hidden(out, FINISHED)?)
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
        turn();
        let exists = path.try_exists().map_err(Error::io(&path))?;
        if exists { Progress::read(&path) } else { Ok(Progress::default()) }
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
        turn();
        let file = File::create(&path).map_err(Error::io(&path))?;
        Ok(file::lock(&file).then_some(file))
    }

    /// Renames the assembled output to `out`, durably, and removes the workspace.
    ///
    /// # Errors
    /// If another process created `out`, the workspace was moved away or removed meanwhile, or `out` can't be written.
    pub fn publish(self, out: &Path) -> Result<()> {
        let unfinished = self.unfinished();
        match unfinished.is_dir() {
            true => file::sync_tree(&unfinished)?,
            false => File::open(&unfinished).and_then(|file| file.sync_all()).map_err(Error::io(&unfinished))?,
        }
        turn();
        if out.exists() {
            return Err(Error::file(out, "was created by another process"));
        }
        // Writers create missing folders: of a workspace that was moved away they may have written the rest of an output alone.
        let description = self.folder.join(DESCRIPTION);
        if !description.try_exists().map_err(Error::io(&description))? {
            return Err(Error::file(
                &self.folder,
                "was moved or removed while the output was written; run the command again",
            ));
        }
        file::rename(&unfinished, out)?;
        self.remove(out)
    }

    /// Removes the workspace. A rename takes it away as a whole first: of a workspace that is removed file by file, a kill
    /// could leave journals without the description of their input.
    fn remove(&self, out: &Path) -> Result<()> {
        let finished = hidden(out, FINISHED)?;
        remove(&finished)?;
        turn();
        match fs::rename(&self.folder, &finished) {
            // Another process has taken it away.
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            renamed => renamed.map_err(Error::io(&self.folder))?,
        }
        remove(&finished)
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

/// Content of `job.json`: whose labels the journals hold.
#[derive(Debug, Serialize, Deserialize)]
struct JobDescription {
    provenance: Provenance,
    input: InputState,
    /// Name and number of images of each unit.
    units: Vec<(String, Option<usize>)>,
}

impl JobDescription {
    /// Returns why the labels of this job can't be used for `other`, and how they can be; None if they can.
    fn difference(&self, other: &Self) -> Option<String> {
        if self.input.is_same(&other.input) && self.provenance == other.provenance && self.units == other.units {
            return None;
        }
        let same_name = self.provenance.source.first() == other.provenance.source.first();
        Some(match (self.input.is_same(&other.input), same_name && self.input.places == other.input.places) {
            (false, true) => format!(
                "holds unfinished labels of {} as it was before it changed; put that back",
                self.provenance.input_text()
            ),
            (false, false) => format!(
                "holds unfinished labels of another input, {} at {}, not of {}; finish those, choose another output",
                self.provenance.input_text(),
                self.input.place(),
                other.provenance.input_text()
            ),
            (true, _) => format!(
                "holds unfinished labels of {} with another name or other settings; finish them with those, choose \
                 another output",
                self.provenance.input_text()
            ),
        })
    }
}

/// True if `out` has a workspace.
///
/// # Errors
/// If `out` is not a name for an output.
pub fn exists(out: &Path) -> Result<bool> {
    Ok(hidden(out, UNFINISHED)?.exists())
}

/// Returns the path of a hidden folder beside `out`.
fn hidden(out: &Path, end: &str) -> Result<PathBuf> {
    let (Some(name), Some(parent)) = (out.file_name(), out.parent()) else {
        return Err(Error::file(out, "is not a name for an output"));
    };
    Ok(parent.join(format!(".{}.{end}", name.to_string_lossy())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_output_whose_workspace_was_moved_away_is_not_published() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("a.zarr");
        let workspace =
            || Workspace { folder: folder.path().join(".a.zarr.unfinished"), topology: Topology::default() };
        let description = workspace().folder.join(DESCRIPTION);
        fs::create_dir_all(workspace().unfinished()).unwrap(); // what a writer creates anew
        let error = workspace().publish(&out).unwrap_err().to_string();
        assert!(error.contains("was moved or removed") && !out.exists(), "{error}");
        fs::write(description, "{}").unwrap();
        workspace().publish(&out).unwrap();
        assert!(out.is_dir() && !workspace().folder.exists());
    }
}
