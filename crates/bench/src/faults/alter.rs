//! Changes of files from outside, while a command runs or between two runs.

use std::fs;
use std::path::Path;

use egotac::dataset::copy_folder;
use egotac::error::{Error, Result};

use super::content;

/// Removes everything in a folder; the folder stays, as a disk may be mounted there.
///
/// # Errors
/// If a file can't be read or removed.
pub fn clear(folder: &Path) -> Result<()> {
    for entry in fs::read_dir(folder).map_err(Error::io(folder))? {
        let path = entry.map_err(Error::io(folder))?.path();
        let is_folder = path.is_dir() && !path.is_symlink();
        let removed = if is_folder { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
        removed.map_err(Error::io(&path))?;
    }
    Ok(())
}

/// Copies a file or folder over `to`, with the times of the original.
///
/// # Errors
/// If a file can't be read or written.
pub fn restore(from: &Path, to: &Path) -> Result<()> {
    if from.is_file() {
        let parent = to.parent().unwrap_or(to);
        fs::create_dir_all(parent).map_err(Error::io(parent))?;
        fs::copy(from, to).map_err(Error::io(to))?;
    } else {
        if to.exists() {
            fs::remove_dir_all(to).map_err(Error::io(to))?;
        }
        copy_folder(from, to, false)?;
    }
    for name in content::files(from)?.keys() {
        let [from, to] = [from, to].map(|path| if name.as_os_str().is_empty() { path.into() } else { path.join(name) });
        let times = fs::metadata(&from).and_then(|metadata| metadata.modified()).map_err(Error::io(&from))?;
        fs::File::options().write(true).open(&to).and_then(|file| file.set_modified(times)).map_err(Error::io(&to))?;
    }
    Ok(())
}

/// Cuts the largest file of an input in half.
///
/// # Errors
/// If a file can't be read or written.
pub fn cut(input: &Path) -> Result<()> {
    let files = content::files(input)?;
    let Some((name, bytes)) = files.iter().max_by_key(|(_, bytes)| bytes.len()) else { return Ok(()) };
    let path = if name.as_os_str().is_empty() { input.to_path_buf() } else { input.join(name) };
    let file = fs::File::options().write(true).open(&path).map_err(Error::io(&path))?;
    file.set_len(bytes.len() as u64 / 2).map_err(Error::io(&path))
}
