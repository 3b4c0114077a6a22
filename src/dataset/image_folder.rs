//! Folders of PNG and JPEG files as image sources.

use std::cmp::Ordering;
use std::fs;
use std::path::{Path, PathBuf};

use super::base_name;
use super::identity::InputFiles;
use super::source::{EncodedImage, ImageSource, SourceFrame, SourceFrames, Unit};
use crate::error::{Error, Result};
use crate::file::input::{self, InputFolder};
use crate::file::limits;

/// PNG and JPEG files in order, as one unit.
#[derive(Debug)]
pub struct ImageFolder {
    folder: PathBuf,
    files: Vec<PathBuf>,
    units: [Unit; 1],
    step_secs: f64,
}

impl ImageFolder {
    /// Opens the folder at `path`; `step_secs` is the time between two images.
    ///
    /// # Errors
    /// If the folder can't be read or holds no image, or a link leads out of it.
    pub fn open(path: &Path, step_secs: f64) -> Result<Self> {
        let files = image_files(path)?;
        let folder = InputFolder::open(path)?;
        files.iter().try_for_each(|file| folder.check(file))?;
        match files.is_empty() {
            true => Err(Error::file(path, "holds no PNG or JPEG file")),
            false => Ok(Self { folder: path.to_path_buf(), ..Self::from_files(base_name(path), files, step_secs) }),
        }
    }

    /// Creates a sequence of `files`, which follow each other by `step_secs`.
    pub fn from_files(name: String, files: Vec<PathBuf>, step_secs: f64) -> Self {
        let units = [Unit { name, frames: Some(files.len()) }];
        Self { folder: PathBuf::new(), files, units, step_secs }
    }
}

impl ImageSource for ImageFolder {
    fn units(&self) -> &[Unit] {
        &self.units
    }

    fn files(&self) -> Result<InputFiles> {
        let mut files = InputFiles::new(&self.folder);
        files.add(self.files.iter().cloned());
        Ok(files)
    }

    fn frames(&self, _: usize, from: usize) -> Result<SourceFrames<'_>> {
        let frame = |(index, path): (usize, &PathBuf)| {
            let image = match input::read(path, limits::CHUNK) {
                Err(error) if error.is_of_medium() => return Err(error),
                image => image.map(EncodedImage::File).map_err(|error| error.to_string()),
            };
            Ok(SourceFrame::new(index as f64 * self.step_secs, image))
        };
        Ok(Box::new(self.files.iter().enumerate().skip(from).map(frame)))
    }
}

/// Returns the PNG and JPEG files directly in `folder` in natural order: frame_2 before frame_10.
///
/// # Errors
/// If the folder can't be read.
pub fn image_files(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(Error::io(folder))? {
        let path = entry.map_err(Error::io(folder))?.path();
        if is_image(&path) {
            files.push(path);
        }
    }
    files.sort_by(|a, b| natural(&a.to_string_lossy(), &b.to_string_lossy()));
    Ok(files)
}

/// True if `path` is a file with the extension of a PNG or JPEG file.
pub fn is_image(path: &Path) -> bool {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    extension.is_some_and(|extension| ["png", "jpg", "jpeg"].contains(&extension.as_str())) && path.is_file()
}

/// Compares names by natural order: runs of digits compare by value, everything else by byte.
pub fn natural(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (a.as_bytes(), b.as_bytes());
    while let (Some(x), Some(y)) = (left.first(), right.first()) {
        let order = if x.is_ascii_digit() && y.is_ascii_digit() {
            let (number, rest) = digits(left);
            let (other, other_rest) = digits(right);
            (left, right) = (rest, other_rest);
            // Numbers of any length: without leading zeros, the one with more digits is larger.
            number.len().cmp(&other.len()).then(number.cmp(other))
        } else {
            (left, right) = (&left[1..], &right[1..]);
            x.cmp(y)
        };
        if order != Ordering::Equal {
            return order;
        }
    }
    left.len().cmp(&right.len()).then_with(|| a.cmp(b))
}

/// Splits `text` after its leading number, and removes the number's leading zeros.
fn digits(text: &[u8]) -> (&[u8], &[u8]) {
    let end = text.iter().position(|byte| !byte.is_ascii_digit()).unwrap_or(text.len());
    let start = text[..end].iter().position(|byte| *byte != b'0').unwrap_or(end);
    (&text[start..end], &text[end..])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_ordered_by_their_numbers() {
        let mut names = ["b1", "a10.png", "a2.png", "a02.png", "a1_9", "a1_10", "a", "a99999999999999999999999"];
        names.sort_by(|a, b| natural(a, b));
        assert_eq!(names, ["a", "a1_9", "a1_10", "a02.png", "a2.png", "a10.png", "a99999999999999999999999", "b1"]);
    }
}
