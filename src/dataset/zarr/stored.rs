//! Reader of one array of a store, by frame or by range.

use std::ops::Range;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use zarrs::array::{Array, ArrayBytes, ArrayError, ArraySubset, CodecError, ElementOwned, data_type};
use zarrs::storage::ReadableStorageTraits;

use super::files::failed_read;
use super::{Dtype, Values};
use crate::error::{Error, Result};
use crate::file::limits;

/// Name, shape and type of an array.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ArrayInfo {
    /// Name with its group.
    pub name: String,
    /// Shape; the first axis is time (episodes in `meta/`).
    pub shape: Vec<usize>,
    /// Name of the element type.
    pub dtype: String,
    /// Shape of a chunk; empty if the chunks are not regular.
    pub chunks: Vec<usize>,
}

/// An array and its last decoded chunk, since frames are mostly read in order.
pub(super) struct StoredArray {
    /// Name with its group.
    pub(super) name: String,
    array: Array<dyn ReadableStorageTraits>,
    last_chunk: Mutex<Option<(usize, Arc<Values>)>>,
}

impl StoredArray {
    /// Creates the reader of `array`.
    pub(super) fn new(name: String, array: Array<dyn ReadableStorageTraits>) -> Self {
        Self { name, array, last_chunk: Mutex::new(None) }
    }

    /// Returns the element type; None if [`Dtype`] does not have it.
    pub(super) fn dtype(&self) -> Option<Dtype> {
        let of = self.array.data_type();
        let known = [
            (data_type::uint8(), Dtype::U8),
            (data_type::float32(), Dtype::F32),
            (data_type::float64(), Dtype::F64),
            (data_type::int64(), Dtype::I64),
        ];
        known.into_iter().find(|(dtype, _)| dtype == of).map(|(_, dtype)| dtype)
    }

    /// Returns name, shape and type.
    pub(super) fn info(&self) -> ArrayInfo {
        let origin = vec![0; self.array.shape().len()];
        let chunks = self.array.chunk_shape_usize(&origin).unwrap_or_default();
        let dtype = match self.dtype() {
            Some(dtype) => dtype.to_string(),
            None => self.array.data_type().to_string(),
        };
        let shape = self.array.shape().iter().map(|n| *n as usize).collect();
        ArrayInfo { name: self.name.clone(), shape, dtype, chunks }
    }

    /// Reads one frame; errors name `path`.
    ///
    /// # Errors
    /// If there is no such frame, or it can't be read.
    pub(super) fn read_frame(&self, index: usize, path: &Path) -> Result<Values> {
        let info = self.info();
        let n_frames = info.shape.first().copied().unwrap_or(0);
        if index >= n_frames {
            return Err(Error::file(path, Error::value(&self.name, format!("a frame below {n_frames}"), index)));
        }
        let chunk_len = info.chunks.first().copied().unwrap_or(1).max(1);
        let start = index - index % chunk_len;
        let cached = {
            let last = self.last_chunk.lock().unwrap_or_else(PoisonError::into_inner);
            last.as_ref().filter(|(at, _)| *at == start).map(|(_, values)| values.clone())
        };
        let values = match cached {
            Some(values) => values,
            None => {
                // Decode outside the lock, since another thread may need another chunk.
                let values = Arc::new(self.read(start..(start + chunk_len).min(n_frames), path)?);
                *self.last_chunk.lock().unwrap_or_else(PoisonError::into_inner) = Some((start, values.clone()));
                values
            }
        };
        let item = info.shape[1..].iter().product::<usize>();
        let at = (index - start) * item;
        Ok(values.slice(at..at + item))
    }

