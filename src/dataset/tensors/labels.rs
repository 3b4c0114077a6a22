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
use crate::dataset::provenance::PROVENANCE_KEY;
use crate::dataset::source::ImageSource;
use crate::error::{Error, Result};
use crate::file::input;
use crate::tactile::N_FIELD;

/// Largest header that is read, bytes; the format's own limit.
const LARGEST_HEADER: u64 = 100 << 20;
/// Size of the write buffer, bytes.
const BUFFER: usize = 1 << 20;

/// Writes `force` and `contact` (T, 1556), `timestamps` (T) s and `episode_ends`; NaN for images without a label.
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
        let mut write = |bytes: &[u8]| file.write_all(bytes).map_err(Error::io(at));
        write(&header(frames, &ends, info, self.with_info)?)?;
        // The file holds one array after the other: read the labels once per array, in constant memory.
        let passes: [fn(&LabelFrame) -> Vec<u8>; 3] = [
            |label| bytes_of(label.touch.as_ref().ok().map(|field| field.force.as_slice())),
            |label| bytes_of(label.touch.as_ref().ok().map(|field| field.contact.as_slice())),
            |label| label.stamp_secs.to_le_bytes().to_vec(),
        ];
        for pass in passes {
            for unit in 0..units {
                for label in labels.labels(unit)? {
                    write(&pass(&label?))?;
                }
            }
        }
        for end in ends {
            write(&(end as i64).to_le_bytes())?;
        }
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
    let n_field = N_FIELD as u64;
    let mut entries = BTreeMap::new();
    entries.insert("force", array("F32", &[frames, n_field], 4));
    entries.insert("contact", array("F32", &[frames, n_field], 4));
    entries.insert("timestamps", array("F64", &[frames], 8));
    entries.insert("episode_ends", array("I64", &[ends.len() as u64], 8));
    let provenance = &info.provenance;
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

fn bytes_of(values: Option<&[f32]>) -> Vec<u8> {
    match values {
        Some(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        None => f32::NAN.to_le_bytes().repeat(N_FIELD),
    }
}

/// Reads the labels of a tensor file; without `episode_ends` they are one episode.
///
/// # Errors
/// If the file can't be read.
pub(crate) fn read_labelled(path: &Path) -> Result<Labelled> {
    let mut labels = super::read(path)?;
    if labels.episode_ends.is_empty() {
        labels.episode_ends = vec![labels.n_frames()];
    }
    Ok(Labelled { labels, truth: None, info: read_info(path) })
}
