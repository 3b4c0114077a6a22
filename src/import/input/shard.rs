//! Parquet files with one row per frame.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type};
use arrow_array::{Array, ArrayRef, RecordBatch};
use arrow_schema::DataType;
use parquet::arrow::arrow_reader::ParquetRecordBatchReader;

use crate::dataset::lerobot::{numbers, only, reader};
use crate::error::{Error, Result};
use crate::file::limits;

/// Column with the number of the frame.
const FRAME: &str = "frame";

/// A file, and the rows of its frames.
pub struct Shard {
    path: PathBuf,
    columns: Vec<&'static str>,
    rows: BTreeMap<i64, usize>,
    /// Reader behind the row that was read last: rows are mostly read in order.
    cursor: Mutex<Option<(usize, ParquetRecordBatchReader)>>,
}

/// Values of one frame.
pub struct ShardRow<'a> {
    path: &'a Path,
    frame: i64,
    batch: RecordBatch,
}

impl Shard {
    /// Opens the file at `path` and finds the rows of its frames; `columns` are those that rows will have.
    ///
    /// # Errors
    /// If the file can't be read, or lacks a column.
    pub fn open(path: &Path, columns: &[&'static str]) -> Result<Self> {
        let builder = reader(path)?;
        for name in columns {
            if builder.schema().field_with_name(name).is_err() {
                let present: Vec<_> = builder.schema().fields().iter().map(|field| field.name().clone()).collect();
                let (name, place) = ((*name).to_string(), path.display().to_string());
                return Err(Error::Missing { name, place, present: present.join(", ") });
            }
        }
        let mask = only(&builder, |name| name == FRAME);
        let mut rows = BTreeMap::new();
        let batches = builder.with_projection(mask).build().map_err(|error| Error::library(path, error))?;
        for batch in batches {
            let batch = batch.map_err(|error| Error::library(path, error))?;
            for frame in numbers(&batch, FRAME, path)? {
                let row = rows.len();
                if frame.fract() != 0.0 || rows.insert(frame as i64, row).is_some() {
                    return Err(Error::file(path, format!("{FRAME}: expected whole numbers, each once, got {frame}")));
                }
            }
        }
        Ok(Self { path: path.to_path_buf(), columns: columns.to_vec(), rows, cursor: Mutex::new(None) })
    }

    /// Returns the frames, in order.
    pub fn frames(&self) -> impl Iterator<Item = i64> + '_ {
        self.rows.keys().copied()
    }

    /// Closes the file; the next row opens it again.
    pub fn release(&self) {
        *self.cursor.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    /// Returns the path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Reads the row of a frame; `None` if there is none.
    ///
    /// # Errors
    /// If it can't be read.
    pub fn row(&self, frame: i64) -> Result<Option<ShardRow<'_>>> {
        let Some(row) = self.rows.get(&frame).copied() else { return Ok(None) };
        let mut cursor = self.cursor.lock().unwrap_or_else(PoisonError::into_inner);
        let mut batches = match cursor.take() {
            Some((next, batches)) if next == row => batches,
            _ => self.batches(row)?,
        };
        let batch = match batches.next() {
            Some(batch) => batch.map_err(|error| Error::library(&self.path, error))?,
            None => return Err(Error::file(&self.path, format!("frame {frame}: its row is missing"))),
        };
        *cursor = Some((row + 1, batches));
        Ok(Some(ShardRow { path: &self.path, frame, batch }))
    }

    fn batches(&self, row: usize) -> Result<ParquetRecordBatchReader> {
        let builder = reader(&self.path)?;
        let mask = only(&builder, |name| self.columns.contains(&name));
        let builder = builder.with_projection(mask).with_batch_size(1).with_offset(row);
        builder.build().map_err(|error| Error::library(&self.path, error))
    }
}

impl std::fmt::Debug for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Shard").field("path", &self.path).field("rows", &self.rows.len()).finish_non_exhaustive()
    }
}

impl ShardRow<'_> {
    /// Returns a truth value; `None` if it is missing.
    ///
    /// # Errors
    /// If the column has another type.
    pub fn truth(&self, name: &str) -> Result<Option<bool>> {
        let column = self.column(name)?;
        let values = column.as_boolean_opt().ok_or_else(|| self.expected(name, "a truth value", column))?;
        Ok(values.is_valid(0).then(|| values.value(0)))
    }

    /// Returns a text; `None` if it is missing.
    ///
    /// # Errors
    /// If the column has another type.
    pub fn text(&self, name: &str) -> Result<Option<String>> {
        let column = self.column(name)?;
        if !column.is_valid(0) {
            return Ok(None);
        }
        let text = match column.data_type() {
            DataType::Utf8 => column.as_string::<i32>().value(0),
            DataType::LargeUtf8 => column.as_string::<i64>().value(0),
            _ => return Err(self.expected(name, "a text", column)),
        };
        Ok(Some(text.to_string()))
    }

    /// Returns a list of `n` finite numbers; `None` if it is missing.
    ///
    /// # Errors
    /// If the column has another type, or the list another length.
    pub fn list(&self, name: &str, n: usize) -> Result<Option<Vec<f64>>> {
        let column = self.column(name)?;
        if !column.is_valid(0) {
            return Ok(None);
        }
        let items = match column.data_type() {
            DataType::List(_) => column.as_list::<i32>().value(0),
            DataType::LargeList(_) => column.as_list::<i64>().value(0),
            DataType::FixedSizeList(..) => column.as_fixed_size_list().value(0),
            _ => return Err(self.expected(name, "a list of numbers", column)),
        };
        let values: Vec<f64> = match items.data_type() {
            DataType::Float32 => items.as_primitive::<Float32Type>().values().iter().map(|x| f64::from(*x)).collect(),
            DataType::Float64 => items.as_primitive::<Float64Type>().values().to_vec(),
            _ => return Err(self.expected(name, "a list of numbers", column)),
        };
        if values.len() != n || items.null_count() > 0 || values.iter().any(|value| !value.is_finite()) {
            let got = format!("expected {n} finite numbers, got {} with {} missing", values.len(), items.null_count());
            return Err(self.damaged(name, &got));
        }
        Ok(Some(values))
    }

    /// Returns the content of an image's file.
    ///
    /// # Errors
    /// If the column is not a structure with the bytes of a file, or they are missing.
    pub fn image(&self, name: &str) -> Result<Vec<u8>> {
        let column = self.column(name)?;
        let bytes = column.as_struct_opt().and_then(|image| image.column_by_name("bytes"));
        let bytes = bytes.ok_or_else(|| self.expected(name, "a structure with the image's bytes", column))?;
        if !bytes.is_valid(0) {
            return Err(self.damaged(name, "expected the image's bytes, got none"));
        }
        let content = match bytes.data_type() {
            DataType::Binary => bytes.as_binary::<i32>().value(0),
            DataType::LargeBinary => bytes.as_binary::<i64>().value(0),
            _ => return Err(self.expected(name, "the image's bytes", bytes)),
        };
        limits::CHUNK.check(self.path, name, content.len() as u64)?;
        Ok(content.to_vec())
    }

    fn column(&self, name: &str) -> Result<&ArrayRef> {
        self.batch.column_by_name(name).ok_or_else(|| self.damaged(name, "expected this column, got none"))
    }

    fn expected(&self, name: &str, what: &str, got: &ArrayRef) -> Error {
        self.damaged(name, &format!("expected {what}, got {}", got.data_type()))
    }

    fn damaged(&self, name: &str, message: &str) -> Error {
        Error::file(self.path, format!("frame {}: {name}: {message}", self.frame))
    }
}
