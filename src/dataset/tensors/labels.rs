//! Labels of any source in a safetensors file.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Read, Write};
use std::path::Path;
use std::sync::Arc;

use serde_json::json;

use crate::dataset::Labelled;
use crate::dataset::label_frame::LabelFrame;
use crate::dataset::label_info::LabelInfo;
use crate::dataset::labels::{LabelOutput, SourceLabels};
use crate::dataset::provenance::{DoubtRule, PROVENANCE_KEY};
use crate::dataset::source::ImageSource;
use crate::error::{Error, Result};
use crate::file::input;
use crate::hand::N_KEYPOINTS;
use crate::tactile::{N_FIELD, TactileSequence};

/// Largest header that is read, bytes; the format's own limit.
const LARGEST_HEADER: u64 = 100 << 20;
/// Size of the write buffer, bytes.
const BUFFER: usize = 1 << 20;

/// An array with one row per frame.
struct FrameArray {
    name: &'static str,
    dtype: &'static str,
    /// Size of an element, bytes.
    size: u64,
    /// Shape of a row.
    row: &'static [u64],
    /// Bytes of the row of a label.
    values: fn(&LabelFrame) -> Vec<u8>,
}

/// Arrays of every file.
const BASE: [FrameArray; 3] = [
    FrameArray {
        name: "force",
        dtype: "F32",
        size: 4,
        row: VERTICES,
        values: |label| bytes_of(label.touch.as_ref().ok().map(|field| field.force.as_slice())),
    },
    FrameArray {
        name: "contact",
        dtype: "F32",
        size: 4,
        row: VERTICES,
        values: |label| bytes_of(label.touch.as_ref().ok().map(|field| field.contact.as_slice())),
    },
    FrameArray {
        name: "timestamps",
        dtype: "F64",
        size: 8,
        row: &[],
        values: |label| label.stamp_secs.to_le_bytes().to_vec(),
    },
];

/// Returns the arrays of what the network estimates about its images, the masks that follow, and the keypoints.
fn judged(info: &LabelInfo) -> Vec<FrameArray> {
    let [familiarity, presence] = DoubtRule::estimates(info.provenance.doubt.as_ref());
    let array = |name, row, values| FrameArray { name, dtype: "F32", size: 4, row, values };
    let mask = |name, values| FrameArray { name, dtype: "U8", size: 1, row: VERTICES, values };
    let mut arrays = Vec::new();
    arrays.extend(familiarity.then(|| array("familiarity", &[], |label| f32_bytes(&label.estimates()[..1]))));
    arrays.extend(presence.then(|| array("presence", &[2], |label| f32_bytes(&label.estimates()[1..]))));
    if familiarity || presence {
        arrays.push(mask("mask_force", |label| label.masks()[0].clone()));
        arrays.push(mask("mask_contact", |label| label.masks()[1].clone()));
    }
    let keypoints = info.provenance.keypoints;
    arrays.extend(keypoints.then(|| array("predicted_keypoints", KEYPOINTS, |label| f32_bytes(&label.keypoints()))));
    arrays
}

/// Row of the keypoints of both hands.
const KEYPOINTS: &[u64] = &[2, N_KEYPOINTS as u64, 3];
/// Row of an array with a value per vertex.
const VERTICES: &[u64] = &[N_FIELD as u64];

/// Writes `force` and `contact` (T, 1556), `timestamps` (T) s and `episode_ends`; NaN for images without a label. Of a
/// network that judges its images, also `mask_force` and `mask_contact` (T, 1556), `familiarity` (T) and `presence` (T, 2); with
/// keypoints, `predicted_keypoints` (T, 2, 21, 3): x and y in pixels of the image, and confidence.
pub struct TensorOutput {
    /// Source of the labelled images.
    pub source: Arc<dyn ImageSource>,
    /// True to write the [`LabelInfo`] into the metadata.
    pub with_info: bool,
}

