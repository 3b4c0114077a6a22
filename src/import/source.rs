//! A recording as a source of images, in one unit.

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
        let mut files = self.reader.files()?;
        let recording = self.reader.recording();
        files.add(recording.objects.iter().filter_map(|object| Some(object.mesh.as_ref()?.path.clone())));
        Ok(files)
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
