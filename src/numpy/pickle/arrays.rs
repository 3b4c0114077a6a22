//! Converts the objects of numpy, scipy and chumpy in a pickle to arrays.

use super::machine::kind;
use super::{Array, Id, Outcome, Pickle, Value};
use crate::numpy::array::{Dtype, check_rank};

/// Largest nesting depth of arrays; numpy inside of chumpy has depth 2.
const MAX_DEPTH: usize = 16;

impl Pickle<'_> {
    /// Converts a value to an array, within the limits of depth and size.
    pub(super) fn to_array(&self, id: Id, depth: usize) -> Outcome<Array> {
        if depth > MAX_DEPTH {
            return Err(format!("arrays wrapped more than {MAX_DEPTH} deep"));
        }
        let array = self.convert(id, depth)?;
        self.pay(1 + array.data.len())?;
        Ok(array)
    }

    fn convert(&self, id: Id, depth: usize) -> Outcome<Array> {
        match &self.values[id] {
            Value::Int(value) => Ok(Array { shape: Vec::new(), data: vec![*value as f64] }),
            Value::Float(value) => Ok(Array { shape: Vec::new(), data: vec![*value] }),
            Value::List(items) | Value::Tuple(items) => self.stacked(items, depth),
            Value::Call { function, args, state } => {
                let class = self.class(*function, *args)?;
                let package = class.split('.').next().unwrap_or_default();
                match (package, *state) {
                    ("numpy", state) => self.numpy_array(class, *args, state, depth),
                    ("scipy", Some(state)) => self.sparse_matrix(class, state, depth),
                    ("chumpy", Some(state)) => self.chumpy_array(class, state, depth),
                    _ => Err(format!("an object of {class} is not an array")),
                }
            }
            other => Err(format!("{} is not an array", kind(other))),
        }
    }

    /// Returns the class of an object: the called name, or the first argument of `_reconstructor` (protocols 0 and 1).
    fn class(&self, function: Id, args: Id) -> Outcome<&str> {
        let name = |id: Id| match &self.values[id] {
            Value::Global(name) => Ok(name.as_str()),
            other => Err(format!("a call of {}, expected a name", kind(other))),
        };
        let called = name(function)?;
        if called.ends_with("._reconstructor") { name(self.item(args, 0)?) } else { Ok(called) }
    }

    /// Reads an array: `_reconstruct` with its state (version, shape, dtype, is_fortran, data), `_frombuffer` (data,
    /// dtype, shape, order) or `scalar` (dtype, data).
    fn numpy_array(&self, class: &str, args: Id, state: Option<Id>, depth: usize) -> Outcome<Array> {
        match (class.rsplit('.').next(), state) {
            (Some("_reconstruct"), Some(state)) => {
                let shape = self.shape(self.item(state, 1)?)?;
                let fortran = self.truth(self.item(state, 3)?);
                let (dtype, data) = (self.item(state, 2)?, self.item(state, 4)?);
                // `numpy.savez` wraps an object into an object array of shape ().
                if let (Value::List(items), true) = (&self.values[data], shape.is_empty()) {
                    return match items[..] {
                        [item] => self.to_array(item, depth + 1),
                        _ => Err("an object array without its object".into()),
                    };
                }
                Array::from_bytes(&self.raw(data)?, self.dtype(dtype)?, shape, fortran)
            }
            (Some("_frombuffer"), _) => {
                let fortran = self.text(self.item(args, 3)?).as_deref() == Some("F");
                let (dtype, shape) = (self.dtype(self.item(args, 1)?)?, self.shape(self.item(args, 2)?)?);
                Array::from_bytes(&self.raw(self.item(args, 0)?)?, dtype, shape, fortran)
            }
            (Some("scalar"), _) => {
                let dtype = self.dtype(self.item(args, 0)?)?;
                Array::from_bytes(&self.raw(self.item(args, 1)?)?, dtype, Vec::new(), false)
            }
            _ => Err(format!("an object of {class} is not an array")),
        }
    }

    /// Reads a sparse matrix in column-compressed, row-compressed or coordinate form as a dense array.
    fn sparse_matrix(&self, class: &str, state: Id, depth: usize) -> Outcome<Array> {
        let part = |name: &str| -> Outcome<Array> {
            let id = self.attribute(state, name)?.ok_or_else(|| format!("a {class} without {name}"))?;
            self.to_array(id, depth + 1)
        };
        let shape = part(if self.attribute(state, "_shape")?.is_some() { "_shape" } else { "shape" })?.indices()?;
        let &[rows, columns] = &shape[..] else { return Err(format!("a {class} of shape {shape:?}")) };
        let data = part("data")?.data;
        let triplets = match class.rsplit('.').next() {
            Some("csc_matrix" | "csc_array") => {
                let columns = expand_indptr(&part("indptr")?.indices()?, data.len())?;
                triplets(part("indices")?.indices()?, columns, data)?
            }
            Some("csr_matrix" | "csr_array") => {
                let rows = expand_indptr(&part("indptr")?.indices()?, data.len())?;
                triplets(rows, part("indices")?.indices()?, data)?
            }
            Some("coo_matrix" | "coo_array") => {
                // SciPy 1.13 and later store rows and columns in one attribute.
                let (rows, columns) = match self.attribute(state, "coords")? {
                    Some(coords) => {
                        let mut rows = self.to_array(coords, depth + 1)?.indices()?;
                        let columns = rows.split_off(rows.len() / 2);
                        (rows, columns)
                    }
                    None => (part("row")?.indices()?, part("col")?.indices()?),
                };
                triplets(rows, columns, data)?
            }
            _ => return Err(format!("sparse matrices of {class} are not supported (csc, csr and coo are)")),
        };
        Array::from_triplets([rows, columns], triplets)
    }

    /// Reads a chumpy object: `Ch` wraps an array as `x`; `Select` takes the entries `idxs` of another object `a`.
    fn chumpy_array(&self, class: &str, state: Id, depth: usize) -> Outcome<Array> {
        let part = |name: &str| self.attribute(state, name)?.map(|id| self.to_array(id, depth + 1)).transpose();
        match class {
            "chumpy.ch.Ch" => part("x")?.ok_or_else(|| "a chumpy.ch.Ch without x".to_string()),
            "chumpy.reordering.Select" => {
                let (Some(from), Some(indices)) = (part("a")?, part("idxs")?) else {
                    return Err("a chumpy.reordering.Select without a or idxs".into());
                };
                let pick = |index: usize| {
                    from.data.get(index).copied().ok_or_else(|| format!("a chumpy selection of entry {index}"))
                };
                let data = indices.indices()?.into_iter().map(pick).collect::<Outcome<Vec<f64>>>()?;
                let shape = match part("preferred_shape")? {
                    Some(shape) => shape.indices()?,
                    None => indices.shape,
                };
                check_rank(shape.len())?;
                if shape.iter().try_fold(1usize, |count, n| count.checked_mul(*n)) != Some(data.len()) {
                    return Err(format!("a chumpy selection of {} entries has shape {shape:?}", data.len()));
                }
                Ok(Array { shape, data })
            }
            _ => Err(format!("chumpy objects of {class} are not supported (Ch and Select are)")),
        }
    }

    /// Stacks the arrays of a list or tuple, which must have equal shapes.
    fn stacked(&self, items: &[Id], depth: usize) -> Outcome<Array> {
        let mut shape = None;
        let mut data = Vec::new();
        for &item in items {
            let part = self.to_array(item, depth + 1)?;
            if shape.get_or_insert_with(|| part.shape.clone()) != &part.shape {
                return Err("a list of arrays of different shapes".into());
            }
            data.extend(part.data);
        }
        let mut full = vec![items.len()];
        full.extend(shape.unwrap_or_default());
        check_rank(full.len())?;
        Ok(Array { shape: full, data })
    }

    /// Reads `numpy.dtype(code, ...)` with its state (version, byte order, ...).
    fn dtype(&self, id: Id) -> Outcome<Dtype> {
        let Value::Call { args, state, .. } = &self.values[id] else {
            return Err(format!("{} where an element type should be", kind(&self.values[id])));
        };
        let code = self.text(self.item(*args, 0)?).ok_or("an element type without a code")?;
        let dtype = Dtype::parse(&code)?;
        let order = state.map(|state| self.item(state, 1)).transpose()?.and_then(|id| self.text(id));
        Ok(order.map_or(dtype, |order| dtype.with_order(&order)))
    }

    /// Reads raw bytes, which Python 3 writes as `_codecs.encode(text, 'latin1')` in protocol 2 and below.
    pub fn raw(&self, id: Id) -> Outcome<std::borrow::Cow<'_, [u8]>> {
        match &self.values[id] {
            Value::Bytes(bytes) => Ok(bytes.as_ref().into()),
            // A Python 2 string that another program re-encoded; each character is a byte.
            Value::Text(text) => latin1(text).map(Into::into),
            Value::Call { args, .. } => match &self.values[self.item(*args, 0)?] {
                Value::Text(text) => latin1(text).map(Into::into),
                Value::Bytes(bytes) => Ok(bytes.as_ref().into()),
                other => Err(format!("{} where raw bytes should be", kind(other))),
            },
            other => Err(format!("{} where raw bytes should be", kind(other))),
        }
    }

    /// Returns the lengths in a tuple or list.
    pub fn shape(&self, id: Id) -> Outcome<Vec<usize>> {
        let (Value::Tuple(items) | Value::List(items)) = &self.values[id] else {
            return Err(format!("{} where a shape should be", kind(&self.values[id])));
        };
        check_rank(items.len())?;
        let length = |&id: &Id| match self.values[id] {
            Value::Int(length) => usize::try_from(length).map_err(|_| format!("the length {length}")),
            ref other => Err(format!("{} where a length should be", kind(other))),
        };
        items.iter().map(length).collect()
    }

    /// Returns Python's truth value.
    fn truth(&self, id: Id) -> bool {
        !matches!(self.values[id], Value::Bool(false) | Value::Int(0) | Value::None)
    }

    /// Returns an entry of a tuple or list.
    pub fn item(&self, id: Id, index: usize) -> Outcome<Id> {
        match &self.values[id] {
            Value::Tuple(items) | Value::List(items) => {
                items.get(index).copied().ok_or_else(|| format!("a tuple of {} without entry {index}", items.len()))
            }
            other => Err(format!("{} where a tuple should be", kind(other))),
        }
    }

    /// Returns an entry of an object's state: a dictionary, or a tuple that starts with one (objects with slots).
    fn attribute(&self, state: Id, name: &str) -> Outcome<Option<Id>> {
        let state = match &self.values[state] {
            Value::Tuple(items) => items.first().copied().unwrap_or(state),
            _ => state,
        };
        match &self.values[state] {
            Value::Dict(entries) => self.entry(entries, name),
            _ => Ok(None),
        }
    }
}

