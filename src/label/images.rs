//! A folder of images as a source.

use std::cmp::Ordering;
use std::fs;
use std::path::{Path, PathBuf};

use super::source::{Picture, Shot, Shots, Source, Unit};
use crate::error::{Error, Result};

/// PNG and JPEG files of a folder, by name: one unit.
#[derive(Debug)]
pub struct Images {
    files: Vec<PathBuf>,
    units: [Unit; 1],
    frame_secs: f64,
}

impl Images {
    /// Opens the folder at `path`, whose images follow each other by `frame_secs`.
    ///
    /// # Errors
    /// If it can't be read or holds no image.
    pub fn open(path: &Path, frame_secs: f64) -> Result<Self> {
        let files = image_files(path)?;
        if files.is_empty() {
            return Err(Error::file(path, "holds no PNG or JPEG file"));
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let units = [Unit { name, frames: Some(files.len()) }];
        Ok(Self { files, units, frame_secs })
    }
}

impl Source for Images {
    fn units(&self) -> &[Unit] {
        &self.units
    }

    fn shots(&self, _: usize, from: usize) -> Result<Shots<'_>> {
        let shot = |(index, path): (usize, &PathBuf)| {
            let named = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
            let picture = fs::read(path).map(Picture::File).map_err(|error| named(&error));
            Shot { stamp_secs: index as f64 * self.frame_secs, offset: None, picture, note: None }
        };
        Ok(Box::new(self.files.iter().enumerate().skip(from).map(shot)))
    }
}

/// The PNG and JPEG files directly in `folder`, as people order them: frame_2 before frame_10.
///
/// # Errors
/// If the folder can't be read.
pub fn image_files(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(Error::io(folder))? {
        let path = entry.map_err(Error::io(folder))?.path();
        if is_image(&path) && path.is_file() {
            files.push(path);
        }
    }
    files.sort_by(|a, b| natural(&a.to_string_lossy(), &b.to_string_lossy()));
    Ok(files)
}

fn is_image(path: &Path) -> bool {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    extension.is_some_and(|extension| ["png", "jpg", "jpeg"].contains(&extension.as_str()))
}

/// Compares names with numbers in them by the numbers' values.
fn natural(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (a.as_bytes(), b.as_bytes());
    while let (Some(x), Some(y)) = (left.first(), right.first()) {
        let order = if x.is_ascii_digit() && y.is_ascii_digit() {
            let (number, rest) = digits(left);
            let (other, other_rest) = digits(right);
            (left, right) = (rest, other_rest);
            // Without leading zeros the longer number is the larger one.
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

/// The number that the text begins with, without leading zeros, and the rest.
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
