//! Images in the rows of an HDF5 array.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use ::image::RgbImage;

use super::hdf5::{H5Array, Hdf5};
use crate::dataset::source::{EncodedImage, SourceFrame, SourceFrames};
use crate::error::Result;
use crate::file::limits;

/// Size of the rows that are read at once, bytes: chunks usually hold many images, of each a small part.
const BLOCK: usize = 128 << 20;

/// Images of one camera, (T, H, W, 3) u8, RGB.
pub struct H5Images {
    array: Arc<H5Array>,
    size: (u32, u32),
    rows: usize,
    /// Number of rows that are read at once.
    block: usize,
    read: Mutex<Option<Block>>,
}

/// Rows that were read last.
struct Block {
    first: usize,
    pixels: Vec<u8>,
}

impl H5Images {
    /// Opens the images of an array.
    ///
    /// # Errors
    /// If the array is absent, damaged, or holds no images.
    pub fn open(file: &Hdf5, name: &str) -> Result<Self> {
        let array = file.required(name)?.expect(&[0, 0, 0, 3])?;
        let rows = array.rows()?;
        let shape = array.shape();
        array.check(limits::IMAGE, shape[1].saturating_mul(shape[2]))?;
        if shape[1] == 0 || shape[2] == 0 {
            return Err(array.damaged("expected images, got none of any size"));
        }
        let size = (shape[2] as u32, shape[1] as u32);
        let bytes = 3 * size.0 as usize * size.1 as usize;
        let block = array.chunk_rows().clamp(1, (BLOCK / bytes).max(1));
        Ok(Self { array, size, rows, block, read: Mutex::new(None) })
    }

    /// Returns the number of images.
    pub fn len(&self) -> usize {
        self.rows
    }

    /// Reads an image.
    ///
    /// # Errors
    /// If its chunks are damaged, or there is none of this index.
    pub fn image(&self, index: usize) -> Result<RgbImage> {
        if index >= self.rows {
            return Err(self.array.damaged(&format!("image {index} of {}", self.rows)));
        }
        let bytes = 3 * self.size.0 as usize * self.size.1 as usize;
        let mut read = self.read.lock().unwrap_or_else(PoisonError::into_inner);
        let first = index - index % self.block;
        if read.as_ref().is_none_or(|block| block.first != first) {
            *read = None;
            let pixels = self.array.octets(first..(first + self.block).min(self.rows))?;
            *read = Some(Block { first, pixels });
        }
        let pixels = read.as_ref().and_then(|block| block.pixels.get((index - first) * bytes..)?.get(..bytes));
        let image = pixels.and_then(|pixels| RgbImage::from_raw(self.size.0, self.size.1, pixels.to_vec()));
        image.ok_or_else(|| self.array.damaged(&format!("image {index} is incomplete")))
    }
}

/// Returns images of the file at `path` from index `from` on; `read` reads one, `stamp` gives its time, s.
///
/// # Errors
/// If `open` fails.
pub fn frames<'a, T: Send + 'a>(
    path: &'a Path,
    range: std::ops::Range<usize>,
    open: impl Fn(&Hdf5) -> Result<T>,
    read: impl Fn(&T, usize) -> Result<EncodedImage> + Send + 'a,
    stamp: impl Fn(usize) -> f64 + Send + 'a,
) -> Result<SourceFrames<'a>> {
    let images = open(&Hdf5::open(path)?)?;
    let frame = move |index| match read(&images, index) {
        Err(error) if error.is_of_medium() => Err(error),
        image => Ok(SourceFrame::new(stamp(index), image.map_err(|error| error.to_string()))),
    };
    Ok(Box::new(range.map(frame)))
}
