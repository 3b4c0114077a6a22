//! Labels of a store: written as further arrays into a copy of it.

use std::fs;
use std::io::Read;
use std::path::Path;

use serde_json::{Map, Value};

use super::files::open_zip;
use super::images::Store;
use super::{
    AddedArrays, ArraySpec, Dtype, FAMILIARITY, FRAME_VALIDITY, MANO_CONTACT, MANO_CONTACT_SCORE, MANO_CONTACT_VALID,
    MANO_FORCE, MANO_FORCE_VALID, PREDICTED_KEYPOINTS, PRESENCE, StoreLocation, Values, ZarrReader,
};
use crate::dataset::EpisodeReader;
use crate::dataset::copy::{copy_file, copy_folder};
use crate::dataset::label_frame::LabelFrame;
use crate::dataset::label_info::LabelInfo;
use crate::dataset::labels::{LabelOutput, SourceLabels};
use crate::dataset::prefetch::prefetch;
use crate::dataset::provenance::{DoubtRule, PROVENANCE_KEY};
use crate::dataset::source::{LostBytes, Unit};
use crate::error::{Error, Result};
use crate::file::limits;
use crate::hand::{N_KEYPOINTS, Topology};
use crate::tactile::N_FIELD;

/// Prefix of the labels' arrays in stores that hold arrays of these names already, such as truth.
pub const PREDICTED: &str = "predicted_";

impl Store {
    /// Returns the names of the labels' arrays: force, contact, their validity, familiarity and presence.
    fn label_names(&self) -> [String; 6] {
        let names = [MANO_FORCE, MANO_CONTACT_SCORE, MANO_FORCE_VALID, MANO_CONTACT_VALID, FAMILIARITY, PRESENCE];
        let taken = self.reader.arrays().iter().any(|array| array.name.starts_with("data/mano_"));
        names.map(|name| match taken {
            true => predicted(name),
            false => name.to_string(),
        })
    }

    /// Copies the store into the folder `to`. Returns the files that can't be read; those of images are listed with the
    /// images.
    fn copy(&self, to: &Path) -> Result<Vec<LostBytes>> {
        let mut lost = copy(&self.place, to)?;
        let left_out: Vec<String> = lost.iter().map(|lost| lost.file.clone()).collect();
        let damaged = self.reader.damaged_chunks(self.camera())?;
        lost.extend(damaged.into_iter().filter(|damaged| !left_out.contains(&damaged.file)));
        Ok(lost)
    }
}

/// Returns the name of a label array in a store that holds truth: `data/mano_force` becomes `data/predicted_mano_force`.
pub(crate) fn predicted(name: &str) -> String {
    name.replacen("data/", &format!("data/{PREDICTED}"), 1)
}

impl LabelOutput for Store {
    fn assemble(&self, labels: &dyn SourceLabels, info: &mut LabelInfo, at: &Path, _: &Path) -> Result<()> {
        let [force, contact, force_valid, contact_valid, familiarity, presence] = self.label_names();
        // Remove arrays that a killed attempt left.
        let names = [&force, &contact, &force_valid, &contact_valid, &familiarity, &presence];
        for name in names.into_iter().map(String::as_str).chain([PREDICTED_KEYPOINTS]) {
            let array = at.join(name);
            if array.exists() {
                fs::remove_dir_all(&array).map_err(Error::io(&array))?;
            }
        }
        let mut specs = vec![
            ArraySpec::new(force, [N_FIELD], Dtype::F32),
            ArraySpec::new(contact, [N_FIELD], Dtype::F32),
            ArraySpec::new(force_valid, [N_FIELD], Dtype::U8),
            ArraySpec::new(contact_valid, [N_FIELD], Dtype::U8),
        ];
        let estimates = DoubtRule::estimates(info.provenance.doubt.as_ref());
        specs.extend(estimates[0].then(|| ArraySpec::new(familiarity, [], Dtype::F32)));
        specs.extend(estimates[1].then(|| ArraySpec::new(presence, [2], Dtype::F32)));
        let keypoints = info.provenance.keypoints;
        specs.extend(keypoints.then(|| ArraySpec::new(PREDICTED_KEYPOINTS, [2, N_KEYPOINTS, 3], Dtype::F32)));
        fs::create_dir_all(at).map_err(Error::io(at))?;
        let mut arrays = AddedArrays::new(at, specs)?;
        // Copy and labels touch different files until `finish` writes the attributes, so they run at the same time.
        let (copied, added) = std::thread::scope(|scope| {
            let copying = scope.spawn(|| self.copy(at));
            let added = self.units.iter().enumerate().try_for_each(|(index, unit)| {
                let labels = labels.labels(index)?;
                prefetch(labels, |labels| add_labels(&mut arrays, unit, labels, estimates, keypoints))
            });
            (copying.join(), added)
        });
        let died = |_| Err(Error::file(at, "the thread that copied the store died"));
        info.summary.lost.extend(copied.unwrap_or_else(died)?);
        added?;
        let mut attributes = Map::new();
        if !self.reader.raw_attributes().contains_key("topology") {
            attributes.insert("topology".into(), info.provenance.topology.id().into());
        }
        attributes.insert(PROVENANCE_KEY.into(), serde_json::to_value(&*info).unwrap_or(Value::Null));
        arrays.finish(attributes)
    }

