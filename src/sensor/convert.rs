//! Copies of fields whose forces are of the other kind: readings at vertices, or forces spread over them.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde_json::{Map, Value};

use super::map::TaxelMap;
use crate::dataset::tensors;
use crate::dataset::zarr::{Block, MANO_FORCE, MANO_FORCE_VALID, StoreLocation, Values, ZarrReader, rewrite};
use crate::dataset::{EpisodeReader, Format};
use crate::error::{Error, Result};
use crate::file;
use crate::tactile::{ForceKind, N_FIELD, TactileSequence};

impl TaxelMap {
    /// Turns forces, (n, 1556), into those of another kind; vertices without a taxel become NaN.
    ///
    /// # Errors
    /// If the number of values is not a multiple of 1556.
    pub fn converted(&self, force: &[f32], to: ForceKind) -> Result<Vec<f32>> {
        match to {
            ForceKind::Spread => self.spread_of_reading(force),
            ForceKind::Reading => self.reading_of_spread(force),
        }
    }

    /// Returns a mask of forces, (n, 1556), without the vertices that have no taxel.
    fn covered_of(&self, mask: &[u8]) -> Vec<u8> {
        let covered = self.hands.iter().flat_map(|hand| hand.covered()).cycle();
        mask.iter().zip(covered).map(|(mask, covered)| u8::from(*mask != 0 && covered)).collect()
    }
}

/// Writes a copy of the fields at `path`, a Zarr store (folder or zip file) or a tensor file, to `out` with forces of the kind
/// `to`; forces of vertices that no taxel covers become unknown.
///
/// # Errors
/// If it is neither, its forces are of that kind already or on another topology than the map, a file can't be read, or `out`
/// exists (a tensor file is replaced) or can't be written.
pub fn convert(path: &Path, out: &Path, map: &TaxelMap, to: ForceKind) -> Result<()> {
    match Format::of(path) {
        Some(Format::Store) => convert_store(path, out, map, to),
        Some(Format::Tensors) | None if path.is_file() => convert_tensors(path, out, map, to),
        _ => Err(Error::file(path, "holds no forces to convert: expected a Zarr store or a tensor file")),
    }
}

fn convert_tensors(path: &Path, out: &Path, map: &TaxelMap, to: ForceKind) -> Result<()> {
    let fields = tensors::read(path)?;
    let named = |error| Error::file(path, error);
    fields.topology.unwrap_or_default().must_match(map.topology).map_err(named)?;
    check(fields.force_kind, to).map_err(named)?;
    let mask = match fields.mask_force.is_empty() {
        true => vec![1; fields.force.len()],
        false => fields.mask_force,
    };
    let force = map.converted(&fields.force, to)?;
    let converted = TactileSequence { force, mask_force: map.covered_of(&mask), force_kind: Some(to), ..fields };
    tensors::write(out, &converted, BTreeMap::new())
}

fn convert_store(path: &Path, out: &Path, map: &TaxelMap, to: ForceKind) -> Result<()> {
    let reader = ZarrReader::open_at(&StoreLocation::only(path)?)?;
    let named = |error| Error::file(path, error);
    reader.attributes().topology.must_match(map.topology).map_err(named)?;
    check(reader.force_kind()?, to).map_err(named)?;
    if out.exists() {
        return Err(Error::file(out, "exists already; choose another name or remove it"));
    }
    let names = [MANO_FORCE, MANO_FORCE_VALID].map(str::to_string);
    let mut attributes = Map::new();
    attributes.insert(ForceKind::ATTRIBUTE.into(), to.id().into());
    attributes.insert("sensor".into(), Value::String(map.layout.name.clone()));
    let change = |Block { name, values }: Block| match values {
        Values::F32(force) if force.len().is_multiple_of(N_FIELD) => Ok(Values::F32(map.converted(&force, to)?)),
        Values::U8(mask) => Ok(Values::U8(map.covered_of(&mask))),
        other => Err(Error::value(name, "dtype f32 (force) or u8 (mask)", other.dtype())),
    };
    let parent = out.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    fs::create_dir_all(parent).map_err(Error::io(parent))?;
    let folder = tempfile::Builder::new().prefix(&file::partial_prefix(out)).tempdir_in(parent);
    let folder = folder.map_err(Error::io(parent))?;
    let at = folder.path().join("copy");
    fs::create_dir(&at).map_err(Error::io(&at))?;
    rewrite(path, &reader, &at, &names, attributes, change)?;
    file::sync_tree(&at)?;
    file::rename(&at, out)
}

/// Checks that forces are of the other kind.
fn check(from: Option<ForceKind>, to: ForceKind) -> Result<()> {
    match from {
        Some(from) if from != to => Ok(()),
        from => {
            let other = if to == ForceKind::Spread { ForceKind::Reading } else { ForceKind::Spread };
            let got = from.map_or("none", ForceKind::id);
            Err(Error::value(ForceKind::ATTRIBUTE, format!("{} (to convert to {})", other.id(), to.id()), got))
        }
    }
}
