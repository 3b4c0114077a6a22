//! A video file as a source.

use std::path::{Path, PathBuf};

use super::source::{Picture, Shot, Shots, Source, Unit};
use crate::dataset::mcap::Lost;
use crate::dataset::video::{self, Frames};
use crate::error::Result;

/// A video: one unit.
#[derive(Debug)]
pub struct VideoFile {
    path: PathBuf,
    units: [Unit; 1],
    fps: f64,
}

impl VideoFile {
    /// Opens the file at `path`.
    ///
    /// # Errors
    /// If there is no video in it, or ffmpeg is not installed.
    pub fn open(path: &Path) -> Result<Self> {
        let video = video::probe(path)?;
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let units = [Unit { name, frames: video.frames }];
        Ok(Self { path: path.to_path_buf(), units, fps: video.fps.unwrap_or(25.0) })
    }
}

impl Source for VideoFile {
    fn units(&self) -> &[Unit] {
        &self.units
    }

    fn shots(&self, _: usize, from: usize) -> Result<Shots<'_>> {
        let frames = Frames::open(&self.path, None)?;
        let fps = self.fps;
        let shot = move |(index, frame): (usize, Result<_>)| {
            // What ffmpeg gives up is no image; it is found and named when the output is put together.
            let (stamp, image): (f64, _) = frame.ok()?;
            let stamp_secs = if stamp.is_finite() { stamp } else { index as f64 / fps };
            Some(Shot { stamp_secs, offset: None, picture: Ok(Picture::Pixels(image)), note: None })
        };
        Ok(Box::new(frames.enumerate().map_while(shot).skip(from)))
    }

    fn damage(&self, _: usize, images: usize) -> Result<Option<Lost>> {
        let Some(damage) = video::damage(&self.path, images)? else { return Ok(None) };
        let size = self.path.metadata().map_or(0, |file| file.len());
        let (file, bytes) = (self.units[0].name.clone(), size.saturating_sub(damage.offset));
        Ok(Some(Lost { file, offset: damage.offset, bytes, reason: damage.reason }))
    }
}
