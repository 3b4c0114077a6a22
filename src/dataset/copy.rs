//! File copies into an unfinished output, which a later attempt can resume.

use std::fs;
use std::fs::File;
use std::path::Path;

use crate::error::{Error, Result};

/// Copies the folder `from` into `to`. With `resume`, the copy skips files of `to` that have the size of the original;
/// otherwise it skips every existing file, since the caller wrote those.
///
/// # Errors
/// If a file can't be read or written.
#[doc(hidden)]
pub fn copy_folder(from: &Path, to: &Path, resume: bool) -> Result<()> {
    fs::create_dir_all(to).map_err(Error::io(to))?;
    for entry in fs::read_dir(from).map_err(Error::io(from))? {
        let entry = entry.map_err(Error::io(from))?;
        let (source, path) = (entry.path(), to.join(entry.file_name()));
        let metadata = fs::metadata(&source).map_err(Error::io(&source))?;
        if metadata.is_dir() {
            copy_folder(&source, &path, resume)?;
        } else if resume || !path.exists() {
            copy_file(&path, metadata.len(), |file| std::io::copy(&mut File::open(&source)?, file))?;
        }
    }
    Ok(())
}

/// Writes `path` by way of a temporary name, unless it exists with `size` bytes.
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
        // Ignore a failed removal: the first error says more.
        let _ = fs::remove_file(&partial);
        return Err(Error::io(path)(error));
    }
    fs::rename(&partial, path).map_err(Error::io(path))
}

/// Removes a file or folder that an earlier, killed attempt left.
///
/// # Errors
/// If it can't be removed.
pub(super) fn remove(at: &Path) -> Result<()> {
    let removed = match at.symlink_metadata() {
        Ok(there) if there.is_dir() => fs::remove_dir_all(at),
        Ok(_) => fs::remove_file(at),
        Err(_) => Ok(()),
    };
    removed.map_err(Error::io(at))
}
