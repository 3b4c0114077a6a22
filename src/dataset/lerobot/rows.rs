//! Rows of one episode in order; a row that can't be read costs no other row.

use std::collections::VecDeque;
use std::fs::File;
use std::path::{Path, PathBuf};

use arrow_array::cast::AsArray;
use arrow_array::{Array, RecordBatch};
use arrow_schema::DataType;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{ArrowReaderMetadata, ParquetRecordBatchReader, ParquetRecordBatchReaderBuilder};

use super::{numbers, only, reader};
use crate::error::{Error, Result};
use crate::file::{input, limits};

/// Number of rows without images that are read at a time. Rows with images are read one by one: a cell may be large.
const BATCH: usize = 16;

/// A row with its image.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Row {
    /// Time since the start of the episode, s.
    pub timestamp: f64,
    /// Content of the image's file; None if the images lie in videos or the row has none.
    pub image: Option<Vec<u8>>,
}

/// Reader of consecutive rows of one file.
pub(super) struct Rows {
    path: PathBuf,
    metadata: ArrowReaderMetadata,
    mask: ProjectionMask,
    camera: Option<String>,
    /// Index of the next row that is not in `ready`, and of the row behind the last.
    next: usize,
    end: usize,
    batch: usize,
    batches: Option<ParquetRecordBatchReader>,
    ready: VecDeque<Result<Row>>,
}

impl Rows {
    /// Opens the rows `first..end` of the file at `path`, with the images of `camera` if they lie in the rows.
    ///
    /// # Errors
    /// If the file can't be opened, or lacks a column.
    pub fn open(path: &Path, camera: Option<&str>, first: usize, end: usize) -> Result<Self> {
        let builder = reader(path)?;
        let wanted: Vec<&str> = ["timestamp"].into_iter().chain(camera).collect();
        for name in &wanted {
            if builder.schema().field_with_name(name).is_err() {
                let present = builder.schema().fields().iter().map(|field| field.name().clone()).collect::<Vec<_>>();
                let (name, place) = ((*name).to_string(), path.display().to_string());
                return Err(Error::Missing { name, place, present: present.join(", ") });
            }
        }
        let mask = only(&builder, |name| wanted.contains(&name));
        let metadata = ArrowReaderMetadata::try_new(builder.metadata().clone(), Default::default());
        Ok(Self {
            path: path.to_path_buf(),
            metadata: metadata.map_err(|e| Error::file(path, e))?,
            mask,
            camera: camera.map(str::to_string),
            next: first,
            end,
            batch: if camera.is_some() { 1 } else { BATCH },
            batches: None,
            ready: VecDeque::new(),
        })
    }

    /// Starts to read at row `first`, `batch` rows at a time.
    fn batches(&self, first: usize, batch: usize) -> Result<ParquetRecordBatchReader> {
        let file: File = input::open(&self.path)?;
        ParquetRecordBatchReaderBuilder::new_with_metadata(file, self.metadata.clone())
            .with_projection(self.mask.clone())
            .with_batch_size(batch)
            .with_offset(first)
            .with_limit(self.end - first)
            .build()
            .map_err(|e| Error::library(&self.path, e))
    }

    /// Reads the next batch into `ready`; false at the end of the file.
    fn fill(&mut self) -> bool {
        let length = self.batch.min(self.end - self.next);
        let batches = match self.batches.take() {
            Some(batches) => Ok(batches),
            None => self.batches(self.next, self.batch),
        };
        let batch = match batches {
            Ok(mut batches) => {
                let Some(batch) = batches.next() else { return false };
                if batch.is_ok() {
                    self.batches = Some(batches);
                }
                batch.map_err(|e| Error::library(&self.path, e))
            }
            Err(error) => Err(error),
        };
        match batch {
            Ok(batch) => {
                for row in 0..batch.num_rows() {
                    self.ready.push_back(row_of(&batch.slice(row, 1), self.camera.as_deref(), &self.path));
                }
                self.next += batch.num_rows();
                batch.num_rows() > 0
            }
            Err(error) if length == 1 => {
                self.ready.push_back(Err(error));
                self.next += 1;
                true
            }
            // The reader can't go on behind an error: take the rows of this batch one by one, from a reader of their own.
            Err(_) => {
                for row in self.next..self.next + length {
                    let single = self.batches(row, 1).map(|mut batches| batches.next());
                    let read = match single {
                        Ok(Some(Ok(batch))) => row_of(&batch, self.camera.as_deref(), &self.path),
                        Ok(Some(Err(error))) => Err(Error::library(&self.path, error)),
                        Ok(None) => Err(Error::file(&self.path, format!("row {row} is missing"))),
                        Err(error) => Err(error),
                    };
                    self.ready.push_back(read);
                }
                self.next += length;
                true
            }
        }
    }
}

impl Iterator for Rows {
    type Item = Result<Row>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ready.is_empty() && (self.next >= self.end || !self.fill()) {
            return None;
        }
        self.ready.pop_front()
    }
}

/// Returns timestamp and image file of a batch of one row.
fn row_of(batch: &RecordBatch, camera: Option<&str>, path: &Path) -> Result<Row> {
    let timestamp = numbers(batch, "timestamp", path)?.first().copied();
    let timestamp = timestamp.ok_or_else(|| Error::file(path, "timestamp: expected a row, got none"))?;
    let Some(name) = camera else { return Ok(Row { timestamp, image: None }) };
    let column = batch.column_by_name(name);
    let bytes = column.and_then(|column| column.as_struct_opt()).and_then(|image| image.column_by_name("bytes"));
    let Some(bytes) = bytes else {
        let got = column.map_or_else(|| "none".to_string(), |column| column.data_type().to_string());
        return Err(Error::file(path, format!("{name}: expected structs with the image's bytes, got {got}")));
    };
    if !bytes.is_valid(0) {
        return Ok(Row { timestamp, image: None });
    }
    let image = match bytes.data_type() {
        DataType::Binary => bytes.as_binary::<i32>().value(0),
        DataType::LargeBinary => bytes.as_binary::<i64>().value(0),
        other => return Err(Error::file(path, format!("{name}: expected the image's bytes, got {other}"))),
    };
    limits::PAGE.check(path, name, image.len() as u64)?;
    Ok(Row { timestamp, image: Some(image.to_vec()) })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use arrow_array::{ArrayRef, Float64Array};
    use parquet::arrow::ArrowWriter;

    use super::*;

    #[test]
    fn an_unreadable_row_costs_no_other_row_and_keeps_its_reason() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file-000.parquet");
        let times: Vec<Option<f64>> = (0..40).map(|row| (row != 20).then_some(f64::from(row))).collect();
        let column: ArrayRef = Arc::new(Float64Array::from(times));
        let batch = RecordBatch::try_from_iter_with_nullable([("timestamp", column, true)]).unwrap();
        let mut writer = ArrowWriter::try_new(File::create(&path).unwrap(), batch.schema(), None).unwrap();
        writer.write(&batch).unwrap();
        writer.close().unwrap();
        let rows: Vec<Result<Row>> = Rows::open(&path, None, 3, 38).unwrap().collect();
        assert_eq!(rows.len(), 35);
        for (row, at) in rows.into_iter().zip(3..) {
            match row {
                Ok(row) => assert_eq!(row.timestamp, f64::from(at)),
                Err(error) => assert!(at == 20 && error.to_string().contains("timestamp: 1 values are missing")),
            }
        }
    }
}
