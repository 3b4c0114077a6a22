//! Fields that `egotac eval` reads; with MANO files, on MANO's vertices.

use std::path::{Path, PathBuf};

use super::Args;
use super::groups::Origin;
use crate::dataset::tensors;
use crate::dataset::zarr::{self, read_truth};
use crate::error::{Error, Result};
use crate::hand::Topology;
use crate::tactile::TactileSequence;

/// Reads a field file.
pub fn read(args: &Args, path: &Path) -> Result<TactileSequence> {
    let fields = tensors::read(path)?;
    match args.hands.map()? {
        Some(mano) => fields.carried(&mano, Topology::Mano).map_err(|error| Error::file(path, error)),
        None => Ok(fields),
    }
}

/// Reads the truth of all stores that `paths` name, with the origin of each episode.
pub fn truth(args: &Args, paths: &[PathBuf]) -> Result<(TactileSequence, Vec<Origin>)> {
    let (mut all, mut origins) = (TactileSequence::default(), Vec::new());
    let mano = args.hands.map()?;
    for store in zarr::open_all(paths)? {
        let mut own = read_truth(&store)?;
        if let Some(mano) = &mano {
            own = own.carried(mano, Topology::Mano)?;
        }
        if own.episode_ends.is_empty() {
            own.episode_ends = vec![own.n_frames()];
        }
        origins.extend((0..own.episode_ends.len()).map(|episode| Origin::of(&store, episode)));
        all.append(&own)?;
    }
    Ok((all, origins))
}
