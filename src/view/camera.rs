//! A camera of this machine (Video4Linux), read by the program ffmpeg.

use std::path::Path;
use std::time::Instant;

use super::live::LiveInput;
use crate::dataset::video::CameraFrames;
use crate::error::Result;

/// True if `path` is a camera: a character device such as `/dev/video0`.
pub fn is_camera(path: &Path) -> bool {
    use std::os::unix::fs::FileTypeExt;
    path.metadata().is_ok_and(|there| there.file_type().is_char_device())
}

/// Shows the images of the camera at `path` until no page can come any more. Images that come while the network is busy are
/// left out.
///
/// # Errors
/// If ffmpeg is not installed, or the camera can't be read.
pub fn run(path: &Path, size: Option<(u32, u32)>, mut input: LiveInput) -> Result<()> {
    let frames = CameraFrames::open(path, size)?;
    let start = Instant::now();
    while !input.has_ended() {
        let Some(image) = frames.newest()? else { return Ok(()) };
        let moment = input.predict(start.elapsed().as_secs_f64(), image)?;
        input.show(moment)?;
    }
    Ok(())
}
