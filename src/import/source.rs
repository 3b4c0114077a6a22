//! A recording as a source of images, in one unit.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::labeller::faults;
use super::recording::Reader;
use super::shapes::ShapeCache;
use crate::dataset::source::SourceFrames;
use crate::dataset::{ImageSource, InputFiles, LostBytes, Unit};
use crate::error::Result;

/// Images of one recording.
pub struct RecordingSource {
    reader: Arc<dyn Reader>,
    shapes: Arc<ShapeCache>,
    units: [Unit; 1],
}

impl RecordingSource {
    /// Creates the source of a recording's images.
    pub fn new(reader: Arc<dyn Reader>, shapes: Arc<ShapeCache>) -> Self {
        let recording = reader.recording();
        let units = [Unit { name: recording.name.clone(), frames: Some(recording.frames) }];
        Self { reader, shapes, units }
    }
}

impl ImageSource for RecordingSource {
    fn units(&self) -> &[Unit] {
        &self.units
    }

    fn files(&self) -> Result<InputFiles> {
        let meshes =
            self.reader.recording().objects.iter().filter_map(|object| Some(object.mesh.as_ref()?.path.clone()));
        // Names within their folders identify the files: a data set may be moved.
        let mut folders: Vec<(PathBuf, Vec<PathBuf>)> = Vec::new();
        for path in self.reader.files()?.into_iter().chain(meshes) {
            let folder = path.parent().unwrap_or(Path::new("")).to_path_buf();
            match folders.iter_mut().find(|(known, _)| *known == folder) {
                Some((_, files)) => files.push(path),
                None => folders.push((folder, vec![path])),
            }
        }
        let mut all = InputFiles::default();
        for (folder, paths) in folders {
            let mut files = InputFiles::new(&folder);
            files.add(paths);
            all.append(files);
        }
        Ok(all)
    }

    fn frames(&self, _: usize, from: usize) -> Result<SourceFrames<'_>> {
        self.reader.images(from)
    }

    fn damage(&self, _: usize, _: usize) -> Result<Option<LostBytes>> {
        let recording = self.reader.recording();
        let faults: Vec<String> = self.reader.damage().into_iter().chain(faults(recording, &self.shapes)).collect();
        let file = recording.path.display().to_string();
        Ok((!faults.is_empty()).then(|| LostBytes { file, offset: 0, bytes: 0, reason: faults.join("; ") }))
    }
}