/// Expands the `indptr` of a compressed sparse matrix to the major index of each entry.
pub(crate) fn expand_indptr(indptr: &[usize], n_entries: usize) -> Outcome<Vec<usize>> {
    let ascending = indptr.is_sorted() && indptr.first() == Some(&0) && indptr.last() == Some(&n_entries);
    if !ascending {
        return Err("a sparse matrix whose indptr does not match its data".into());
    }
    Ok(indptr.windows(2).enumerate().flat_map(|(major, ends)| std::iter::repeat_n(major, ends[1] - ends[0])).collect())
}

/// Combines rows, columns and values to triplets.
pub(crate) fn triplets(rows: Vec<usize>, columns: Vec<usize>, data: Vec<f64>) -> Outcome<Vec<(usize, usize, f64)>> {
    if rows.len() != data.len() || columns.len() != data.len() {
        return Err(format!(
            "a sparse matrix of {} rows, {} columns, {} values",
            rows.len(),
            columns.len(),
            data.len()
        ));
    }
    Ok(rows.into_iter().zip(columns).zip(data).map(|((row, column), value)| (row, column, value)).collect())
}

fn latin1(text: &str) -> Outcome<Vec<u8>> {
    text.chars().map(|c| u8::try_from(c).map_err(|_| format!("the character {c:?} in raw bytes"))).collect()
}
