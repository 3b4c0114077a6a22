//! OXT stores: touch as further arrays of the same store.

use std::fs;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use serde_json::{Map, Value};

use super::copy::{copy_file, copy_folder};
use super::journal::Label;
use super::output::{Journals, Output};
use super::prefetch::ahead;
use super::provenance::NAME;
use super::source::{Picture, Shot, Shots, Source, Unit};
use super::summary::About;
use crate::dataset::mcap::Lost;
use crate::dataset::zarr::{
    AddedArrays, ArraySpec, Dtype, MANO_CONTACT_SCORE, MANO_CONTACT_VALID, MANO_FORCE, MANO_FORCE_VALID, Place,
    TIMESTAMPS, Values, ZarrReader,
};
use crate::dataset::{EpisodeReader, time_unit_of};
use crate::error::{Error, Result};
use crate::hand::Topology;
use crate::tactile::N_FIELD;

/// What arrays of labels are called where the store has such arrays already, truth for instance.
pub const PREDICTED: &str = "predicted_";
/// Time stamps read at a time.
const BLOCK: usize = 1024;

/// A store whose images are labelled: one unit per episode.
#[derive(Debug)]
pub struct Store {
    place: Place,
    reader: ZarrReader,
    units: Vec<Unit>,
    seconds: f64,
}

impl Store {
    /// Opens a store. `camera` names the array of images, if not the usual one; `time_unit` is what one unit of its time
    /// stamps is in seconds, if they shall not tell by themselves.
    ///
    /// # Errors
    /// If it can't be read, or is not Zarr v2.
    pub fn open(place: &Place, camera: Option<&str>, time_unit: Option<f64>) -> Result<Self> {
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
                let first = reader.episode_ends().first().map_or(0, |end| (*end).min(BLOCK));
                time_unit_of(&reader.read(TIMESTAMPS, 0..first)?.into_f64())
            }
        };
        Ok(Self { place: place.clone(), reader, units, seconds })
    }

    /// What one unit of the time stamps is, s.
    pub fn time_unit(&self) -> f64 {
        self.seconds
    }

    /// The array of the images.
    pub fn camera(&self) -> &str {
        self.reader.camera()
    }

    fn start(&self, unit: usize) -> usize {
        unit.checked_sub(1).map_or(0, |before| self.reader.episode_ends()[before])
    }

    /// Names of the labels' arrays: the usual ones, or if one is taken, others.
    fn names(&self) -> [String; 4] {
        let names = [MANO_FORCE, MANO_CONTACT_SCORE, MANO_FORCE_VALID, MANO_CONTACT_VALID];
        let taken = self.reader.arrays().iter().any(|array| array.name.starts_with("data/mano_"));
        names.map(|name| match taken {
            true => name.replacen("data/", &format!("data/{PREDICTED}"), 1),
            false => name.to_string(),
        })
    }
}

impl Source for Store {
    fn units(&self) -> &[Unit] {
        &self.units
    }

    fn shots(&self, unit: usize, from: usize) -> Result<Shots<'_>> {
        let (start, end) = (self.start(unit), self.reader.episode_ends()[unit]);
        let stamps = self.reader.read(TIMESTAMPS, start..end)?.into_f64();
        let shot = move |index: usize| Shot {
            stamp_secs: stamps[index] * self.seconds,
            offset: None,
            picture: self.reader.image(start + index).map(Picture::Pixels).map_err(|error| error.to_string()),
            note: None,
        };
        Ok(Box::new((from..end - start).map(shot)))
    }
}

impl Output for Store {
    fn assemble(&self, journals: &Journals, about: &mut About, at: &Path, _: &Path) -> Result<()> {
        let [force, contact, force_valid, contact_valid] = self.names();
        // An attempt that was killed may have left some of them.
        for name in [&force, &contact, &force_valid, &contact_valid] {
            let array = at.join(name);
            if array.exists() {
                fs::remove_dir_all(&array).map_err(Error::io(&array))?;
            }
        }
        let specs = vec![
            ArraySpec::new(force, [N_FIELD], Dtype::F32),
            ArraySpec::new(contact, [N_FIELD], Dtype::F32),
            ArraySpec::new(force_valid, [N_FIELD], Dtype::U8),
            ArraySpec::new(contact_valid, [N_FIELD], Dtype::U8),
        ];
        fs::create_dir_all(at).map_err(Error::io(at))?;
        let mut arrays = AddedArrays::new(at, specs)?;
        // Two things that share nothing until the store's attributes are written.
        let (copied, added) = std::thread::scope(|scope| {
            let copying = scope.spawn(|| copy(&self.place, at));
            let added = self.units.iter().enumerate().try_for_each(|(index, unit)| {
                let labels = journals.labels(index)?;
                ahead(labels, |labels| add_labels(&mut arrays, unit, labels))
            });
            (copying.join(), added)
        });
        let died = |_| Err(Error::file(at, "the thread that copied the store died"));
        about.summary.lost.extend(copied.unwrap_or_else(died)?);
        added?;
        let mut attributes = Map::new();
        if !self.reader.raw_attributes().contains_key("topology") {
            attributes.insert("topology".into(), about.provenance.topology.id().into());
        }
        attributes.insert(NAME.into(), serde_json::to_value(&*about).unwrap_or(Value::Null));
        arrays.finish(attributes)
    }

