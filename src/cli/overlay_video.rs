//! Videos of labelled recordings: `egotac label --video`.

use std::path::{Path, PathBuf};

use anyhow::bail;

use super::hands::Hands;
use crate::dataset::Labelled;
use crate::dataset::video::EXTENSIONS;
use crate::label::LabelTask;
use crate::view::{Clip, ClipOptions, write_video};

/// Returns the video of each recording: `video`, or of several recordings one for each name in the folder `video`.
///
/// # Errors
/// If the name of a single video has another extension than those of videos.
pub(super) fn paths(video: &Path, tasks: &[LabelTask]) -> anyhow::Result<Vec<PathBuf>> {
    if tasks.len() > 1 {
        let name = |task: &LabelTask| task.out.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        return Ok(tasks.iter().map(|task| video.join(format!("{}.mp4", name(task)))).collect());
    }
    let extension = video.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    if !EXTENSIONS.contains(&extension.as_str()) {
        bail!("--video {}: expected a name that ends in .{}", video.display(), EXTENSIONS.join(", ."));
    }
    Ok(vec![video.to_path_buf()])
}

/// Writes the videos of the recordings whose labels are complete; those that wait for other shards are left out.
///
/// # Errors
/// If labels or images can't be read, or ffmpeg fails.
pub(super) fn write(paths: &[PathBuf], tasks: &[LabelTask], hands: &Hands) -> anyhow::Result<()> {
    let options = ClipOptions { hands: hands.files()?, ..ClipOptions::default() };
    for (path, task) in paths.iter().zip(tasks).filter(|(_, task)| task.out.exists()) {
        let labelled = Labelled::read(&task.out)?;
        let bar = super::progress::bar("images of the video");
        bar.set_length(labelled.labels.n_frames() as u64);
        let mut clip = Clip::with_labels(&task.out, task.source.clone(), labelled, &options)?;
        let frames = write_video(&mut clip, path, || bar.inc(1))?;
        bar.finish_and_clear();
        println!("{}: {frames} images", path.display());
    }
    Ok(())
}
