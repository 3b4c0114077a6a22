//! A copy of a store with changed values of some arrays.

use std::path::Path;

use serde_json::{Map, Value};

use super::labels::copy;
use super::{AddedArrays, ArraySpec, Dtype, StoreLocation, Values, ZarrReader};
use crate::dataset::copy::remove;
use crate::error::{Error, Result};

/// Number of frames changed at a time.
const BLOCK: usize = 64;

/// Values of several frames of an array.
pub(crate) struct Block<'a> {
    /// Name of the array, without the prefix of predictions.
    pub name: &'a str,
    /// Values, row-major.
    pub values: Values,
}

/// Writes a copy of the store of `reader`, which lies at `path` (folder or zip file), into the folder `at`. The values of the
/// arrays in `names`, of u8 or f32, go through `change`, which keeps their number and type; `attributes` are set in addition.
///
/// # Errors
/// If the store is damaged or of another version than 2, an array has another type, `change` fails, or `at` can't be written.
pub(crate) fn rewrite(
    path: &Path,
    reader: &ZarrReader,
    at: &Path,
    names: &[String],
    attributes: Map<String, Value>,
    change: impl Fn(Block) -> Result<Values>,
) -> Result<()> {
    let place = StoreLocation::only(path)?;
    if !place.is_v2()? {
        return Err(Error::file(path, "is a Zarr v3 store; expected v2, as egotac and OXT write it"));
    }
    if let Some(lost) = copy(&place, at)?.first() {
        return Err(Error::file(path, format!("{} can't be read: {}", lost.file, lost.reason)));
    }
    let specs = specs(reader, names)?;
    for spec in &specs {
        remove(&at.join(&spec.name))?;
    }
    let mut arrays = AddedArrays::new(at, specs.clone())?;
    for start in (0..reader.len()).step_by(BLOCK) {
        let frames = start..(start + BLOCK).min(reader.len());
        let block = |spec: &ArraySpec| {
            let name = spec.name.replace("data/predicted_", "data/");
            change(Block { name: &name, values: reader.read(&spec.name, frames.clone())? })
        };
        let blocks: Vec<Values> = specs.iter().map(block).collect::<Result<_>>()?;
        for frame in 0..frames.len() {
            let one = |(spec, block): (&ArraySpec, &Values)| {
                let width: usize = spec.item.iter().product();
                block.slice(frame * width..(frame + 1) * width)
            };
            arrays.push(specs.iter().zip(&blocks).map(one).collect())?;
        }
    }
    arrays.finish(attributes)
}

fn specs(reader: &ZarrReader, names: &[String]) -> Result<Vec<ArraySpec>> {
    let mut specs = Vec::new();
    for info in reader.arrays().into_iter().filter(|info| names.contains(&info.name)) {
        let dtype = match info.dtype.as_str() {
            "u8" => Dtype::U8,
            "f32" => Dtype::F32,
            other => {
                let expected = format!("{}: expected dtype u8 or f32, got {other}", info.name);
                return Err(Error::file(reader.path(), expected));
            }
        };
        specs.push(ArraySpec::new(info.name, &info.shape[1..], dtype));
    }
    Ok(specs)
}
