//! Writes plots as PNG and SVG files.

use std::error::Error as StdError;
use std::path::Path;

use image::{RgbImage, imageops};
use plotters::coord::Shift;
use plotters::prelude::{BitMapBackend, DrawingArea, DrawingBackend, IntoDrawingArea, SVGBackend};

use super::enlarged::{Enlarged, SCALE};
use super::font;
use crate::error::{Error, Result};
use crate::file;

/// Result of drawing, with the errors of any backend.
pub type Drawn<T> = std::result::Result<T, Box<dyn StdError>>;

/// A plot that can be drawn on any backend.
pub trait Figure {
    /// Width and height, pixels.
    const SIZE: (u32, u32);

    /// Draws on `root`, which has the size [`SIZE`](Self::SIZE).
    ///
    /// # Errors
    /// If the backend fails.
    fn draw<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static;
}

/// Returns `figure` as pixels. It is drawn enlarged and then reduced, so that lines, dots and letters have smooth edges.
///
/// # Errors
/// If drawing fails.
pub fn picture<F: Figure>(figure: &F) -> Drawn<RgbImage> {
    font::register();
    let (width, height) = F::SIZE;
    let large = (SCALE * width, SCALE * height);
    let mut picture = RgbImage::new(large.0, large.1);
    figure.draw(&Enlarged(BitMapBackend::with_buffer(picture.as_mut(), large)).into_drawing_area())?;
    Ok(imageops::thumbnail(&picture, width, height))
}

/// Writes `figure` to the PNG file `path`.
///
/// # Errors
/// If drawing or writing fails.
pub fn write_png<F: Figure>(path: &Path, figure: &F) -> Result<()> {
    let picture = picture(figure).map_err(|error| Error::file(path, error))?;
    file::write_png(path, &picture)
}

/// Returns `figure` as the text of an SVG file.
///
/// # Errors
/// If drawing fails.
pub fn svg<F: Figure>(figure: &F) -> Drawn<String> {
    font::register();
    let mut text = String::new();
    figure.draw(&SVGBackend::with_string(&mut text, F::SIZE).into_drawing_area())?;
    Ok(text)
}

/// Writes `NAME.png` and `NAME.svg` into `folder`.
///
/// # Errors
/// As [`write_png`].
pub fn write<F: Figure>(folder: &Path, name: &str, figure: &F) -> Result<()> {
    write_png(&folder.join(format!("{name}.png")), figure)?;
    let path = folder.join(format!("{name}.svg"));
    let text = svg(figure).map_err(|error| Error::file(&path, error))?;
    file::write(&path, text.as_bytes())
}
