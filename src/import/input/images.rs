//! Images of a recording: files or a video.

use std::path::{Path, PathBuf};

use ::image::RgbImage;

use crate::dataset::source::{EncodedImage, SourceFrame, SourceFrames};
use crate::dataset::video::{self, VideoFrames};
use crate::error::{Error, Result};
use crate::file::{input, limits};

/// Height and width of the images of a recording without a camera, pixels.
const BLACK: u32 = 16;

/// Images of one recording, in order.
#[derive(Debug, Clone)]
pub enum Images {
    /// One file per image.
    Files(Vec<PathBuf>),
    /// A video; its own times are not used.
    Video(PathBuf),
    /// No camera: so many black images.
    Black(usize),
}

/// Properties of a video, as far as annotations need them.
#[derive(Debug, Clone, Copy)]
pub struct VideoFacts {
    /// Number of frames; None = not stated.
    pub frames: Option<usize>,
    /// Frames per second.
    pub fps: f64,
}

impl Images {
    /// Returns the images from index `from` on; `stamp` gives the time of each, s.
    ///
    /// # Errors
    /// If a video can't be opened.
    pub fn frames<'a>(&'a self, from: usize, stamp: impl Fn(usize) -> f64 + Send + 'a) -> Result<SourceFrames<'a>> {
        match self {
            Self::Files(files) => {
                let frame = move |(index, path): (usize, &PathBuf)| {
                    let image = match input::read(path, limits::CHUNK) {
                        // A missing file is known not to come back; other failures of the medium may pass.
                        Err(error) if error.is_of_medium() && path.exists() => return Err(error),
                        image => image.map(EncodedImage::File).map_err(|error| error.to_string()),
                    };
                    Ok(SourceFrame::new(stamp(index), image))
                };
                Ok(Box::new(files.iter().enumerate().skip(from).map(frame)))
            }
            Self::Black(frames) => {
                let image = || EncodedImage::Pixels(RgbImage::new(BLACK, BLACK));
                Ok(Box::new((from..*frames).map(move |index| Ok(SourceFrame::new(stamp(index), Ok(image()))))))
            }
            Self::Video(path) => {
                let frames = VideoFrames::open(path, None)?;
                let frame = move |(index, frame): (usize, Result<_>)| {
                    let (_, image) = frame?;
                    Ok(SourceFrame::new(stamp(index), Ok(EncodedImage::Pixels(image))))
                };
                Ok(Box::new(
                    frames
                        .enumerate()
                        .map(frame)
                        .enumerate()
                        .filter_map(move |(index, frame)| (index >= from || frame.is_err()).then_some(frame)),
                ))
            }
        }
    }

    /// Lists the files.
    pub fn paths(&self) -> Vec<PathBuf> {
        match self {
            Self::Files(files) => files.clone(),
            Self::Video(path) => vec![path.clone()],
            Self::Black(_) => Vec::new(),
        }
    }
}

/// Reads number and rate of a video's frames.
///
/// # Errors
/// If it is not a video, or states no frame rate.
pub fn video_alone(path: &Path) -> Result<VideoFacts> {
    let video = video::probe(path)?;
    let fps = video.fps.ok_or_else(|| Error::file(path, "expected a video with a frame rate, got none"))?;
    Ok(VideoFacts { frames: video.frames, fps })
}

/// As [`video_alone`], and checks the number of frames against that of the annotations.
///
/// # Errors
/// As [`video_alone`], and if the video has another number of frames.
pub fn video(path: &Path, annotated: usize) -> Result<VideoFacts> {
    let facts = video_alone(path)?;
    match facts.frames {
        // Frames that are lost somewhere shift all that follow against their annotations.
        Some(frames) if frames != annotated => {
            Err(Error::file(path, format!("expected {annotated} frames, one per annotation, got {frames}")))
        }
        _ => Ok(facts),
    }
}
