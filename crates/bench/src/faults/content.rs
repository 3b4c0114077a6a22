//! Content of an output: its files, and which label stands beside which image.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use egotac::dataset::Labelled;
use egotac::error::{Error, Result};
use egotac::file;
use egotac::label::{FormatOptions, find_tasks};

/// Labelled camera of the LeRobot data set.
pub const CAMERA: &str = "observation.images.head";

/// An image with its label.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// Hash of the pixels; None = the image can't be read.
    pub picture: Option<String>,
    /// Hash of force and contact; None = no label.
    pub label: Option<String>,
    /// Bits of the label's stamp, s.
    pub stamp: u64,
}

/// Reads images and labels of the data set at `path`, in order.
///
/// # Errors
/// If it can't be read, or has not as many labels as images.
pub fn entries(path: &Path) -> Result<Vec<Entry>> {
    // Names that no output has: the data set is opened as one that could be labelled again.
    let options = FormatOptions {
        camera: path.join("meta/info.json").is_file().then(|| CAMERA.into()),
        frame_dt: 0.04,
        prefix: Some("again".into()),
        labels_topic: Some("/again".into()),
        ..FormatOptions::default()
    };
    let mut pictures = Vec::new();
    for task in find_tasks(path, Path::new("/again"), &options)?.tasks {
        for unit in 0..task.source.units().len() {
            for frame in task.source.frames(unit, 0)? {
                let pixels = frame?.image.ok().and_then(|image| image.decode().ok());
                pictures.push(pixels.map(|pixels| file::sha256(pixels.as_raw())));
            }
        }
    }
    let labels = Labelled::read(path)?.labels;
    if labels.n_frames() != pictures.len() {
        let message = format!("expected a label for each of {} images, got {}", pictures.len(), labels.n_frames());
        return Err(Error::file(path, message));
    }
    let entry = |(frame, picture): (usize, Option<String>)| {
        let values = labels.force_at(frame).iter().chain(labels.contact_at(frame));
        let known = values.clone().any(|value| !value.is_nan());
        let bytes: Vec<u8> = values.flat_map(|value| value.to_le_bytes()).collect();
        let stamp = labels.stamp_or_index(frame).to_bits();
        Entry { picture, label: known.then(|| file::sha256(&bytes)), stamp }
    };
    Ok(pictures.into_iter().enumerate().map(entry).collect())
}

/// Returns the content of every file below `path`, by relative path; of a file, its own.
///
/// # Errors
/// If one can't be read.
pub fn files(path: &Path) -> Result<BTreeMap<PathBuf, Vec<u8>>> {
    let mut found = BTreeMap::new();
    match path.is_file() {
        true => drop(found.insert(PathBuf::new(), fs::read(path).map_err(Error::io(path))?)),
        false => collect(path, Path::new(""), &mut found)?,
    }
    Ok(found)
}

fn collect(root: &Path, below: &Path, found: &mut BTreeMap<PathBuf, Vec<u8>>) -> Result<()> {
    let folder = root.join(below);
    for entry in fs::read_dir(&folder).map_err(Error::io(&folder))? {
        let name = below.join(entry.map_err(Error::io(&folder))?.file_name());
        let path = root.join(&name);
        if name.ends_with(".lock") {
            continue; // empty; a run whose folder was moved away leaves it there
        }
        match path.is_dir() {
            true => collect(root, &name, found)?,
            false => drop(found.insert(name, fs::read(&path).map_err(Error::io(&path))?)),
        }
    }
    Ok(())
}

/// True if two files have the same content; in safetensors files, the header's keys may stand in any order.
pub fn is_same(name: &Path, a: &[u8], b: &[u8]) -> bool {
    a == b || name.extension().is_some_and(|e| e == "safetensors") && tensors(a).is_some_and(|a| Some(a) == tensors(b))
}

/// Splits a safetensors file into header and values.
fn tensors(bytes: &[u8]) -> Option<(serde_json::Value, &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<8>()?;
    let (header, values) = rest.split_at_checked(u64::from_le_bytes(*length) as usize)?;
    Some((serde_json::from_slice(header).ok()?, values))
}

/// Checks that a file is whole, as far as its kind has an end that can be told.
///
/// # Errors
/// If it is not; the error says why.
pub fn whole(path: &Path, bytes: &[u8]) -> std::result::Result<(), String> {
    let said = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("safetensors") => safetensors::SafeTensors::deserialize(bytes).map(drop).map_err(|e| said(&e)),
        Some("json") => serde_json::from_slice::<serde_json::Value>(bytes).map(drop).map_err(|e| said(&e)),
        Some("yaml") => serde_yaml::from_slice::<serde_yaml::Value>(bytes).map(drop).map_err(|e| said(&e)),
        Some("png") => ::image::load_from_memory(bytes).map(drop).map_err(|e| said(&e)),
        Some("svg") if !bytes.trim_ascii_end().ends_with(b"</svg>") => Err(said(&"has no end")),
        _ => Ok(()),
    }
}
