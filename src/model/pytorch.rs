//! Tensors of PyTorch archives: zip files of a pickle and the bytes of its storages. Nothing in the pickle is executed.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

use candle_core::{Device, Tensor};
use zip::{CompressionMethod, ZipArchive};

use super::finite::check_finite_in;
use crate::error::{Error, Result};
use crate::file::limits;
use crate::numpy::{Id, Names, Outcome, Pickle, StorageReference, Value, View, rebuilt};

/// Names in files of networks and of their training. Those of tensors and storages are interpreted, the others ignored.
const NAMES: Names = Names {
    packages: &["torch", "__torch__", "collections", "numpy", "argparse", "pathlib", "omegaconf", "typing"],
    names: &[
        "_codecs.encode",
        "__builtin__.object",
        "__builtin__.set",
        "__builtin__.list",
        "__builtin__.dict",
        "builtins.object",
        "builtins.set",
        "builtins.list",
        "builtins.dict",
        "copyreg._reconstructor",
        "copy_reg._reconstructor",
    ],
    kind: "a network; save its state_dict alone",
};
/// Names under which programs save the dictionary of tensors, if it is not the outermost value.
const KEYS: [&str; 3] = ["state_dict", "model", "model_state_dict"];
/// Memory of all tensors in f32, bytes: this much, and [`PER_BYTE`] per byte of the file. Bytes become f32, and two names may
/// share a storage.
const BASE: u64 = 64 << 20;
const PER_BYTE: u64 = 8;

/// Reads all tensors of an archive as f32.
///
/// # Errors
/// If it is damaged, has no tensors, or one is of an unknown type, reaches beyond its storage or is not finite.
pub(super) fn tensors(path: &Path, bytes: &[u8]) -> Result<BTreeMap<String, Tensor>> {
    let invalid = |message: String| Error::file(path, format!("not a PyTorch file of tensors: {message}"));
    let mut archive = Archive::open(bytes).map_err(invalid)?;
    let pickle = archive.pickle().map_err(invalid)?;
    let found = find(&pickle).map_err(invalid)?;
    if found.is_empty() {
        let places = KEYS.join(", ");
        return Err(Error::file(path, format!("has no tensors, neither at the top nor under {places}")));
    }
    let mut left = BASE.saturating_add((bytes.len() as u64).saturating_mul(PER_BYTE));
    let (mut tensors, mut n_elements) = (BTreeMap::new(), 0);
    for (name, arguments) in found {
        let damaged = |message: String| Error::file(path, format!("{name}: {message}"));
        let view = archive.view(&pickle, arguments).map_err(damaged)?;
        n_elements += view.count as u64;
        limits::PARAMETERS.check(path, "tensors", n_elements)?;
        let more = "expected tensors of at most eight times the size of the file, got more";
        left = left.checked_sub(4 * view.count as u64).ok_or_else(|| damaged(more.into()))?;
        let values = view.values();
        check_finite_in(path, name, &values)?;
        tensors.insert(name.to_string(), Tensor::from_vec(values, view.size, &Device::Cpu)?);
    }
    Ok(tensors)
}

/// Returns names and arguments of the tensors at the top, or else under one of [`KEYS`].
fn find<'p>(pickle: &'p Pickle) -> Outcome<Vec<(&'p str, Id)>> {
    let root = match pickle.value(pickle.root()) {
        // TorchScript saves its tensors as the state of a module.
        Value::Call { function, state: Some(state), .. } if is_name(pickle, *function, "__torch__.Module") => *state,
        _ => pickle.root(),
    };
    let under = |key: &&str| entries(pickle, root).filter(|(name, _)| name == key).last().map(|(_, id)| id);
    for place in std::iter::once(root).chain(KEYS.iter().filter_map(under)) {
        let mut found = Vec::new();
        for (name, id) in entries(pickle, place) {
            found.extend(rebuilt(pickle, id)?.map(|arguments| (name, arguments)));
        }
        if !found.is_empty() {
            return Ok(found);
        }
    }
    Ok(Vec::new())
}

