//! Writer of further arrays into an existing store.

use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};

use super::column::ArrayWriter;
use super::folder::{StoreRoot, write_json};
use super::{ArraySpec, Compression, Values};
use crate::error::{Error, Result};
use crate::file::{input, limits};

/// Consolidated metadata: a copy of all metadata in one file, which some readers use instead of the originals.
const CONSOLIDATED: &str = ".zmetadata";

/// Writes new arrays of labels into a Zarr v2 folder, frame by frame, and leaves existing arrays as they are.
#[derive(Debug)]
pub struct AddedArrays {
    columns: Vec<ArrayWriter>,
    root: PathBuf,
    place: StoreRoot,
}

impl AddedArrays {
    /// Starts the arrays `specs` in the folder `root`; the store's own files may follow before [`Self::finish`].
    ///
    /// # Errors
    /// If it is not a folder, or has an array of one of these names.
    pub fn new(root: &Path, specs: Vec<ArraySpec>) -> Result<Self> {
        if let Some(taken) = specs.iter().find(|spec| root.join(&spec.name).exists()) {
            return Err(Error::file(root, format!("has an array {} already", taken.name)));
        }
        let columns = specs.into_iter().map(|spec| ArrayWriter::new(spec, Compression::Labels)).collect();
        Ok(Self { columns, root: root.to_path_buf(), place: StoreRoot::new(root, root)? })
    }

    /// Appends one frame's values, in the order of the arrays.
    ///
    /// # Errors
    /// If the values don't fit their arrays, or can't be written.
    pub fn push(&mut self, values: Vec<Values>) -> Result<()> {
        if values.len() != self.columns.len() {
            return Err(Error::shape("values", format!("[{}]", self.columns.len()), [values.len()]));
        }
        for (column, values) in self.columns.iter_mut().zip(values) {
            column.check(Some(&values), &self.root)?;
            column.push(values, &self.place)?;
        }
        Ok(())
    }

    /// Writes the open chunks, and adds `attributes` to those of the root group, which must exist by now.
    ///
    /// # Errors
    /// If a file can't be written, this is not a Zarr v2 store, or its metadata is invalid.
    pub fn finish(mut self, attributes: Map<String, Value>) -> Result<()> {
        if !self.root.join(".zgroup").is_file() {
            return Err(Error::file(&self.root, "expected a Zarr v2 store; arrays can't be added to another"));
        }
        for column in &mut self.columns {
            column.finish(&self.place)?;
        }
        for column in &mut self.columns {
            column.wait(&self.root)?;
        }
        let file = self.root.join(".zattrs");
        let mut all = if file.is_file() { read_object(&file)? } else { Map::new() };
        all.extend(attributes);
        write_json(&file, &Value::Object(all.clone()))?;
        self.consolidate(all)
    }

    /// Adds attributes and arrays to the consolidated metadata, if the store has some.
    fn consolidate(&self, attributes: Map<String, Value>) -> Result<()> {
        let file = self.root.join(CONSOLIDATED);
        if !file.is_file() {
            return Ok(());
        }
        let mut document = read_object(&file)?;
        let metadata = document.entry("metadata").or_insert_with(|| json!({}));
        let Some(metadata) = metadata.as_object_mut() else {
            return Err(Error::file(&file, "expected an object under \"metadata\""));
        };
        metadata.insert(".zattrs".into(), Value::Object(attributes));
        for column in &self.columns {
            let name = format!("{}/.zarray", column.spec.name);
            let array = read_object(&self.root.join(&name))?;
            metadata.insert(name, Value::Object(array));
        }
        write_json(&file, &Value::Object(document))
    }
}

fn read_object(file: &Path) -> Result<Map<String, Value>> {
    let text = input::read_text(file, limits::TEXT)?;
    serde_json::from_str(&text).map_err(|e| Error::file(file, format!("expected a JSON object: {e}")))
}
