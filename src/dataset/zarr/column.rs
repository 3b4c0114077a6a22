//! Writer of one array of a store, chunk by chunk in constant memory.

use std::path::Path;
use std::thread::JoinHandle;

use zarrs::array::ArrayBytes;

use super::folder::{StoreRoot, create_array, write_metadata};
use super::{ArraySpec, Compression, Values};
use crate::error::{Error, Result};

/// Writer of one array; collects frames until a chunk is full.
#[derive(Debug)]
pub(super) struct ArrayWriter {
    pub(super) spec: ArraySpec,
    compression: Compression,
    /// Number of frames in a chunk.
    chunk_len: usize,
    /// Frames of the open chunk as native-endian bytes.
    buffer: Vec<u8>,
    n_frames: usize,
    n_chunks: usize,
    writing: Background,
}

/// A thread that compresses and writes a chunk, so that the next frames need not wait.
#[derive(Debug, Default)]
struct Background(Option<JoinHandle<Result<()>>>);

impl Background {
    fn wait(&mut self, path: &Path) -> Result<()> {
        let died = |_| Err(Error::file(path, "the thread that wrote a chunk died"));
        self.0.take().map_or(Ok(()), |thread| thread.join().unwrap_or_else(died))
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        // The store is abandoned: ignore the result.
        if let Some(thread) = self.0.take() {
            let _ = thread.join();
        }
    }
}

impl ArrayWriter {
    pub(super) fn new(spec: ArraySpec, compression: Compression) -> Self {
        let chunk_len = spec.chunk_len();
        Self {
            spec,
            compression,
            chunk_len,
            buffer: Vec::new(),
            n_frames: 0,
            n_chunks: 0,
            writing: Background::default(),
        }
    }

    pub(super) fn check(&self, values: Option<&Values>, path: &Path) -> Result<()> {
        let Some(values) = values else {
            return Err(Error::file(path, format!("{}: the pushed frame has no values for it", self.spec.name)));
        };
        if values.dtype() != self.spec.dtype {
            return Err(Error::value(&self.spec.name, self.spec.dtype, values.dtype()));
        }
        if values.len() != self.spec.item.iter().product::<usize>() {
            return Err(Error::shape(&self.spec.name, format!("{:?} per frame", self.spec.item), [values.len()]));
        }
        Ok(())
    }

    pub(super) fn push(&mut self, values: Values, root: &StoreRoot) -> Result<()> {
        if self.buffer.is_empty() {
            // Growing step by step would leave blocks of many sizes behind in a process that records for days.
            self.buffer.reserve_exact(self.chunk_len * self.spec.frame_bytes());
        }
        match values {
            Values::U8(v) => self.buffer.extend_from_slice(&v),
            Values::F32(v) => v.iter().for_each(|x| self.buffer.extend_from_slice(&x.to_ne_bytes())),
            Values::F64(v) => v.iter().for_each(|x| self.buffer.extend_from_slice(&x.to_ne_bytes())),
            Values::I64(v) => v.iter().for_each(|x| self.buffer.extend_from_slice(&x.to_ne_bytes())),
        }
        self.n_frames += 1;
        if self.buffer.len() == self.chunk_len * self.spec.frame_bytes() {
            self.flush(root)?;
        }
        Ok(())
    }

    pub(super) fn finish(&mut self, root: &StoreRoot) -> Result<()> {
        if self.n_chunks == 0 {
            // A short array gets a short chunk instead of padding.
            self.chunk_len = self.n_frames.max(1);
        }
        if !self.buffer.is_empty() {
            // Zarr v2 pads the last chunk to full length.
            self.buffer.resize(self.chunk_len * self.spec.frame_bytes(), 0);
            self.flush(root)?;
        }
        write_metadata(root, &self.spec, self.n_frames, self.chunk_len, self.compression)
    }

    /// Waits until the last chunk is written.
    pub(super) fn wait(&mut self, path: &Path) -> Result<()> {
        self.writing.wait(path)
    }

    /// Starts to write the open chunk once the previous one is written: at most one chunk per array is in memory twice.
    fn flush(&mut self, root: &StoreRoot) -> Result<()> {
        let path = root.path().to_path_buf();
        self.writing.wait(&path)?;
        let n_frames = (self.n_chunks + 1) * self.chunk_len;
        let array = create_array(root, &self.spec, n_frames, self.chunk_len, self.compression)?;
        let chunk = self.spec.chunk_index(self.n_chunks);
        let (bytes, name) = (std::mem::take(&mut self.buffer), self.spec.name.clone());
        self.writing = Background(Some(std::thread::spawn(move || {
            let written = array.store_chunk(&chunk, ArrayBytes::new_flen(bytes));
            written.map_err(|error| Error::file(&path, format!("{name}: {error}")))
        })));
        self.n_chunks += 1;
        Ok(())
    }
}
