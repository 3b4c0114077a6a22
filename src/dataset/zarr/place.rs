//! Locations of stores: folders, or folders within zip files.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use zarrs::filesystem::FilesystemStore;
use zarrs::storage::{ReadableListableStorageTraits, ReadableStorageTraits, StoreKey};
use zarrs_zip::ZipStorageAdapter;
use zip::ZipArchive;

use super::EPISODE_ENDS;
use crate::error::{Error, Result};
use crate::file::input;

/// Location of a store.
///
/// Zip files come in three layouts: one `NAME.zarr/` folder, the store at the file's root, or many `NAME.zarr/` folders.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct StoreLocation {
    /// Folder of the store, or the zip file.
    pub path: PathBuf,
    /// Folder within the zip file, ending in `/`, empty for its root; None = a folder of the file system.
    pub inside: Option<String>,
}

impl StoreLocation {
    /// Creates the location of a folder of the file system.
    pub fn folder(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into(), inside: None }
    }

    /// Finds all stores that `path` names, in order of their names: a store, a zip file with stores, or a folder of
    /// `*.zarr` and `*.zip`.
    ///
    /// # Errors
    /// If there is none, or a file can't be read.
    pub fn find(path: &Path) -> Result<Vec<Self>> {
        if is_store(path) {
            return Ok(vec![Self::folder(path)]);
        }
        if is_zip(path) {
            return in_zip(path);
        }
        let mut places = Vec::new();
        for entry in fs::read_dir(path).map_err(Error::io(path))? {
            let entry = entry.map_err(Error::io(path))?.path();
            if is_zip(&entry) {
                // Skip zip files without stores.
                places.extend(in_zip(&entry).unwrap_or_default());
            } else if entry.extension().is_some_and(|extension| extension == "zarr") && is_store(&entry) {
                places.push(Self::folder(entry));
            }
        }
        if places.is_empty() {
            return Err(Error::file(path, "is neither a Zarr store nor a folder of *.zarr stores"));
        }
        places.sort();
        Ok(places)
    }

    /// Finds the only store that `path` names.
    ///
    /// # Errors
    /// If there is none or several.
    pub fn only(path: &Path) -> Result<Self> {
        if path.is_dir() || !path.exists() {
            return match is_store(path) {
                true => Ok(Self::folder(path)),
                false => Err(Error::file(path, "is not a Zarr store: neither .zgroup nor zarr.json in it")),
            };
        }
        let places = in_zip(path)?;
        match places.as_slice() {
            [place] => Ok(place.clone()),
            several => Err(Error::file(path, format!("holds {} stores; expected one", several.len()))),
        }
    }

    /// Returns the name of the store, for instance `pour.zarr`.
    pub fn name(&self) -> String {
        let file = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        match self.inside.as_deref() {
            None => file(&self.path),
            Some("") => {
                let stem = self.path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
                if stem.ends_with(".zarr") { stem } else { format!("{stem}.zarr") }
            }
            Some(inside) => file(Path::new(inside)),
        }
    }

    /// True if the store has the format Zarr v2.
    ///
    /// # Errors
    /// If it can't be read.
    pub fn is_v2(&self) -> Result<bool> {
        let fail = |error: &dyn std::fmt::Display| Error::file(&self.path, error);
        let key = StoreKey::new(".zgroup").map_err(|e| fail(&e))?;
        Ok(self.storage()?.size_key(&key).map_err(|e| fail(&e))?.is_some())
    }

    /// Opens the storage.
    ///
    /// # Errors
    /// If it can't be read.
    pub(super) fn storage(&self) -> Result<Arc<dyn ReadableListableStorageTraits>> {
        let fail = |error: &dyn std::fmt::Display| Error::file(&self.path, error);
        let Some(inside) = &self.inside else {
            return Ok(Arc::new(FilesystemStore::new(&self.path).map_err(|e| fail(&e))?));
        };
        let (Some(name), Some(parent)) = (self.path.file_name(), self.path.parent()) else {
            return Err(fail(&"is not a name for a zip file"));
        };
        let parent = if parent.as_os_str().is_empty() { Path::new(".") } else { parent };
        let around = Arc::new(FilesystemStore::new(parent).map_err(|e| fail(&e))?);
        let key = StoreKey::new(name.to_string_lossy()).map_err(|e| fail(&e))?;
        Ok(Arc::new(ZipStorageAdapter::new_with_path(around, key, inside).map_err(|e| fail(&e))?))
    }
}

impl std::fmt::Display for StoreLocation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.path.display())?;
        match self.inside.as_deref() {
            None | Some("") => Ok(()),
            Some(inside) => write!(f, "/{}", inside.trim_end_matches('/')),
        }
    }
}

/// True if the folder is a store.
pub(super) fn is_store(path: &Path) -> bool {
    path.join(".zgroup").is_file() || path.join("zarr.json").is_file()
}

fn is_zip(path: &Path) -> bool {
    path.is_file() && path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("zip"))
}

fn in_zip(path: &Path) -> Result<Vec<StoreLocation>> {
    let file = input::open(path)?;
    let archive = ZipArchive::new(file).map_err(|e| Error::file(path, format!("expected a zip file: {e}")))?;
    let marks = [".zarray", "zarr.json"].map(|file| format!("{EPISODE_ENDS}/{file}"));
    let mut places = Vec::new();
    for name in archive.file_names() {
        let name = name.map_err(|e| Error::file(path, e))?;
        let root = marks.iter().find_map(|mark| name.strip_suffix(mark.as_str()));
        if let Some(root) = root.filter(|root| root.is_empty() || root.ends_with('/')) {
            places.push(StoreLocation { path: path.to_path_buf(), inside: Some(root.to_string()) });
        }
    }
    if places.is_empty() {
        return Err(Error::file(path, format!("holds no Zarr store: no {EPISODE_ENDS} in it")));
    }
    places.sort();
    Ok(places)
}
