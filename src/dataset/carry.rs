//! Copies of labelled data sets whose fields are carried over to another vertex numbering.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use super::format::Format;
use super::{lerobot, tensors, zarr};
use crate::error::{Error, Result};
use crate::file;
use crate::hand::{FieldMap, Topology};

/// Writes a copy of the data set at `path`, a Zarr store (folder or zip file), a labelled LeRobot data set or a tensor file,
/// to `out` with its fields on the vertices of `to`. The copy appears when it is complete.
///
/// # Errors
/// If it is none of these, its fields are on another topology than the map starts from, a file can't be read, or `out`
/// exists (a tensor file is replaced) or can't be written.
pub fn carry(path: &Path, out: &Path, map: &FieldMap, to: Topology) -> Result<()> {
    let write: fn(&Path, &Path, &FieldMap, Topology) -> Result<()> = match Format::of(path) {
        Some(Format::Store) => zarr::carry,
        Some(Format::LeRobot) => lerobot::carry,
        // A file of any name: commands take tensor files without their extension.
        Some(Format::Tensors) | None if path.is_file() => return carry_tensors(path, out, map, to),
        _ => {
            let expected = "expected a Zarr store, a labelled LeRobot data set or a tensor file";
            return Err(Error::file(path, format!("holds no fields to carry over: {expected}")));
        }
    };
    if out.exists() {
        return Err(Error::file(out, "exists already; choose another name or remove it"));
    }
    let parent = out.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    fs::create_dir_all(parent).map_err(Error::io(parent))?;
    let folder = tempfile::Builder::new().prefix(&file::partial_prefix(out)).tempdir_in(parent);
    let folder = folder.map_err(Error::io(parent))?;
    // A folder within the temporary one: that one is private to the user, the copy gets the usual permissions.
    let at = folder.path().join("copy");
    fs::create_dir(&at).map_err(Error::io(&at))?;
    write(path, &at, map, to)?;
    file::sync_tree(&at)?;
    file::rename(&at, out)
}

fn carry_tensors(path: &Path, out: &Path, map: &FieldMap, to: Topology) -> Result<()> {
    let mut fields = tensors::read(path)?;
    // A file without a topology is taken to be of the one that the map starts from.
    let from = *fields.topology.get_or_insert(to.other());
    if from == to {
        let (got, wanted) = (from.id(), to.other().id());
        let text = format!("topology: expected {wanted} (to transfer to {}), got {got}", to.id());
        return Err(Error::file(path, text));
    }
    tensors::write(out, &fields.carried(map, to)?, BTreeMap::new())
}
