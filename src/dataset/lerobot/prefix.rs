//! Names of the columns of labels.

use super::LeRobot;
use crate::error::{Error, Result};
use crate::tactile::N_FIELD;

/// Returns the prefix of the columns of labels.
///
/// # Errors
/// If there are none.
pub(super) fn prefix(dataset: &LeRobot) -> Result<&str> {
    let is_force = |(name, feature): (&'_ String, &serde_json::Value)| {
        let prefix = name.strip_suffix(".force");
        prefix.filter(|_| feature["shape"][0].as_u64() == Some(N_FIELD as u64)).map(str::len)
    };
    let features = dataset.info["features"].as_object().into_iter().flatten();
    let found = features.filter_map(|(name, feature)| Some(&name[..is_force((name, feature))?])).next();
    found.ok_or_else(|| Error::file(&dataset.root, "holds no labels: no feature PREFIX.force of 1556 numbers"))
}
