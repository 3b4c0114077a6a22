//! PyTorch's tensors in pickles: numbers in a storage, with offset, size and stride.

use super::{Array, Id, Names, Outcome, Pickle, Value, check_rank};

/// First pickle of a stream that `torch.save` writes in its format without a zip file: a number that identifies it.
const MAGIC: &[u8] = b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.";
/// Names in the pickles of a storage.
const STORAGE: Names = Names { packages: &["torch"], names: &[], kind: "a storage of a tensor" };

/// Reads a value of a pickle as an array: one of numpy, or a tensor of PyTorch with its storage inside the pickle.
///
/// # Errors
/// If it is neither, or damaged.
pub(crate) fn array_or_tensor(pickle: &Pickle, id: Id) -> Outcome<Array> {
    let Some(arguments) = rebuilt(pickle, id)? else { return pickle.array_at(id) };
    let storage = pickle.item(arguments, 0)?;
    let Value::Call { args, .. } = *pickle.value(storage) else {
        return Err("expected a tensor with its storage".into());
    };
    if !is_name(pickle, storage, "torch.storage._load_from_bytes") {
        return Err("expected a tensor with its storage in the pickle".into());
    }
    let bytes = pickle.raw(pickle.item(args, 0)?)?;
    let (of_storage, numbers) = storage_stream(&bytes)?;
    let Value::Persistent(reference) = *of_storage.value(of_storage.root()) else {
        return Err("expected a reference to a storage".into());
    };
    let storage = StorageReference::read(&of_storage, reference)?;
    let view = View::read(pickle, arguments, &storage, numbers)?;
    Ok(Array { shape: view.size.clone(), data: view.values().into_iter().map(f64::from).collect() })
}

/// Splits the stream of one saved storage into the pickle that refers to it, and its numbers.
fn storage_stream(bytes: &[u8]) -> Outcome<(Pickle<'_>, &[u8])> {
    let mut rest = bytes.strip_prefix(MAGIC).ok_or("expected a storage as torch.save writes it")?;
    let mut next = || -> Outcome<Pickle<'_>> {
        let pickle = Pickle::read_with(rest, &STORAGE)?;
        rest = &rest[pickle.end()..];
        Ok(pickle)
    };
    // Protocol version and properties of the machine that wrote it, the storage, then the list of the storages' names.
    let (_version, machine) = (next()?, next()?);
    if let Some(little) = machine.value_of(machine.root(), "little_endian")?
        && matches!(machine.value(little), Value::Bool(false))
    {
        return Err("expected numbers in little-endian order".into());
    }
    let (storage, _names) = (next()?, next()?);
    // The number of elements again, as a 64-bit integer.
    let (_, numbers) = rest.split_first_chunk::<8>().ok_or("a storage without its numbers")?;
    Ok((storage, numbers))
}

fn is_name(pickle: &Pickle, id: Id, wanted: &str) -> bool {
    match pickle.value(id) {
        Value::Global(name) => name == wanted,
        Value::Call { function, .. } => matches!(pickle.value(*function), Value::Global(name) if name == wanted),
        _ => false,
    }
}

/// Returns the arguments of `_rebuild_tensor_v2` if the value is a tensor, or a parameter or subclass around one.
///
/// # Errors
/// If the value is incomplete.
pub(crate) fn rebuilt(pickle: &Pickle, id: Id) -> Outcome<Option<Id>> {
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

/// Description of a storage in a pickle: ("storage", type, key, device, number of elements).
pub(crate) struct StorageReference<'p> {
    number: Number,
    /// Name of the storage.
    pub key: &'p str,
    length: usize,
}

impl<'p> StorageReference<'p> {
    /// Reads the description at `id`.
    ///
    /// # Errors
    /// If it is incomplete, or the type of the numbers is unknown.
    pub fn read(pickle: &'p Pickle, id: Id) -> Outcome<Self> {
        let text = |id: Id| match pickle.value(id) {
            Value::Text(text) | Value::Global(text) => Ok(text.as_str()),
            _ => Err("expected a storage with a type and a name".to_string()),
        };
        let kind = text(pickle.item(id, 1)?)?;
        let number = Number::of_storage(kind.rsplit('.').next().unwrap_or(kind))?;
        Ok(Self { number, key: text(pickle.item(id, 2)?)?, length: whole(pickle, pickle.item(id, 4)?)? })
    }
}

fn whole(pickle: &Pickle, id: Id) -> Outcome<usize> {
    match pickle.value(id) {
        Value::Int(number) => usize::try_from(*number).map_err(|_| format!("expected a number >= 0, got {number}")),
        _ => Err("expected a whole number".to_string()),
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
pub(crate) struct View<'a> {
    number: Number,
    bytes: &'a [u8],
    start: usize,
    /// Length of each dimension.
    pub size: Vec<usize>,
    stride: Vec<usize>,
    /// Number of elements.
    pub count: usize,
}

impl<'a> View<'a> {
    /// Reads the arguments of `_rebuild_tensor_v2`: storage, offset, size, stride (in elements), and others without meaning
    /// here. `bytes` are those of the storage.
    ///
    /// # Errors
    /// If the tensor reaches beyond its storage.
    pub fn read(pickle: &Pickle, arguments: Id, storage: &StorageReference, bytes: &'a [u8]) -> Outcome<Self> {
        let (number, length) = (storage.number, storage.length);
        let bytes = length.checked_mul(number.size()).and_then(|n_bytes| bytes.get(..n_bytes)).ok_or_else(|| {
            format!("expected a storage of {length} numbers of {} bytes, got {} bytes", number.size(), bytes.len())
        })?;
        let start = whole(pickle, pickle.item(arguments, 1)?)?;
        let (size, stride) = (pickle.shape(pickle.item(arguments, 2)?)?, pickle.shape(pickle.item(arguments, 3)?)?);
        Self::new(number, bytes, length, start, size, stride)
    }

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

    /// Converts all numbers to single precision, in row-major order.
    pub fn values(&self) -> Vec<f32> {
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