    fn check(&self, topology: Topology) -> Result<()> {
        if !self.place.is_v2()? {
            let message = "is a store of Zarr v3, to which no arrays of v2 can be added; --to store writes it anew";
            return Err(Error::file(self.place.to_string(), message));
        }
        match self.reader.raw_attributes().contains_key("topology") {
            true => self.reader.attributes().topology.must_match(topology),
            false => Ok(()),
        }
    }

    fn about(&self, out: &Path) -> Option<About> {
        about(out)
    }
}

/// Appends the labels of a unit, of which there must be one for each frame.
fn add_labels(arrays: &mut AddedArrays, unit: &Unit, labels: &mut dyn Iterator<Item = Result<Label>>) -> Result<()> {
    let mut count = 0;
    for label in labels {
        arrays.push(values(label?))?;
        count += 1;
    }
    match Some(count) == unit.frames {
        true => Ok(()),
        false => Err(Error::value(&unit.name, format!("{} labels", unit.frames.unwrap_or(0)), count)),
    }
}

/// What a labelled store says about its labels.
pub fn about(store: &Path) -> Option<About> {
    let reader = ZarrReader::open(store).ok()?;
    serde_json::from_value(reader.raw_attributes().get(NAME)?.clone()).ok()
}

/// One frame's values: force, contact, and where they are known.
pub(super) fn values(label: Label) -> Vec<Values> {
    let (force, contact) = match label.touch {
        Ok(field) => (field.force, field.contact),
        Err(_) => (vec![f32::NAN; N_FIELD], vec![f32::NAN; N_FIELD]),
    };
    let known = |values: &[f32]| Values::U8(values.iter().map(|value| u8::from(!value.is_nan())).collect());
    let masks = [known(&force), known(&contact)];
    [Values::F32(force), Values::F32(contact)].into_iter().chain(masks).collect()
}

/// Copies a store into the folder `to`; gives what of a zip file can't be read and is left out. A file that is there already
/// and as long was copied before.
fn copy(place: &Place, to: &Path) -> Result<Vec<Lost>> {
    let mut lost = Vec::new();
    let Some(inside) = &place.inside else {
        copy_folder(&place.path, to, true)?;
        return Ok(lost);
    };
    let file = File::open(&place.path).map_err(Error::io(&place.path))?;
    let fail = |error: zip::result::ZipError| Error::file(&place.path, error);
    let mut archive = zip::ZipArchive::new(file).map_err(fail)?;
    for index in 0..archive.len() {
        let mut entry = archive.by_index(index).map_err(fail)?;
        // A name that would leave the folder is refused by `enclosed_name`.
        let Some(name) = entry.enclosed_name() else {
            return Err(Error::file(&place.path, format!("entry {index} would leave the store")));
        };
        let Ok(name) = name.strip_prefix(inside) else { continue };
        let (path, size) = (to.join(name), entry.size());
        if entry.is_dir() {
            fs::create_dir_all(&path).map_err(Error::io(&path))?;
            continue;
        }
        let (offset, bytes) = (entry.data_start().unwrap_or_default(), entry.compressed_size());
        let mut reader = Watched { reader: &mut entry, failure: None };
        let copied = copy_file(&path, size, |file| std::io::copy(&mut reader, file));
        match reader.failure {
            // Without the file its chunk is all fill value, which is valid; with damage nothing reads it.
            Some(failure) => {
                let file = format!("{}: {}", place.path.display(), name.display());
                lost.push(Lost { file, offset, bytes, reason: failure });
            }
            None => copied?,
        }
    }
    Ok(lost)
}

/// A reader that remembers that it failed, to tell damage in the input from a full disk.
struct Watched<R> {
    reader: R,
    failure: Option<String>,
}

impl<R: Read> Read for Watched<R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        self.reader.read(buffer).inspect_err(|error| {
            if error.kind() != std::io::ErrorKind::Interrupted {
                self.failure = Some(error.to_string());
            }
        })
    }
}