impl LabelOutput for TensorOutput {
    fn assemble(&self, labels: &dyn SourceLabels, info: &mut LabelInfo, at: &Path, _: &Path) -> Result<()> {
        let units = self.source.units().len();
        let (mut ends, mut frames) = (Vec::new(), 0u64);
        for unit in 0..units {
            for label in labels.labels(unit)? {
                label?;
                frames += 1;
            }
            if ends.last().copied().unwrap_or(0) < frames {
                ends.push(frames);
            }
        }
        let mut file = BufWriter::with_capacity(BUFFER, File::create(at).map_err(Error::io(at))?);
        let io = || Error::io(at);
        file.write_all(&header(frames, &ends, info, self.with_info)?).map_err(io())?;
        // The file holds one array after the other: read the labels once per array, in constant memory.
        let write = |file: &mut BufWriter<File>, array: &FrameArray| -> Result<()> {
            for unit in 0..units {
                for label in labels.labels(unit)? {
                    file.write_all(&(array.values)(&label?)).map_err(io())?;
                }
            }
            Ok(())
        };
        BASE.iter().try_for_each(|array| write(&mut file, array))?;
        for end in ends {
            file.write_all(&(end as i64).to_le_bytes()).map_err(io())?;
        }
        judged(info).iter().try_for_each(|array| write(&mut file, array))?;
        file.flush().map_err(Error::io(at))
    }

    fn info(&self, out: &Path) -> Option<LabelInfo> {
        read_info(out)
    }
}

/// Reads the description of the labels in a tensor file; None without one.
pub fn read_info(path: &Path) -> Option<LabelInfo> {
    let mut file = input::open(path).ok()?;
    let mut size = [0; 8];
    file.read_exact(&mut size).ok()?;
    let size = Some(u64::from_le_bytes(size)).filter(|size| *size < LARGEST_HEADER)?;
    let mut header = Vec::new();
    file.take(size).read_to_end(&mut header).ok()?;
    let header: serde_json::Value = serde_json::from_slice(&header).ok()?;
    serde_json::from_str(header["__metadata__"][PROVENANCE_KEY].as_str()?).ok()
}

/// Returns the file's header: its size, then name, type, shape and offsets of each array, padded to eight bytes.
fn header(frames: u64, ends: &[u64], info: &LabelInfo, with_info: bool) -> Result<Vec<u8>> {
    let mut start = 0;
    let mut array = |dtype: &str, shape: &[u64], size: u64| {
        let bytes = shape.iter().product::<u64>() * size;
        start += bytes;
        json!({ "dtype": dtype, "shape": shape, "data_offsets": [start - bytes, start] })
    };
    let provenance = &info.provenance;
    let mut entries = BTreeMap::new();
    for FrameArray { name, dtype, size, row, .. } in &BASE {
        entries.insert(*name, array(dtype, &[&[frames], *row].concat(), *size));
    }
    entries.insert("episode_ends", array("I64", &[ends.len() as u64], 8));
    for FrameArray { name, dtype, size, row, .. } in judged(info) {
        entries.insert(name, array(dtype, &[&[frames], row].concat(), size));
    }
    let mut metadata = json!({
        "topology": provenance.topology,
        "force_kind": provenance.force_kind,
        "model": provenance.model,
        "checkpoint_sha256": provenance.model_sha256,
    });
    let failed = |error| Error::value(PROVENANCE_KEY, "JSON", error);
    if with_info {
        metadata[PROVENANCE_KEY] = serde_json::to_string(info).map_err(failed)?.into();
    }
    entries.insert("__metadata__", metadata);
    let mut json = serde_json::to_vec(&entries).map_err(failed)?;
    json.resize(json.len().next_multiple_of(8), b' ');
    Ok([&(json.len() as u64).to_le_bytes()[..], &json].concat())
}

fn f32_bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn bytes_of(values: Option<&[f32]>) -> Vec<u8> {
    match values {
        Some(values) => f32_bytes(values),
        None => f32::NAN.to_le_bytes().repeat(N_FIELD),
    }
}

/// Makes touch NaN where the masks are 0.
fn hide_masked(labels: &mut TactileSequence) {
    let TactileSequence { force, contact, mask_force, mask_contact, .. } = labels;
    for (values, mask) in [(force, mask_force), (contact, mask_contact)] {
        values.iter_mut().zip(mask.iter()).filter(|(_, mask)| **mask == 0).for_each(|(value, _)| *value = f32::NAN);
    }
}

/// Reads the labels of a tensor file; without `episode_ends` they are one episode.
///
/// # Errors
/// If the file can't be read.
pub(crate) fn read_labelled(path: &Path) -> Result<Labelled> {
    let mut labels = super::read(path)?;
    hide_masked(&mut labels);
    if labels.episode_ends.is_empty() {
        labels.episode_ends = vec![labels.n_frames()];
    }
    Ok(Labelled { labels, truth: None, info: read_info(path) })
}