    /// Reads a range of frames; errors name `path`.
    ///
    /// # Errors
    /// If a frame is out of range or can't be read, or the element type is not supported.
    pub(super) fn read(&self, range: Range<usize>, path: &Path) -> Result<Values> {
        let shape = self.array.shape();
        let n_frames = shape.first().copied().unwrap_or(0);
        if range.start > range.end || range.end as u64 > n_frames {
            let got = format!("{}..{}", range.start, range.end);
            return Err(Error::file(path, Error::value(&self.name, format!("frames within 0..{n_frames}"), got)));
        }
        self.check(range.len(), path)?;
        let time = range.start as u64..range.end as u64;
        let subset = ArraySubset::from(std::iter::once(time).chain(shape.iter().skip(1).map(|n| 0..*n)));
        let array = &self.array;
        let of = array.data_type().clone();
        if of == data_type::uint8() {
            return Ok(Values::U8(self.retrieve(&subset, path)?));
        } else if of == data_type::bool() {
            return Ok(Values::U8(self.retrieve::<bool>(&subset, path)?.into_iter().map(u8::from).collect()));
        } else if of == data_type::float32() {
            return Ok(Values::F32(self.retrieve(&subset, path)?));
        } else if of == data_type::float64() {
            return Ok(Values::F64(self.retrieve(&subset, path)?));
        } else if of == data_type::int64() {
            return Ok(Values::I64(self.retrieve(&subset, path)?));
        } else if of == data_type::int32() {
            return Ok(Values::I64(self.retrieve::<i32>(&subset, path)?.into_iter().map(i64::from).collect()));
        } else if of == data_type::uint32() {
            return Ok(Values::I64(self.retrieve::<u32>(&subset, path)?.into_iter().map(i64::from).collect()));
        } else if of == data_type::uint64() {
            let too_large = |_| Error::file(path, format!("{}: expected numbers below 2^63", self.name));
            let values = self.retrieve::<u64>(&subset, path)?.into_iter().map(i64::try_from);
            return Ok(Values::I64(values.collect::<std::result::Result<_, _>>().map_err(too_large)?));
        } else if of == data_type::float16() {
            return Ok(Values::F32(self.retrieve::<half::f16>(&subset, path)?.into_iter().map(f32::from).collect()));
        }
        let known = "uint8, bool, float16, float32, float64, int32, int64, uint32 or uint64";
        Err(Error::file(path, format!("{}: expected dtype {known}, got {of:?}", self.name)))
    }

    /// Checks the sizes of `frames` frames and of a chunk before anything is allocated; errors name `path`.
    fn check(&self, frames: usize, path: &Path) -> Result<()> {
        let info = self.info();
        let width = self.array.data_type().fixed_size().unwrap_or(1);
        let product = |shape: &[usize]| {
            shape.iter().try_fold(width as u64, |bytes, length| bytes.checked_mul(*length as u64)).unwrap_or(u64::MAX)
        };
        limits::FRAMES.check(path, &format!("{}: frames", self.name), frames as u64)?;
        limits::CHUNK.check(path, &format!("{}: a chunk", self.name), product(&info.chunks))?;
        let item = product(info.shape.get(1..).unwrap_or(&[]));
        let bytes = item.saturating_mul(frames as u64);
        limits::ARRAY.check(path, &format!("{}: {frames} frames", self.name), bytes)?;
        let grid = self.array.chunk_grid_shape();
        let mut of_frame = grid.iter().skip(1);
        let parts = of_frame.try_fold(1u64, |count, parts| count.checked_mul(*parts)).unwrap_or(u64::MAX);
        limits::FRAME_CHUNKS.check(path, &format!("{}: a frame", self.name), parts)?;
        let all = parts.saturating_mul(grid.first().copied().unwrap_or(1));
        match parts > 1 {
            true => limits::PART_CHUNKS.check(path, &format!("{}: all frames", self.name), all),
            false => Ok(()),
        }
    }

    /// Decodes the chunk in the file `name` below the array's folder; another file is not looked at. Errors name `path`.
    ///
    /// # Errors
    /// If the chunk can't be read.
    pub(super) fn check_file(&self, name: &str, path: &Path) -> Result<()> {
        let numbers = name.strip_prefix("c/").unwrap_or(name).split(['.', '/']).map(str::parse::<u64>);
        let Ok(indices) = numbers.collect::<std::result::Result<Vec<_>, _>>() else { return Ok(()) };
        let grid = self.array.chunk_grid_shape();
        let is_inside = indices.len() == grid.len() && indices.iter().zip(grid).all(|(index, n)| index < n);
        if !is_inside || self.array.chunk_key(&indices).as_str() != format!("{}/{name}", self.name) {
            return Ok(());
        }
        let info = self.info();
        let frames = info.shape.first().copied().unwrap_or(0).min(info.chunks.first().copied().unwrap_or(1));
        self.check(frames, path)?;
        let decoded = self.array.retrieve_chunk::<ArrayBytes<'static>>(&indices).map(drop);
        decoded.map_err(|error| self.failed(path, error))
    }

    fn retrieve<T: ElementOwned>(&self, subset: &ArraySubset, path: &Path) -> Result<Vec<T>> {
        self.array.retrieve_array_subset(subset).map_err(|error| self.failed(path, error))
    }

    /// Returns the error of a read that failed; an error of the operating system names the chunk's file.
    fn failed(&self, path: &Path, error: ArrayError) -> Error {
        if let ArrayError::StorageError(of_store) | ArrayError::CodecError(CodecError::StorageError(of_store)) = &error
            && let Some(of_medium) = failed_read(of_store)
        {
            return of_medium;
        }
        match Error::library(path.join(&self.name), &error) {
            of_medium @ Error::Io { .. } => of_medium,
            _ => Error::file(path, format!("{}: {error}", self.name)),
        }
    }
}
