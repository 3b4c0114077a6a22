//! Files that appear when they are complete.

use std::path::{Path, PathBuf};

use crate::error::{Error, Result};

/// Makes a file at `path`: `write` writes it somewhere in the folder that it is given, and returns where, and the number of images
/// in it. Folders above `path` are created. Returns the number of images.
///
/// # Errors
/// If `write` fails, there is no image, or the file can't be moved to `path`.
pub(super) fn publish(path: &Path, write: impl FnOnce(&Path) -> Result<(PathBuf, usize)>) -> Result<usize> {
    let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(Error::io(folder))?;
    let unfinished = tempfile::Builder::new().prefix(".egotac-view-").tempdir_in(folder).map_err(Error::io(folder))?;
    let (file, frames) = write(unfinished.path())?;
    if frames == 0 {
        return Err(Error::file(path, "would be empty: the recording has no image"));
    }
    std::fs::rename(&file, path).map_err(Error::io(path))?;
    Ok(frames)
}
