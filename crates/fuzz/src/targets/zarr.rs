//! Zarr stores with lying metadata and chunks that are damaged, missing or expand.

use std::collections::BTreeMap;
use std::io::{Cursor, Read};
use std::path::Path;

use egotac::Result;
use egotac::dataset::zarr::{ZarrReader, read_truth};
use egotac::dataset::{EpisodeReader, Labelled};

use super::{repository, seed};
use crate::case::Case;
use crate::mutate::{Rng, below, bomb, bytes, chance, extreme, json, pick};

/// Frames that are read one by one.
const FRAMES: usize = 8;

/// Reads the store as `data info`, `train`, `eval`, `report` and `label` do.
pub fn read(path: &Path, scratch: &Path) -> Result<()> {
    let results = [frames(path), Labelled::read(path).map(drop), super::label(path, scratch)];
    results.into_iter().reduce(Result::or).unwrap_or(Ok(()))
}

fn frames(path: &Path) -> Result<()> {
    let store = ZarrReader::open(path)?;
    store.arrays();
    store.specs()?;
    let mut result = Ok(());
    for index in 0..store.len().min(FRAMES) {
        result = result.and(store.frame(index).map(drop));
    }
    result.and(read_truth(&store).map(drop))
}

/// Changes metadata or chunks of a store of the tests.
pub fn make(rng: &mut Rng) -> Case {
    let mut files = match below(rng, 4) {
        0 => unpacked("tests/data/oxt/root.zarr.zip"),
        1 => unpacked("tests/data/oxt/task.zarr.zip"),
        _ => match Case::read(&repository("tests/data/zarr/python.zarr")) {
            Ok(Case::Folder(files)) => files,
            other => panic!("seed python.zarr: {other:?}"),
        },
    };
    let (metadata, chunks): (Vec<String>, Vec<String>) = files.keys().cloned().partition(|name| {
        [".zarray", ".zattrs", ".zgroup", ".zmetadata", "zarr.json"].iter().any(|end| name.ends_with(end))
    });
    for _ in 0..1 + below(rng, 3) {
        let (of_metadata, of_chunks) = (pick(rng, &metadata).clone(), pick(rng, &chunks).clone());
        let text = String::from_utf8_lossy(&files[&of_metadata]).into_owned();
        match below(rng, 8) {
            0 => drop(files.remove(&of_chunks)),
            1 => bytes::change(rng, files.entry(of_chunks).or_default()),
            2 => drop(files.insert(of_chunks, chunk_bomb(rng))),
            3 => drop(files.insert(of_metadata, json::change_text(rng, &text).into_bytes())),
            4 if chance(rng, 0.3) => drop(files.remove(&of_metadata)),
            _ => drop(files.insert(of_metadata, sizes(rng, &text).into_bytes())),
        }
    }
    Case::Folder(files)
}

fn chunk_bomb(rng: &mut Rng) -> Vec<u8> {
    match below(rng, 3) {
        0 => bomb::zstd(*pick(rng, &[1 << 30, 4 << 30]), None),
        1 => bomb::gzip(2 << 30),
        // A header of blosc: version, flags, size of a value, size, block size, packed size.
        _ => {
            let field = (extreme(rng) as u32).to_le_bytes();
            [
                &[2, 1, *pick(rng, &[0x21, 0x31, 0x91, 0x02]), 8][..],
                &field,
                &(1u32 << 20).to_le_bytes(),
                &field,
                &[0; 64],
            ]
            .concat()
        }
    }
}

/// Replaces a number of the shape, of the chunks' shape, or both by the same one.
fn sizes(rng: &mut Rng, text: &str) -> String {
    let Ok(mut value) = serde_json::from_str::<serde_json::Value>(text) else { return text.to_string() };
    let number = extreme(rng);
    let axis = below(rng, 4);
    let which = below(rng, 3);
    for (index, name) in ["shape", "chunks"].into_iter().enumerate() {
        if which != index
            && let Some(side) = value[name].get_mut(axis)
        {
            *side = number.into();
        }
    }
    value.to_string()
}

/// Returns the files of the store in a zip file, without the folder around them.
fn unpacked(zip: &str) -> BTreeMap<String, Vec<u8>> {
    let mut archive =
        zip::ZipArchive::new(Cursor::new(seed(zip))).unwrap_or_else(|error| panic!("seed {zip}: {error}"));
    let mut files = BTreeMap::new();
    for index in 0..archive.len() {
        let Ok(mut member) = archive.by_index(index) else { continue };
        let name = member.name().map(|name| name.to_string()).unwrap_or_default();
        let mut bytes = Vec::new();
        if !name.ends_with('/') && member.read_to_end(&mut bytes).is_ok() {
            files.insert(name, bytes);
        }
    }
    let root = files.keys().filter(|name| name.ends_with(".zgroup")).min_by_key(|name| name.len()).cloned();
    let prefix = root.and_then(|root| root.strip_suffix(".zgroup").map(str::to_string)).unwrap_or_default();
    files.into_iter().filter_map(|(name, bytes)| Some((name.strip_prefix(&prefix)?.to_string(), bytes))).collect()
}
