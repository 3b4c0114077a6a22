//! Files of labelled recordings for people: `egotac label --video`, `--foxglove` and `--rerun`.

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
    /// `--rerun`: a file, or the address of a viewer that runs.
    Rerun,
}

/// Extension of the files for Rerun.
const RERUN_EXTENSION: &str = "rrd";
/// Beginnings of the addresses of Rerun's viewers.
const VIEWERS: [&str; 3] = ["rerun://", "rerun+http://", "rerun+https://"];

impl Kind {
    fn option(self) -> &'static str {
        match self {
            Self::Video => "--video",
            Self::Foxglove => "--foxglove",
            Self::Rerun => "--rerun",
        }
    }

    /// Extensions of names, the default first.
    fn extensions(self) -> &'static [&'static str] {
        match self {
            Self::Video => &video::EXTENSIONS,
            Self::Foxglove => &[SCENE_EXTENSION],
            Self::Rerun => &[RERUN_EXTENSION],
        }
    }

    fn write(self, clip: &mut Clip, path: &Path, progress: impl FnMut()) -> Result<usize> {
        match self {
            Self::Video => write_video(clip, path, progress),
            Self::Foxglove => write_scene(clip, path, progress),
            Self::Rerun => show_in_rerun(clip, path, progress),
        }
    }

    /// Returns the file of each recording: `path`, or of several recordings one for each name in the folder `path`.
    ///
    /// # Errors
    /// If the name of a single file has another extension than those of its kind, or this program can't write it.
    pub(super) fn paths(self, path: &Path, tasks: &[LabelTask]) -> anyhow::Result<Vec<PathBuf>> {
        let extensions = self.extensions();
        if matches!(self, Self::Rerun) {
            if cfg!(not(feature = "rerun")) {
                bail!(
                    "--rerun: expected a program that is built with the feature `rerun` (`cargo build --release --features rerun`), got \
                     one without it; the Python script examples/to_rerun.py writes such files too"
                );
            }
            if viewer(path).is_some() {
                return Ok(vec![path.to_path_buf(); tasks.len()]);
            }
        }
        if tasks.len() > 1 {
            let name = |task: &LabelTask| task.out.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            return Ok(tasks.iter().map(|task| path.join(format!("{}.{}", name(task), extensions[0]))).collect());
        }
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        if !extensions.contains(&extension.as_str()) {
            let expected = extensions.join(", .");
            let or = if matches!(self, Self::Rerun) {
                ", or the address of a viewer, rerun+http://HOST:PORT/proxy"
            } else {
                ""
            };
            bail!("{} {}: expected a name that ends in .{expected}{or}", self.option(), path.display());
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

/// Returns the address of a viewer of Rerun; None for the name of a file.
fn viewer(path: &Path) -> Option<&str> {
    path.to_str().filter(|text| VIEWERS.iter().any(|scheme| text.starts_with(scheme)))
}

#[cfg(feature = "rerun")]
fn show_in_rerun(clip: &mut Clip, path: &Path, progress: impl FnMut()) -> Result<usize> {
    match viewer(path) {
        Some(address) => crate::view::send_rerun(clip, address, progress),
        None => crate::view::write_rerun(clip, path, progress),
    }
}

/// Without the feature, [`Kind::paths`] has refused the option before.
#[cfg(not(feature = "rerun"))]
fn show_in_rerun(_: &mut Clip, path: &Path, _: impl FnMut()) -> Result<usize> {
    Err(crate::Error::value("--rerun", "the feature rerun", path.display()))
}