/// Returns the entries with text keys of a dictionary.
fn entries<'p>(pickle: &'p Pickle, id: Id) -> impl Iterator<Item = (&'p str, Id)> {
    let entries = match pickle.value(id) {
        Value::Dict(entries) => entries.as_slice(),
        _ => &[],
    };
    entries.iter().filter_map(|(key, value)| match pickle.value(*key) {
        Value::Text(name) => Some((name.as_str(), *value)),
        _ => None,
    })
}

fn is_name(pickle: &Pickle, id: Id, wanted: &str) -> bool {
    match pickle.value(id) {
        Value::Global(name) => name == wanted,
        Value::Call { function, .. } => matches!(pickle.value(*function), Value::Global(name) if name == wanted),
        _ => false,
    }
}

/// An archive with stored members, and the storages that were read from it.
struct Archive<'a> {
    bytes: &'a [u8],
    zip: ZipArchive<Cursor<&'a [u8]>>,
    folder: String,
    storages: BTreeMap<String, &'a [u8]>,
}

impl<'a> Archive<'a> {
    fn open(bytes: &'a [u8]) -> Outcome<Self> {
        let zip = ZipArchive::new(Cursor::new(bytes)).map_err(|error| error.to_string())?;
        let names = zip.file_names().filter_map(|name| name.ok());
        let pickles: Vec<String> =
            names.filter(|name| *name == "data.pkl" || name.ends_with("/data.pkl")).map(Into::into).collect();
        let [pickle] = pickles.as_slice() else {
            return Err(format!("expected one member data.pkl, got {}", pickles.len()));
        };
        let folder = pickle.trim_end_matches("data.pkl").to_string();
        Ok(Self { bytes, zip, folder, storages: BTreeMap::new() })
    }

    fn pickle(&mut self) -> Outcome<Pickle<'a>> {
        let order = format!("{}byteorder", self.folder);
        if self.zip.index_for_name(&order).is_some() && self.member(&order)? != b"little" {
            return Err("expected numbers in little-endian order".into());
        }
        Pickle::read_with(self.member(&format!("{}data.pkl", self.folder))?, &NAMES)
    }

    /// Returns the bytes of a member; compressed ones, which PyTorch does not write, are refused.
    fn member(&mut self, name: &str) -> Outcome<&'a [u8]> {
        let member = self.zip.by_name(name).map_err(|error| format!("{name}: {error}"))?;
        if member.compression() != CompressionMethod::Stored || member.encrypted() {
            return Err(format!("{name}: expected a member that is neither compressed nor encrypted"));
        }
        let place = member.data_start().and_then(|start| {
            let start = usize::try_from(start).ok()?;
            Some(start..start.checked_add(usize::try_from(member.size()).ok()?)?)
        });
        let bytes =
            place.and_then(|place| self.bytes.get(place)).ok_or_else(|| format!("{name}: the file ends in it"))?;
        match crc32fast::hash(bytes) == member.crc32() {
            true => Ok(bytes),
            false => Err(format!("{name}: its checksum is wrong")),
        }
    }

    /// Returns the bytes of a storage; each is read and checked once.
    fn storage(&mut self, key: &str) -> Outcome<&'a [u8]> {
        if let Some(bytes) = self.storages.get(key) {
            return Ok(bytes);
        }
        let bytes = self.member(&format!("{}data/{key}", self.folder))?;
        self.storages.insert(key.to_string(), bytes);
        Ok(bytes)
    }

    /// Reads the arguments of `_rebuild_tensor_v2`, whose storage is a member of the archive.
    fn view(&mut self, pickle: &Pickle, arguments: Id) -> Outcome<View<'a>> {
        let Value::Persistent(storage) = *pickle.value(pickle.item(arguments, 0)?) else {
            return Err("expected a reference to a storage".into());
        };
        let storage = StorageReference::read(pickle, storage)?;
        let bytes = self.storage(storage.key)?;
        View::read(pickle, arguments, &storage, bytes)
    }
}
