//! Files of labelled recordings for people: `egotac label --video` and `--foxglove`.

use std::path::{Path, PathBuf};

use anyhow::bail;

use super::hands::Hands;
use crate::dataset::{Labelled, video};
use crate::error::Result;
use crate::label::LabelTask;
use crate::view::{Clip, ClipOptions, SCENE_EXTENSION, write_scene, write_video};

/// A kind of file.
#[derive(Debug, Clone, Copy)]
pub(super) enum Kind {
    /// `--video`.
    Video,
    /// `--foxglove`.
    Foxglove,
}

impl Kind {
    fn option(self) -> &'static str {
        match self {
            Self::Video => "--video",
            Self::Foxglove => "--foxglove",
        }
    }

    /// Extensions of names, the default first.
    fn extensions(self) -> &'static [&'static str] {
        match self {
            Self::Video => &video::EXTENSIONS,
            Self::Foxglove => &[SCENE_EXTENSION],
        }
    }

    fn write(self, clip: &mut Clip, path: &Path, progress: impl FnMut()) -> Result<usize> {
        match self {
            Self::Video => write_video(clip, path, progress),
            Self::Foxglove => write_scene(clip, path, progress),
        }
    }

    /// Returns the file of each recording: `path`, or of several recordings one for each name in the folder `path`.
    ///
    /// # Errors
    /// If the name of a single file has another extension than those of its kind.
    pub(super) fn paths(self, path: &Path, tasks: &[LabelTask]) -> anyhow::Result<Vec<PathBuf>> {
        let extensions = self.extensions();
        if tasks.len() > 1 {
            let name = |task: &LabelTask| task.out.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            return Ok(tasks.iter().map(|task| path.join(format!("{}.{}", name(task), extensions[0]))).collect());
        }
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        if !extensions.contains(&extension.as_str()) {
            let expected = extensions.join(", .");
            bail!("{} {}: expected a name that ends in .{expected}", self.option(), path.display());
        }
        Ok(vec![path.to_path_buf()])
    }

    /// Writes the files of the recordings whose labels are complete; those that wait for other shards are left out.
    ///
    /// # Errors
    /// If labels or images can't be read, or a file can't be written.
    pub(super) fn write_all(self, paths: &[PathBuf], tasks: &[LabelTask], hands: &Hands) -> anyhow::Result<()> {
        let options = ClipOptions { hands: hands.files()?, ..ClipOptions::default() };
        for (path, task) in paths.iter().zip(tasks).filter(|(_, task)| task.out.exists()) {
            let labelled = Labelled::read(&task.out)?;
            let bar = super::progress::bar(&format!("images for {}", self.option()));
            bar.set_length(labelled.labels.n_frames() as u64);
            let mut clip = Clip::with_labels(&task.out, task.source.clone(), labelled, &options)?;
            let frames = self.write(&mut clip, path, || bar.inc(1))?;
            bar.finish_and_clear();
            println!("{}: {frames} images", path.display());
        }
        Ok(())
    }
}
