//! Truth that `egotac eval` scores against.

use std::path::PathBuf;

use super::groups::Origin;
use crate::dataset::zarr::{self, read_truth};
use crate::error::Result;
use crate::tactile::TactileSequence;

/// Reads the truth of all stores that `paths` name, with the origin of each episode.
pub fn truth(paths: &[PathBuf]) -> Result<(TactileSequence, Vec<Origin>)> {
    let (mut all, mut origins) = (TactileSequence::default(), Vec::new());
    for store in zarr::open_all(paths)? {
        let mut own = read_truth(&store)?;
        if own.episode_ends.is_empty() {
            own.episode_ends = vec![own.n_frames()];
        }
        origins.extend((0..own.episode_ends.len()).map(|episode| Origin::of(&store, episode)));
        all.append(&own)?;
    }
    Ok((all, origins))
}
