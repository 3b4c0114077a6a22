//! The folder of an unfinished labelling, beside the output.

use std::fs;
use std::fs::File;
use std::path::{Path, PathBuf};

use super::journal::{Journal, Progress};
use super::output::Journals;
use super::provenance::Provenance;
use super::source::Unit;
use crate::error::{Error, Result};
use crate::file;

/// Journals of the units of one output, and the output while it is put together.
#[derive(Debug)]
pub struct Work {
    folder: PathBuf,
    journals: Journals,
}

impl Work {
    /// The folder for the output `out`: new, or as an earlier process left it.
    ///
    /// # Errors
    /// If it was left by a labelling of another input or with other settings, or can't be written.
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
        let journals = Journals::new(&folder, provenance.topology);
        Ok(Self { folder, journals })
    }

    /// The journals.
    pub fn journals(&self) -> &Journals {
        &self.journals
    }

    /// The journal of one unit; None = another process is at it.
    ///
    /// # Errors
    /// If it can't be read or written.
    pub fn journal(&self, unit: usize) -> Result<Option<Journal>> {
        Journal::open(&self.journals.path(unit))
    }

    /// Whether units `0..n` are all labelled to their ends.
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

    /// Where the work on one unit stands, whoever does it.
    ///
    /// # Errors
    /// If its journal can't be read.
    pub fn progress(&self, unit: usize) -> Result<Progress> {
        let path = self.journals.path(unit);
        if path.exists() { Progress::read(&path) } else { Ok(Progress::default()) }
    }

    /// Where the output is put together.
    pub fn unfinished(&self) -> PathBuf {
        self.folder.join("output")
    }

    /// Lets no other process put the output together; None = one is at it.
    ///
    /// # Errors
    /// If the lock can't be written.
    pub fn lock(&self) -> Result<Option<File>> {
        let path = self.folder.join("lock");
        let file = File::create(&path).map_err(Error::io(&path))?;
        Ok(file::lock(&file).then_some(file))
    }

    /// Gives the output its name and removes the folder.
    ///
    /// # Errors
    /// If `out` has come to exist, or can't be written.
    pub fn publish(self, out: &Path) -> Result<()> {
        if out.exists() {
            return Err(Error::file(out, "has come to exist meanwhile"));
        }
        fs::rename(self.unfinished(), out).map_err(Error::io(out))?;
        fs::remove_dir_all(&self.folder).map_err(Error::io(&self.folder))
    }
}

/// Where the work on `out` lies: a hidden folder beside it.
pub fn folder_of(out: &Path) -> Result<PathBuf> {
    let (Some(name), Some(parent)) = (out.file_name(), out.parent()) else {
        return Err(Error::file(out, "is not a name for an output"));
    };
    Ok(parent.join(format!(".{}.unfinished", name.to_string_lossy())))
}
