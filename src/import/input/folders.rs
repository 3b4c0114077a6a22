//! Folders of data sets, listed in order.

use std::path::{Path, PathBuf};

use crate::dataset::base_name;
use crate::dataset::image_folder::natural;
use crate::error::{Error, Result};
use crate::file::input::InputFolder;

/// Returns the folders directly in `folder`, in natural order; none if `folder` does not exist.
///
/// # Errors
/// If it can't be listed, or a link leads out of it.
pub fn folders(folder: &Path) -> Result<Vec<PathBuf>> {
    list(folder, Path::is_dir)
}

/// Returns the files directly in `folder` whose names end in `ending`, in natural order; none if `folder` does not exist.
///
/// # Errors
/// If it can't be listed, or a link leads out of it.
pub fn files(folder: &Path, ending: &str) -> Result<Vec<PathBuf>> {
    list(folder, |path| path.is_file() && base_name(path).ends_with(ending))
}

/// Returns the files of `wanted` names in `folder` and in folders down to `depth` levels below it, level by level; `folder` itself
/// if it is a file.
///
/// # Errors
/// As [`files`].
pub fn files_below(folder: &Path, depth: usize, wanted: impl Fn(&str) -> bool) -> Result<Vec<PathBuf>> {
    if folder.is_file() {
        return Ok(vec![folder.to_path_buf()]);
    }
    let (mut found, mut level) = (Vec::new(), vec![folder.to_path_buf()]);
    for _ in 0..=depth {
        for folder in &level {
            found.extend(files(folder, "")?.into_iter().filter(|path| wanted(&base_name(path))));
        }
        level = level.iter().map(|folder| folders(folder)).collect::<Result<Vec<_>>>()?.concat();
    }
    Ok(found)
}

/// Returns the first of `names` that is a folder or file in `root`.
pub fn first_of(root: &Path, names: &[&str]) -> Option<PathBuf> {
    names.iter().map(|name| root.join(name)).find(|path| path.exists())
}

/// Returns the number at the end of a file's name without its extension, such as 12 of `color_0012.jpeg`.
pub fn number(path: &Path) -> Option<usize> {
    let stem = path.file_stem()?.to_string_lossy();
    let digits = stem.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    stem[digits..].parse().ok()
}

fn list(folder: &Path, wanted: impl Fn(&Path) -> bool) -> Result<Vec<PathBuf>> {
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let root = InputFolder::open(folder)?;
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(Error::io(folder))? {
        let path = entry.map_err(Error::io(folder))?.path();
        if !base_name(&path).starts_with('.') && wanted(&path) {
            root.check(&path)?;
            found.push(path);
        }
    }
    found.sort_by(|a, b| natural(&a.to_string_lossy(), &b.to_string_lossy()));
    Ok(found)
}
