//! Labels of any source in a safetensors file, as `egotac predict` writes it.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Read, Write};
use std::path::Path;
use std::sync::Arc;

use serde_json::json;

use super::journal::Label;
use super::output::{Journals, Output};
use super::provenance::NAME;
use super::source::Source;
use super::summary::About;
use crate::error::{Error, Result};
use crate::tactile::N_FIELD;

/// Writes `force` and `contact` (T, 1556), `timestamps` (T) s and `episode_ends`; NaN where there is no label.
pub struct ToTensors {
    /// What was labelled.
    pub source: Arc<dyn Source>,
}

impl Output for ToTensors {
    fn assemble(&self, journals: &Journals, about: &mut About, at: &Path, _: &Path) -> Result<()> {
        let units = self.source.units().len();
        let (mut ends, mut frames) = (Vec::new(), 0u64);
        for unit in 0..units {
            for label in journals.labels(unit)? {
                label?;
                frames += 1;
            }
            if ends.last().copied().unwrap_or(0) < frames {
                ends.push(frames);
            }
        }
        let mut file = BufWriter::with_capacity(1 << 20, File::create(at).map_err(Error::io(at))?);
        let mut write = |bytes: &[u8]| file.write_all(bytes).map_err(Error::io(at));
        write(&header(frames, &ends, about)?)?;
        // The file holds one array after the other: a pass over the journals for each, in constant memory.
        let passes: [fn(&Label) -> Vec<u8>; 3] = [
            |label| field(label.touch.as_ref().ok().map(|field| field.force.as_slice())),
            |label| field(label.touch.as_ref().ok().map(|field| field.contact.as_slice())),
            |label| label.stamp_secs.to_le_bytes().to_vec(),
        ];
        for bytes_of in passes {
            for unit in 0..units {
                for label in journals.labels(unit)? {
                    write(&bytes_of(&label?))?;
                }
            }
        }
        for end in ends {
            write(&(end as i64).to_le_bytes())?;
        }
        file.flush().map_err(Error::io(at))
    }

    fn about(&self, out: &Path) -> Option<About> {
        about(out)
    }
}

/// What a file of labels says about them.
pub fn about(path: &Path) -> Option<About> {
    const LARGEST: u64 = 100 << 20;
    let mut file = File::open(path).ok()?;
    let mut size = [0; 8];
    file.read_exact(&mut size).ok()?;
    let size = Some(u64::from_le_bytes(size)).filter(|size| *size < LARGEST)?;
    let mut header = Vec::new();
    file.take(size).read_to_end(&mut header).ok()?;
    let header: serde_json::Value = serde_json::from_slice(&header).ok()?;
    serde_json::from_str(header["__metadata__"][NAME].as_str()?).ok()
}

/// The file's head: its size, then names, types, shapes and places of the arrays, padded to eight bytes.
fn header(frames: u64, ends: &[u64], about: &About) -> Result<Vec<u8>> {
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
    let text = serde_json::to_string(about).map_err(|e| Error::value(NAME, "JSON", e))?;
    let provenance = &about.provenance;
    let metadata = json!({
        "topology": provenance.topology,
        "model": provenance.model,
        "checkpoint_sha256": provenance.model_sha256,
        (NAME): text,
    });
    entries.insert("__metadata__", metadata);
    let mut json = serde_json::to_vec(&entries).map_err(|e| Error::value(NAME, "JSON", e))?;
    json.resize(json.len().next_multiple_of(8), b' ');
    Ok([&(json.len() as u64).to_le_bytes()[..], &json].concat())
}

fn field(values: Option<&[f32]>) -> Vec<u8> {
    match values {
        Some(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        None => f32::NAN.to_le_bytes().repeat(N_FIELD),
    }
}
