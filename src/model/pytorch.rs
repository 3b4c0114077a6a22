//! Tensors of PyTorch archives: zip files of a pickle and the bytes of its storages. Nothing in the pickle is executed.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

use candle_core::{Device, Tensor};
use zip::{CompressionMethod, ZipArchive};

use super::weights;
use crate::error::{Error, Result};
use crate::file::limits;
use crate::numpy::{Id, Names, Outcome, Pickle, Value, check_rank};

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
        weights::finite(path, name, &values)?;
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

/// Returns the arguments of `_rebuild_tensor_v2` if the value is a tensor, or a parameter or subclass around one.
fn rebuilt(pickle: &Pickle, id: Id) -> Outcome<Option<Id>> {
    let Value::Call { mut function, mut args, .. } = *pickle.value(id) else { return Ok(None) };
    if is_name(pickle, function, "torch._utils._rebuild_parameter") {
        match *pickle.value(pickle.item(args, 0)?) {
            Value::Call { function: inner, args: of_inner, .. } => (function, args) = (inner, of_inner),
            _ => return Ok(None),
        }
    } else if is_name(pickle, function, "torch._tensor._rebuild_from_type_v2") {
        (function, args) = (pickle.item(args, 0)?, pickle.item(args, 2)?);
    }
    Ok(is_name(pickle, function, "torch._utils._rebuild_tensor_v2").then_some(args))
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

    /// Reads the arguments of `_rebuild_tensor_v2`: storage, offset, size, stride (in elements), and others without meaning
    /// here. The storage is a reference ("storage", type, key, device, number of elements).
    fn view(&mut self, pickle: &Pickle, arguments: Id) -> Outcome<View<'a>> {
        let Value::Persistent(storage) = *pickle.value(pickle.item(arguments, 0)?) else {
            return Err("expected a reference to a storage".into());
        };
        let text = |id: Id| match pickle.value(id) {
            Value::Text(text) | Value::Global(text) => Ok(text.as_str()),
            _ => Err("expected a storage with a type and a name".to_string()),
        };
        let whole = |id: Id| match pickle.value(id) {
            Value::Int(number) => usize::try_from(*number).map_err(|_| format!("expected a number >= 0, got {number}")),
            _ => Err("expected a whole number".to_string()),
        };
        let kind = text(pickle.item(storage, 1)?)?;
        let number = Number::of_storage(kind.rsplit('.').next().unwrap_or(kind))?;
        let (key, length) = (text(pickle.item(storage, 2)?)?, whole(pickle.item(storage, 4)?)?);
        let bytes = self.storage(key)?;
        let bytes = length.checked_mul(number.size()).and_then(|n_bytes| bytes.get(..n_bytes)).ok_or_else(|| {
            format!("expected a storage of {length} numbers of {} bytes, got {} bytes", number.size(), bytes.len())
        })?;
        let start = whole(pickle.item(arguments, 1)?)?;
        let (size, stride) = (pickle.shape(pickle.item(arguments, 2)?)?, pickle.shape(pickle.item(arguments, 3)?)?);
        View::new(number, bytes, length, start, size, stride)
    }
}

/// Type of the numbers of a storage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Number {
    F16,
    Bf16,
    F32,
    F64,
    U8,
    I8,
    I16,
    I32,
    I64,
}

impl Number {
    fn of_storage(class: &str) -> Outcome<Self> {
        match class {
            "HalfStorage" => Ok(Self::F16),
            "BFloat16Storage" => Ok(Self::Bf16),
            "FloatStorage" => Ok(Self::F32),
            "DoubleStorage" => Ok(Self::F64),
            "ByteStorage" | "BoolStorage" => Ok(Self::U8),
            "CharStorage" => Ok(Self::I8),
            "ShortStorage" => Ok(Self::I16),
            "IntStorage" => Ok(Self::I32),
            "LongStorage" => Ok(Self::I64),
            _ => Err(format!("expected a storage of floating point numbers, integers or bytes, got {class}")),
        }
    }

    fn size(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::F16 | Self::Bf16 | Self::I16 => 2,
            Self::F32 | Self::I32 => 4,
            Self::F64 | Self::I64 => 8,
        }
    }
}

/// A tensor in the bytes of its storage; all its places lie inside.
struct View<'a> {
    number: Number,
    bytes: &'a [u8],
    start: usize,
    size: Vec<usize>,
    stride: Vec<usize>,
    count: usize,
}

impl<'a> View<'a> {
    fn new(
        number: Number,
        bytes: &'a [u8],
        length: usize,
        start: usize,
        size: Vec<usize>,
        stride: Vec<usize>,
    ) -> Outcome<Self> {
        check_rank(size.len())?;
        let product = |least: usize| size.iter().try_fold(1usize, |count, n| count.checked_mul((*n).max(least)));
        let last = size
            .iter()
            .zip(&stride)
            .try_fold(start, |last, (n, step)| last.checked_add(n.saturating_sub(1).checked_mul(*step)?));
        // A tensor without elements has no place, but its other sizes must not overflow either.
        let (count, inside) = match product(0) {
            Some(0) => (0, product(1).is_some()),
            Some(count) => (count, count <= length && last.is_some_and(|last| last < length)),
            None => (0, false),
        };
        match inside && size.len() == stride.len() {
            true => Ok(Self { number, bytes, start, size, stride, count }),
            false => Err(format!(
                "expected a tensor inside its storage of {length} numbers, got size {size:?} with stride {stride:?} from {start}"
            )),
        }
    }

    fn values(&self) -> Vec<f32> {
        match self.number {
            Number::F16 => self.convert(|b| half::f16::from_le_bytes(b).to_f32()),
            Number::Bf16 => self.convert(|b| half::bf16::from_le_bytes(b).to_f32()),
            Number::F32 => self.convert(f32::from_le_bytes),
            Number::F64 => self.convert(|b| f64::from_le_bytes(b) as f32),
            Number::U8 => self.convert(|[byte]| f32::from(byte)),
            Number::I8 => self.convert(|b| f32::from(i8::from_le_bytes(b))),
            Number::I16 => self.convert(|b| f32::from(i16::from_le_bytes(b))),
            Number::I32 => self.convert(|b| i32::from_le_bytes(b) as f32),
            Number::I64 => self.convert(|b| i64::from_le_bytes(b) as f32),
        }
    }

    /// Converts the numbers in row-major order.
    fn convert<const N: usize>(&self, of: impl Fn([u8; N]) -> f32) -> Vec<f32> {
        let numbers = self.bytes.as_chunks::<N>().0;
        let mut values = Vec::with_capacity(self.count);
        let (mut index, mut place) = (vec![0; self.size.len()], self.start);
        while values.len() < self.count {
            values.push(of(numbers[place]));
            for ((i, n), step) in index.iter_mut().zip(&self.size).zip(&self.stride).rev() {
                *i += 1;
                place += step;
                if *i < *n {
                    break;
                }
                place -= *i * step;
                *i = 0;
            }
        }
        values
    }
}
