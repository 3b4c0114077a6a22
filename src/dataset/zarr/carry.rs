//! A copy of a store whose fields are carried over to another vertex numbering.

use std::path::Path;

use serde_json::{Map, Value, json};

use super::rewrite::{Block, rewrite};
use super::{LEFT_HAND_POSE, MANO_FORCE, MANO_FORCE_VALID, RIGHT_HAND_POSE, StoreLocation, Values, ZarrReader};
use crate::dataset::EpisodeReader;
use crate::dataset::provenance::PROVENANCE_KEY;
use crate::error::{Error, Result};
use crate::hand::{FieldMap, HandParams, Side, Topology};
use crate::tactile::N_FIELD;

/// Numbers of a hand's pose.
const POSE: usize = 61;

/// Writes a copy of the store at `path` (folder or zip file) into the folder `at`, with all arrays of shape (T, 1556) on the
/// vertices of `to`: forces with their sum kept, everything else by the nearest vertex. Hand poses keep wrist and rotations.
///
/// # Errors
/// If the store is damaged, of another topology than the map starts from, or states none, or `at` can't be written.
pub(crate) fn carry(path: &Path, at: &Path, map: &FieldMap, to: Topology) -> Result<()> {
    let reader = ZarrReader::open_at(&StoreLocation::only(path)?)?;
    if !reader.raw_attributes().contains_key("topology") {
        return Err(Error::file(path, "states no topology: it holds no fields to carry over"));
    }
    reader.attributes().topology.must_match(to.other()).map_err(|error| Error::file(path, error))?;
    let arrays = reader.arrays().into_iter().filter(|info| {
        let is_field = info.shape.len() == 2 && info.shape[1] == N_FIELD;
        let is_pose = [LEFT_HAND_POSE, RIGHT_HAND_POSE].contains(&info.name.as_str()) && info.shape[1..] == [POSE];
        info.name.starts_with("data/") && (is_field || is_pose)
    });
    let names: Vec<String> = arrays.map(|info| info.name).collect();
    rewrite(path, &reader, at, &names, attributes(&reader, map, to), |block| carried(block, map, to))
}

/// Carries over the values of several frames of one array.
fn carried(Block { name, values }: Block, map: &FieldMap, to: Topology) -> Result<Values> {
    let side = [LEFT_HAND_POSE, RIGHT_HAND_POSE].iter().position(|pose| *pose == name).map(|side| Side::BOTH[side]);
    Ok(match (values, side) {
        (Values::F32(poses), Some(side)) => {
            Values::F32(poses.as_chunks().0.iter().flat_map(|pose| posed(pose, side, map, to)).collect())
        }
        (Values::F32(force), None) if name == MANO_FORCE => Values::F32(map.force(to, &force)?),
        (Values::F32(values), None) => Values::F32(map.nearest(to, &values)?),
        (Values::U8(mask), None) if name == MANO_FORCE_VALID => Values::U8(map.force_mask(to, &mask)?),
        (Values::U8(values), None) => Values::U8(map.nearest(to, &values)?),
        (other, _) => return Err(Error::value(name, "dtype u8 or f32", other.dtype())),
    })
}

/// Carries over the parameters of a hand; all 0 (absent) and NaN (unknown) stay.
fn posed(pose: &[f32; POSE], side: Side, map: &FieldMap, to: Topology) -> [f32; POSE] {
    match pose.iter().all(|number| *number == 0.0) || pose.iter().any(|number| number.is_nan()) {
        true => *pose,
        false => map.params(side, to, &HandParams::from_array(pose)).to_array(),
    }
}

fn attributes(reader: &ZarrReader, map: &FieldMap, to: Topology) -> Map<String, Value> {
    let mut attributes = Map::new();
    attributes.insert("topology".into(), to.id().into());
    let carried = json!({
        "from": to.other().id(),
        "mano_sha256": map.sha256(),
        "force": "total of each hand kept",
        "contact": "of the nearest vertex",
        "hand_pose": "wrist and rotations kept, betas 0",
    });
    attributes.insert("carried_over".into(), carried);
    if let Some(Value::Object(mut labels)) = reader.raw_attributes().get(PROVENANCE_KEY).cloned() {
        labels.insert("topology".into(), to.id().into());
        labels.insert("hand_model".into(), to.hand_model().into());
        labels.insert("mano_sha256".into(), json!(map.sha256()));
        attributes.insert(PROVENANCE_KEY.into(), Value::Object(labels));
    }
    attributes
}
