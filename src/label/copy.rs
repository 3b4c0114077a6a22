//! Copies of files into an output that is being put together; an attempt that was killed goes on.

use std::fs;
use std::fs::File;
use std::path::Path;

use crate::error::{Error, Result};

/// Copies the folder `from` into `to`. A file that is there already stays: if `partly`, only one that is as long, for the
/// copy of before; otherwise any, for what was written anew.
///
/// # Errors
/// If something can't be read or written.
pub fn copy_folder(from: &Path, to: &Path, partly: bool) -> Result<()> {
    fs::create_dir_all(to).map_err(Error::io(to))?;
    for entry in fs::read_dir(from).map_err(Error::io(from))? {
        let entry = entry.map_err(Error::io(from))?;
        let (source, path) = (entry.path(), to.join(entry.file_name()));
        let metadata = fs::metadata(&source).map_err(Error::io(&source))?;
        if metadata.is_dir() {
            copy_folder(&source, &path, partly)?;
        } else if partly || !path.exists() {
            copy_file(&path, metadata.len(), |file| std::io::copy(&mut File::open(&source)?, file))?;
        }
    }
    Ok(())
}

/// Writes `path` unless it is there with its size; under another name until it is whole.
///
/// # Errors
/// If `write` fails, or the file can't be written.
pub(super) fn copy_file(path: &Path, size: u64, write: impl FnOnce(&mut File) -> std::io::Result<u64>) -> Result<()> {
    if path.metadata().is_ok_and(|there| there.is_file() && there.len() == size) {
        return Ok(());
    }
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(Error::io(folder))?;
    }
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    let mut file = File::create(&partial).map_err(Error::io(&partial))?;
    if let Err(error) = write(&mut file) {
        // What was written is of no use; the first error says more than one about the removal.
        let _ = fs::remove_file(&partial);
        return Err(Error::io(path)(error));
    }
    fs::rename(&partial, path).map_err(Error::io(path))
}