    fn check(&self, topology: Topology) -> Result<()> {
        if !self.place.is_v2()? {
            let message = "is a Zarr v3 store, to which v2 arrays can't be added; use --to store to write a new store";
            return Err(Error::file(self.place.to_string(), message));
        }
        match self.reader.raw_attributes().contains_key("topology") {
            true => self.reader.attributes().topology.must_match(topology),
            false => Ok(()),
        }
    }

    fn info(&self, out: &Path) -> Option<LabelInfo> {
        read_info(out)
    }
}

/// Appends the labels of a unit; the unit must have one label per frame.
fn add_labels(
    arrays: &mut AddedArrays,
    unit: &Unit,
    labels: &mut dyn Iterator<Item = Result<LabelFrame>>,
    estimates: [bool; 2],
    keypoints: bool,
) -> Result<()> {
    let mut count = 0;
    for label in labels {
        arrays.push(values(label?, estimates, keypoints))?;
        count += 1;
    }
    match Some(count) == unit.frames {
        true => Ok(()),
        false => Err(Error::value(&unit.name, format!("{} labels", unit.frames.unwrap_or(0)), count)),
    }
}

/// Reads the description of the labels in a store; None without one.
pub fn read_info(store: &Path) -> Option<LabelInfo> {
    let reader = ZarrReader::open(store).ok()?;
    serde_json::from_value(reader.raw_attributes().get(PROVENANCE_KEY)?.clone()).ok()
}

/// Returns the values of one frame: force, contact, and their validity; also familiarity and presence if they are
/// estimated, and the keypoints if they are wanted.
fn values(label: LabelFrame, estimates: [bool; 2], keypoints: bool) -> Vec<Values> {
    let masks = label.masks().map(Values::U8);
    let [familiarity, presence @ ..] = label.estimates();
    let keypoints = keypoints.then(|| Values::F32(label.keypoints()));
    let (force, contact) = label.into_values();
    let mut values: Vec<Values> = [Values::F32(force), Values::F32(contact)].into_iter().chain(masks).collect();
    values.extend(estimates[0].then(|| Values::F32(vec![familiarity])));
    values.extend(estimates[1].then(|| Values::F32(presence.to_vec())));
    values.extend(keypoints);
    values
}

/// True for the file of an array of truth or its validity.
fn is_truth(file: &str) -> bool {
    let names = [MANO_FORCE, MANO_CONTACT, MANO_CONTACT_SCORE, MANO_FORCE_VALID, MANO_CONTACT_VALID, FRAME_VALIDITY];
    names.iter().any(|name| file.strip_prefix(name).is_some_and(|rest| rest.starts_with('/')))
}

/// Copies a store into the folder `to`, skipping files that an earlier attempt copied. Returns the files of a zip archive
/// that can't be read and are left out.
pub(crate) fn copy(place: &StoreLocation, to: &Path) -> Result<Vec<LostBytes>> {
    let mut lost = Vec::new();
    let Some(inside) = &place.inside else {
        copy_folder(&place.path, to, true)?;
        return Ok(lost);
    };
    let fail = |error: zip::result::ZipError| Error::file(&place.path, error);
    let mut archive = open_zip(&place.path)?;
    for index in 0..archive.len() {
        let mut entry = archive.by_index(index).map_err(fail)?;
        // `enclosed_name` refuses names that would lead out of the folder.
        let Some(name) = entry.enclosed_name() else {
            return Err(Error::file(&place.path, format!("entry {index} has a path that leads out of the store")));
        };
        let Ok(name) = name.strip_prefix(inside) else { continue };
        let (path, size) = (to.join(name), entry.size());
        if entry.is_dir() {
            fs::create_dir_all(&path).map_err(Error::io(&path))?;
            continue;
        }
        let (offset, bytes) = (entry.data_start().unwrap_or_default(), entry.compressed_size());
        limits::FILE.check(&place.path, &name.to_string_lossy(), size)?;
        // A deflated file may hold more than the archive's directory states. One byte more, so that the end is reached, where
        // the checksum is checked.
        let mut reader = FailureRecorder { reader: (&mut entry).take(size + 1), failure: None };
        let copied = copy_file(&path, size, |file| match std::io::copy(&mut reader, file)? {
            copied if copied == size => Ok(copied),
            _ => {
                let failure = reader.failure.insert(format!("expected {size} bytes, got another number"));
                Err(std::io::Error::other(failure.clone()))
            }
        });
        match reader.failure {
            // Leave the chunk's file out: a missing chunk reads as the fill value. As truth that would be false, so an empty
            // file, which no reader accepts, stays in its place.
            Some(failure) => {
                if is_truth(&name.to_string_lossy()) {
                    copy_file(&path, 0, |_| Ok(0))?;
                }
                let file = format!("{place}: {}", name.display());
                lost.push(LostBytes { file, offset, bytes, reason: failure });
            }
            None => copied?,
        }
    }
    Ok(lost)
}

/// A reader that records its own failure, to distinguish a damaged input from a full disk.
struct FailureRecorder<R> {
    reader: R,
    failure: Option<String>,
}

impl<R: Read> Read for FailureRecorder<R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        self.reader.read(buffer).inspect_err(|error| {
            if error.kind() != std::io::ErrorKind::Interrupted {
                self.failure = Some(error.to_string());
            }
        })
    }
}
