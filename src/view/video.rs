//! Videos of recordings with their touch, encoded by the program ffmpeg.

use std::io::{Read, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};

use ::image::RgbImage;

use super::clip::Clip;
use super::picture::Picture;
use super::publish::publish;
use crate::dataset::video::EXTENSIONS;
use crate::error::{Error, Result};

/// Height of the video, pixels.
const HEIGHT: u32 = 480;
/// Frame rate of recordings that do not state one, 1/s.
const DEFAULT_FPS: f64 = 25.0;
/// Largest number of bytes of ffmpeg's messages that an error quotes.
const MESSAGES: u64 = 2000;

/// Writes the images of `clip` with their touch as a video; the name's extension chooses the format. The file appears when it
/// is complete. Calls `progress` after each image. Returns the number of images.
///
/// # Errors
/// If the extension is that of no video, ffmpeg fails or is not installed, or the clip can't be read.
pub fn write_video(clip: &mut Clip, path: &Path, mut progress: impl FnMut()) -> Result<usize> {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    if !EXTENSIONS.contains(&extension.as_str()) {
        return Err(Error::value("video", format!("a name that ends in .{}", EXTENSIONS.join(", .")), path.display()));
    }
    let picture = Picture::new(clip.hands().clone(), clip.about().scale, HEIGHT);
    let fps = clip.about().fps.unwrap_or(DEFAULT_FPS);
    publish(path, |folder| {
        let at = folder.join(format!("video.{extension}"));
        let mut encoder = None::<Encoder>;
        let frames = clip.each(|moment| {
            let drawn = picture.draw(moment);
            let encoder = match &mut encoder {
                Some(encoder) => encoder,
                None => encoder.insert(Encoder::start(&at, even(&drawn), fps)?),
            };
            encoder.push(&drawn)?;
            progress();
            Ok(())
        })?;
        encoder.map_or(Ok(()), Encoder::finish)?;
        Ok((at, frames))
    })
}

/// Returns the size of a picture, rounded up to even numbers, which usual codecs need.
fn even(picture: &RgbImage) -> (u32, u32) {
    (picture.width().next_multiple_of(2), picture.height().next_multiple_of(2))
}

/// A run of ffmpeg that encodes pictures of one size.
struct Encoder {
    path: std::path::PathBuf,
    process: Child,
    pixels: ChildStdin,
    messages: std::thread::JoinHandle<String>,
    size: (u32, u32),
}

impl Encoder {
    fn start(path: &Path, size: (u32, u32), fps: f64) -> Result<Self> {
        let mut command = Command::new("ffmpeg");
        command.args(["-nostdin", "-hide_banner", "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"]);
        command.args(["-video_size", &format!("{}x{}", size.0, size.1), "-framerate", &format!("{fps:.6}"), "-i", "-"]);
        // Equal pictures give equal bytes.
        command.args(["-pix_fmt", "yuv420p", "-map_metadata", "-1", "-fflags", "+bitexact", "-flags:v", "+bitexact"]);
        command.arg(path).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
        let mut process = command.spawn().map_err(|error| {
            Error::file(
                path,
                format!("ffmpeg, which writes videos, can't be run ({error}); install the package ffmpeg"),
            )
        })?;
        let (Some(pixels), Some(words)) = (process.stdin.take(), process.stderr.take()) else {
            return Err(Error::file(path, "ffmpeg's input can't be written"));
        };
        let messages = std::thread::spawn(move || {
            let mut text = Vec::new();
            let mut words = words;
            // Take all of it, so that ffmpeg is not held up.
            let _ = words.by_ref().take(MESSAGES).read_to_end(&mut text);
            let _ = std::io::copy(&mut words, &mut std::io::sink());
            String::from_utf8_lossy(&text).trim().replace('\n', "; ")
        });
        Ok(Self { path: path.to_path_buf(), process, pixels, messages, size })
    }

    /// Encodes a picture; one of another size is cut or filled up with grey.
    fn push(&mut self, picture: &RgbImage) -> Result<()> {
        let written = match picture.dimensions() == self.size {
            true => self.pixels.write_all(picture.as_raw()),
            false => {
                let mut whole = RgbImage::from_pixel(self.size.0, self.size.1, ::image::Rgb([230; 3]));
                ::image::imageops::replace(&mut whole, picture, 0, 0);
                self.pixels.write_all(whole.as_raw())
            }
        };
        // ffmpeg's own message says more than the broken pipe.
        written.map_err(|error| Error::file(&self.path, format!("ffmpeg takes no more images ({error})")))
    }

    /// Waits for the end of the file.
    fn finish(self) -> Result<()> {
        let Self { path, mut process, pixels, messages, .. } = self;
        drop(pixels);
        let status = process.wait().map_err(Error::io(&path))?;
        let messages = messages.join().unwrap_or_default();
        match status.success() {
            true => Ok(()),
            false => Err(Error::file(&path, format!("ffmpeg failed with {status}: {messages}"))),
        }
    }
}
