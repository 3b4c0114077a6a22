//! Images of a camera of this machine, decoded by the program ffmpeg.

use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

use ::image::RgbImage;

use super::{not_installed, read_ppm};
use crate::error::{Error, Result};

/// Time without an image after which a camera counts as lost.
const PATIENCE: Duration = Duration::from_secs(10);

/// Images of a Video4Linux device. A thread reads them, so that the newest one is at hand.
#[derive(Debug)]
pub struct CameraFrames {
    path: PathBuf,
    process: Child,
    newest: Arc<Newest>,
}

/// The newest image, until it is taken; an error or None ends the images.
type Taken = Option<std::io::Result<Option<RgbImage>>>;

#[derive(Debug, Default)]
struct Newest {
    image: Mutex<Taken>,
    came: Condvar,
}

impl CameraFrames {
    /// Opens the device at `path`; `size` is the wanted width and height, pixels.
    ///
    /// # Errors
    /// If ffmpeg is not installed.
    pub fn open(path: &Path, size: Option<(u32, u32)>) -> Result<Self> {
        let mut command = Command::new("ffmpeg");
        command.args(["-nostdin", "-hide_banner", "-loglevel", "error", "-f", "v4l2"]);
        if let Some((width, height)) = size {
            command.args(["-video_size", &format!("{width}x{height}")]);
        }
        command.arg("-i").arg(path);
        command.args(["-f", "image2pipe", "-c:v", "ppm", "-pix_fmt", "rgb24", "-"]);
        command.stdin(Stdio::null()).stdout(Stdio::piped());
        let mut process = command.spawn().map_err(|error| not_installed("ffmpeg", path, &error))?;
        let Some(pixels) = process.stdout.take() else {
            return Err(Error::file(path, "ffmpeg's output can't be read"));
        };
        let newest = Arc::new(Newest::default());
        let of_thread = Arc::clone(&newest);
        std::thread::spawn(move || {
            let mut pixels = BufReader::with_capacity(1 << 20, pixels);
            loop {
                let image = read_ppm(&mut pixels);
                let is_last = !matches!(image, Ok(Some(_)));
                *of_thread.image.lock().unwrap_or_else(PoisonError::into_inner) = Some(image);
                of_thread.came.notify_one();
                if is_last {
                    return;
                }
            }
        });
        Ok(Self { path: path.to_path_buf(), process, newest })
    }

    /// Waits for an image that was not taken before, and returns the newest one; None when the camera has ended.
    ///
    /// # Errors
    /// If the camera can't be read, or is silent for ten seconds.
    pub fn newest(&self) -> Result<Option<RgbImage>> {
        let Newest { image, came } = &*self.newest;
        let slot = image.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = came.wait_timeout_while(slot, PATIENCE, |slot| slot.is_none());
        let (mut slot, _) = waited.unwrap_or_else(PoisonError::into_inner);
        match slot.take() {
            Some(image) => image.map_err(Error::io(&self.path)),
            None => Err(Error::file(&self.path, "gives no image for 10 s; is another program using the camera?")),
        }
    }
}

impl Drop for CameraFrames {
    fn drop(&mut self) {
        // Errors mean that the process has ended already.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
