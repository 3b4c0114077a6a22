//! The unfinished folder of a store, which gets its name when all arrays are written.

use std::fs;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::{Map, Value, json};
use tempfile::TempDir;
use zarrs::array::{Array, ArrayBytes, ArrayMetadata, ArrayMetadataV2};
use zarrs::filesystem::FilesystemStore;

use super::{ArraySpec, Compression, Dtype, EPISODE_ENDS};
use crate::dataset::Attributes;
use crate::error::{Error, Result};
use crate::file;

/// Folder into which arrays are written.
#[derive(Debug)]
pub(super) struct StoreRoot {
    /// Name of the store in errors.
    path: PathBuf,
    folder: PathBuf,
    store: Arc<FilesystemStore>,
}

impl StoreRoot {
    /// Opens the folder `folder` of a store; errors name `path`.
    ///
    /// # Errors
    /// If it is not a folder.
    pub fn new(folder: &Path, path: &Path) -> Result<Self> {
        let store = FilesystemStore::new(folder).map_err(|e| Error::file(folder, e))?;
        Ok(Self { path: path.to_path_buf(), folder: folder.to_path_buf(), store: Arc::new(store) })
    }

    /// Returns the name of the store in errors.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// Hidden folder beside the store's path; removed when dropped.
#[derive(Debug)]
pub(super) struct StoreFolder {
    folder: TempDir,
    root: StoreRoot,
    /// Tells other processes that the folder is in use; the lock ends with the file.
    _lock: File,
}

impl StoreFolder {
    /// Starts the store `path`.
    ///
    /// # Errors
    /// If `path` exists or its folder can't be written.
    pub fn create(path: &Path) -> Result<Self> {
        refuse_existing(path)?;
        let (Some(name), Some(parent)) = (path.file_name(), path.parent()) else {
            return Err(Error::file(path, "is not a name for a store"));
        };
        let parent = if parent.as_os_str().is_empty() { Path::new(".") } else { parent };
        fs::create_dir_all(parent).map_err(Error::io(parent))?;
        let prefix = file::partial_prefix(path);
        file::remove_leftovers(parent, &prefix);
        let (folder, lock) = loop {
            let folder = tempfile::Builder::new().prefix(&prefix).tempdir_in(parent).map_err(Error::io(parent))?;
            let path = folder.path().join(file::LOCK);
            let lock = File::create(&path).map_err(Error::io(&path))?;
            // Another process that removes leftovers may have taken the folder before this one locked it.
            if file::lock(&lock) && path.exists() {
                break (folder, lock);
            }
        };
        // A folder within the temporary one: that one is private to the user, the store gets the usual permissions.
        let root = folder.path().join(name);
        fs::create_dir(&root).map_err(Error::io(&root))?;
        Ok(Self { root: StoreRoot::new(&root, path)?, folder, _lock: lock })
    }

    /// Returns the path of the finished store.
    pub fn path(&self) -> &Path {
        &self.root.path
    }

    /// Returns the folder into which arrays are written.
    pub fn root(&self) -> &StoreRoot {
        &self.root
    }

    /// Writes episodes, groups and attributes, and gives the store its name.
    ///
    /// # Errors
    /// If another process created `path`, or writing fails.
    pub fn finish(self, attributes: &Attributes, mut more: Map<String, Value>, episode_ends: &[i64]) -> Result<()> {
        let ends = ArraySpec::new(EPISODE_ENDS, [], Dtype::I64);
        let n_ends = episode_ends.len();
        let bytes: Vec<u8> = episode_ends.iter().flat_map(|end| end.to_ne_bytes()).collect();
        let array = create_array(&self.root, &ends, n_ends, n_ends, Compression::None)?;
        let written = array.store_chunk(&[0], ArrayBytes::new_flen(bytes));
        written.map_err(|error| Error::file(&self.root.path, format!("{EPISODE_ENDS}: {error}")))?;
        write_metadata(&self.root, &ends, n_ends, n_ends, Compression::None)?;

        let mut attributes = match serde_json::to_value(attributes) {
            Ok(Value::Object(map)) => map,
            _ => Map::new(),
        };
        attributes.append(&mut more);
        for group in ["", "data", "meta"] {
            write_json(&self.root.folder.join(group).join(".zgroup"), &json!({ "zarr_format": 2 }))?;
        }
        write_json(&self.root.folder.join(".zattrs"), &Value::Object(attributes))?;
        refuse_existing(&self.root.path)?;
        file::sync_tree(&self.root.folder)?;
        file::rename(&self.root.folder, &self.root.path)?;
        self.folder.close().map_err(Error::io(&self.root.path))
    }
}

/// Creates an array of `n_frames` frames, without metadata: [`write_metadata`] writes that.
pub(super) fn create_array(
    root: &StoreRoot,
    spec: &ArraySpec,
    n_frames: usize,
    chunk_len: usize,
    compression: Compression,
) -> Result<Array<FilesystemStore>> {
    let fail = |error: &dyn std::fmt::Display| Error::file(&root.path, format!("{}: {error}", spec.name));
    let metadata: ArrayMetadataV2 =
        serde_json::from_value(metadata(spec, n_frames, chunk_len, compression)).map_err(|e| fail(&e))?;
    let name = format!("/{}", spec.name);
    Array::new_with_metadata(root.store.clone(), &name, ArrayMetadata::V2(metadata)).map_err(|e| fail(&e))
}

/// Writes the `.zarray` of an array.
pub(super) fn write_metadata(
    root: &StoreRoot,
    spec: &ArraySpec,
    n_frames: usize,
    chunk_len: usize,
    compression: Compression,
) -> Result<()> {
    let file = root.folder.join(&spec.name).join(".zarray");
    write_json(&file, &metadata(spec, n_frames, chunk_len, compression))
}

fn metadata(spec: &ArraySpec, n_frames: usize, chunk_len: usize, compression: Compression) -> Value {
    let with_item = |first: usize| -> Vec<usize> { [first].iter().chain(&spec.item).copied().collect() };
    json!({
        "zarr_format": 2,
        "shape": with_item(n_frames),
        "chunks": with_item(chunk_len),
        "dtype": spec.dtype.zarr_name(),
        "compressor": compression.zarr(),
        "fill_value": match spec.dtype { Dtype::F32 | Dtype::F64 => json!(0.0), _ => json!(0) },
        "order": "C",
        "filters": null,
        "dimension_separator": ".",
    })
}

fn refuse_existing(path: &Path) -> Result<()> {
    match path.exists() {
        true => Err(Error::file(path, "exists already; choose another name or remove it")),
        false => Ok(()),
    }
}

pub(super) fn write_json(file: &Path, value: &Value) -> Result<()> {
    if let Some(folder) = file.parent() {
        fs::create_dir_all(folder).map_err(Error::io(folder))?;
    }
    fs::write(file, format!("{value:#}\n")).map_err(Error::io(file))
}
