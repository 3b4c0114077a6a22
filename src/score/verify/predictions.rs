//! Predictions read from files, to be scored against stores.

use std::path::{Path, PathBuf};

use crate::dataset::tensors;
use crate::dataset::zarr::{ZarrReader, open_all, read_fields};
use crate::error::{Error, Result};
use crate::tactile::TactileSequence;

/// Reads predictions for `stores` from tensor files or stores (or folders of stores), in the given order.
///
/// # Errors
/// If one can't be read, two differ in topology, or they don't have as many frames as the stores.
pub fn read(paths: &[PathBuf], stores: &[ZarrReader]) -> Result<TactileSequence> {
    let mut all = TactileSequence::default();
    for path in paths {
        for sequence in read_path(path)? {
            all.append(&sequence).map_err(|error| Error::file(path, error))?;
        }
    }
    let frames: usize = stores.iter().map(ZarrReader::len).sum();
    match all.n_frames() {
        0 => Err(Error::value("predictions", "at least one frame", "none")),
        n if n != frames => Err(Error::value("predictions", format!("{frames} frames, as the episodes have"), n)),
        _ => Ok(all),
    }
}

fn read_path(path: &Path) -> Result<Vec<TactileSequence>> {
    match path.is_dir() {
        true => open_all(&[path.to_path_buf()])?.iter().map(|store| read_fields(store, 0..store.len())).collect(),
        false => Ok(vec![tensors::read(path)?]),
    }
}
