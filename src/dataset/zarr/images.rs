//! Stores as image sources, one unit per episode.

use super::{EPISODE_ENDS, StoreLocation, TIMESTAMPS, ZarrReader};
use crate::dataset::identity::InputFiles;
use crate::dataset::source::{EncodedImage, ImageSource, SourceFrame, SourceFrames, Unit};
use crate::dataset::{EpisodeReader, time_unit_of};
use crate::error::Result;

/// Number of timestamps from which the time unit is estimated.
const STAMPS: usize = 1024;

/// A store whose images are labelled.
#[derive(Debug)]
pub struct Store {
    pub(super) place: StoreLocation,
    pub(super) reader: ZarrReader,
    pub(super) units: Vec<Unit>,
    seconds: f64,
}

impl Store {
    /// Opens a store. `camera` names the array of images, by default the usual one; `time_unit` is the unit of its
    /// timestamps in seconds, by default estimated from them.
    ///
    /// # Errors
    /// If it can't be read.
    pub fn open(place: &StoreLocation, camera: Option<&str>, time_unit: Option<f64>) -> Result<Self> {
        let mut reader = ZarrReader::open_at(place)?;
        if let Some(camera) = camera {
            let name = if camera.contains('/') { camera.to_string() } else { format!("data/{camera}") };
            reader = reader.with_camera(&name)?;
        }
        let mut start = 0;
        let mut units = Vec::new();
        for (index, end) in reader.episode_ends().iter().enumerate() {
            units.push(Unit { name: format!("episode {index}"), frames: Some(end - start) });
            start = *end;
        }
        let seconds = match time_unit {
            Some(seconds) => seconds,
            None => {
                let first = reader.episode_ends().first().map_or(0, |end| (*end).min(STAMPS));
                time_unit_of(&reader.read(TIMESTAMPS, 0..first)?.into_f64())
            }
        };
        Ok(Self { place: place.clone(), reader, units, seconds })
    }

    /// Returns the unit of the timestamps, s.
    pub fn time_unit(&self) -> f64 {
        self.seconds
    }

    /// Returns the name of the array of images.
    pub fn camera(&self) -> &str {
        self.reader.camera()
    }
}

impl ImageSource for Store {
    fn units(&self) -> &[Unit] {
        &self.units
    }

    fn files(&self) -> Result<InputFiles> {
        let mut files = InputFiles::new(&self.place.path);
        if self.place.inside.is_some() {
            files.add([self.place.path.clone()]);
            return Ok(files);
        }
        for array in [EPISODE_ENDS, TIMESTAMPS, self.camera()] {
            files.add_folder(array)?;
        }
        Ok(files)
    }

    fn frames(&self, unit: usize, from: usize) -> Result<SourceFrames<'_>> {
        let ends = self.reader.episode_ends();
        let (start, end) = (unit.checked_sub(1).map_or(0, |before| ends[before]), ends[unit]);
        let stamps = self.reader.read(TIMESTAMPS, start..end)?.into_f64();
        let frame = move |index: usize| {
            let image = match self.reader.image(start + index) {
                Err(error) if error.is_of_medium() => return Err(error),
                image => image.map(EncodedImage::Pixels).map_err(|error| error.to_string()),
            };
            Ok(SourceFrame::new(stamps[index] * self.seconds, image))
        };
        Ok(Box::new((from..end - start).map(frame)))
    }
}
