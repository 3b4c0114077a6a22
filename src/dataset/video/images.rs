//! Video files as image sources.

use std::path::{Path, PathBuf};

use super::VideoFrames;
use crate::dataset::base_name;
use crate::dataset::identity::InputFiles;
use crate::dataset::source::{EncodedImage, ImageSource, LostBytes, SourceFrame, SourceFrames, Unit, skip_images};
use crate::error::Result;

/// Frame rate of videos that don't state one, 1/s: that of our recordings.
const DEFAULT_FPS: f64 = 25.0;

/// A video file as one unit.
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
    /// If it holds no video stream, or ffmpeg is not installed.
    pub fn open(path: &Path) -> Result<Self> {
        let video = super::probe(path)?;
        let units = [Unit { name: base_name(path), frames: video.frames }];
        Ok(Self { path: path.to_path_buf(), units, fps: video.fps.unwrap_or(DEFAULT_FPS) })
    }
}

impl ImageSource for VideoFile {
    fn units(&self) -> &[Unit] {
        &self.units
    }

    fn files(&self) -> Result<InputFiles> {
        let mut files = InputFiles::new(&self.path);
        files.add([self.path.clone()]);
        Ok(files)
    }

    fn frames(&self, _: usize, from: usize) -> Result<SourceFrames<'_>> {
        let frames = VideoFrames::open(&self.path, None)?;
        let fps = self.fps;
        let frame = move |(index, frame): (usize, Result<_>)| {
            // Frames that ffmpeg can't decode yield no image; `damage` reports them when the output is assembled.
            let (stamp, image): (f64, _) = frame?;
            let stamp_secs = if stamp.is_finite() { stamp } else { index as f64 / fps };
            Ok(SourceFrame::new(stamp_secs, Ok(EncodedImage::Pixels(image))))
        };
        Ok(skip_images(frames.enumerate().map(frame), from))
    }

    fn damage(&self, _: usize, images: usize) -> Result<Option<LostBytes>> {
        let Some(damage) = super::damage(&self.path, images)? else { return Ok(None) };
        let size = self.path.metadata().map_or(0, |file| file.len());
        let (file, bytes) = (self.units[0].name.clone(), size.saturating_sub(damage.offset));
        Ok(Some(LostBytes { file, offset: damage.offset, bytes, reason: damage.reason }))
    }
}
