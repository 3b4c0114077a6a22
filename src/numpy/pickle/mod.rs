//! Reads Python pickles as plain data: nothing that a pickle names is imported, called or executed.
//!
//! A pickle is a program for a stack machine. [`machine`] runs it, but records each function call as a name with
//! arguments instead of making it. [`arrays`] converts the recorded calls of numpy, scipy and chumpy to arrays.

mod account;
mod arrays;
mod cursor;
mod literal;
mod machine;
mod names;

use std::borrow::Cow;
use std::cell::Cell;

use crate::numpy::array::{Array, Outcome};

pub(crate) use arrays::{expand_indptr, triplets};
pub(crate) use names::Names;

/// Largest amount of work on one pickle after it was run: numbers converted, and entries and characters looked at. A small
/// file can refer to a large array many times. MANO's largest array has 315 090 numbers.
const MAX_WORK: usize = 1 << 24;

/// Index of a value in [`Pickle::values`]. Values refer to each other by index, so cycles are harmless.
pub(crate) type Id = usize;

/// One value of a pickle.
#[derive(Debug, Clone)]
pub(crate) enum Value<'a> {
    None,
    Bool(bool),
    Int(i64),
    Float(f64),
    /// A Python 2 string or bytes.
    Bytes(Cow<'a, [u8]>),
    Text(String),
    List(Vec<Id>),
    Tuple(Vec<Id>),
    Dict(Vec<(Id, Id)>),
    /// A name such as `numpy.dtype`.
    Global(String),
    /// The result of a call that was not made, and the state that the pickle sets on it.
    Call {
        function: Id,
        args: Id,
        state: Option<Id>,
    },
    /// An object outside of the pickle, by its description.
    Persistent(Id),
}

/// The values of a pickle. That of a hand model is a dictionary with string keys.
#[derive(Debug)]
pub(crate) struct Pickle<'a> {
    values: Vec<Value<'a>>,
    root: Id,
    /// Length of the pickle, bytes; what follows it in the file is not part of it.
    end: usize,
    /// Work done so far; see [`MAX_WORK`].
    work: Cell<usize>,
}

impl<'a> Pickle<'a> {
    /// Reads the pickle of a hand model, of protocol 0 to 5.
    ///
    /// # Errors
    /// If the pickle is incomplete, has an unknown opcode, needs too much memory, or names anything but numpy, scipy and
    /// chumpy data; the message names it.
    pub fn read(bytes: &'a [u8]) -> Outcome<Self> {
        Self::read_with(bytes, &names::HAND_MODEL)
    }

    /// As [`Pickle::read`], of a file with other names.
    ///
    /// # Errors
    /// As [`Pickle::read`].
    pub fn read_with(bytes: &'a [u8], names: &'static Names) -> Outcome<Self> {
        machine::run(bytes, names)
    }

    /// Index of the outermost value.
    pub fn root(&self) -> Id {
        self.root
    }

    /// Length of the pickle, bytes.
    pub fn end(&self) -> usize {
        self.end
    }

    /// Returns a value.
    pub fn value(&self, id: Id) -> &Value<'a> {
        &self.values[id]
    }

    /// Returns the string keys of the outermost dictionary, in order; empty if the outermost value is not a dictionary.
    pub fn keys(&self) -> Vec<String> {
        self.entries().iter().filter_map(|&(key, _)| self.text(key)).collect()
    }

    /// Reads the array of a key; `None` if the key is absent. Sparse matrices become dense.
    ///
    /// # Errors
    /// If the value is not a numeric array.
    pub fn array(&self, name: &str) -> Outcome<Option<Array>> {
        self.entry(self.entries(), name)?.map(|value| self.to_array(value, 0)).transpose()
    }

    /// Returns the value of a key of the dictionary `id`; `None` if the key is absent, or the value is not a dictionary.
    ///
    /// # Errors
    /// If the pickle needs too much work.
    pub fn value_of(&self, id: Id, key: &str) -> Outcome<Option<Id>> {
        match &self.values[id] {
            Value::Dict(entries) => self.entry(entries, key),
            _ => Ok(None),
        }
    }

    /// Reads a value as an array.
    ///
    /// # Errors
    /// If the value is not a numeric array.
    pub fn array_at(&self, id: Id) -> Outcome<Array> {
        self.to_array(id, 0)
    }

    /// Returns the object in an object array of shape (), which `numpy.save` wraps around a dictionary.
    pub fn unwrapped(&self, id: Id) -> Id {
        let inner = || {
            let Value::Call { state: Some(state), .. } = self.values[id] else { return None };
            match &self.values[self.item(state, 4).ok()?] {
                Value::List(items) if items.len() == 1 => Some(items[0]),
                _ => None,
            }
        };
        inner().unwrap_or(id)
    }

    /// Reads the outermost value as an array (the data of an object array in an `.npz`).
    ///
    /// # Errors
    /// If the value is neither a numeric array nor an object array with one in it.
    pub fn root_array(&self) -> Outcome<Array> {
        self.to_array(self.root, 0)
    }

    fn entries(&self) -> &[(Id, Id)] {
        match &self.values[self.root] {
            Value::Dict(entries) => entries,
            _ => &[],
        }
    }

    /// Returns the value of a key among the entries of a dictionary.
    fn entry(&self, entries: &[(Id, Id)], name: &str) -> Outcome<Option<Id>> {
        self.pay(entries.len())?;
        let is_name = |id: Id| match &self.values[id] {
            Value::Text(text) => text == name,
            Value::Bytes(bytes) => bytes.as_ref() == name.as_bytes(),
            _ => false,
        };
        Ok(entries.iter().rev().find(|&&(key, _)| is_name(key)).map(|&(_, value)| value))
    }

    /// Counts work.
    fn pay(&self, work: usize) -> Outcome<()> {
        self.work.set(self.work.get().saturating_add(work));
        match self.work.get() > MAX_WORK {
            true => Err("more numbers than any hand model has".into()),
            false => Ok(()),
        }
    }

    /// Returns a string of either kind; Python 2 strings are latin-1.
    pub fn text(&self, id: Id) -> Option<String> {
        match &self.values[id] {
            Value::Text(text) => Some(text.clone()),
            Value::Bytes(bytes) => Some(bytes.iter().map(|&byte| char::from(byte)).collect()),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Reads `small_*.pkl` of `make_golden.py`: one dictionary, written by Python 2 and 3 in every protocol.
    fn small_pickles() -> Vec<(String, Vec<u8>)> {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/hand");
        let names =
            (0..3).map(|p| format!("small_python2_{p}.pkl")).chain((0..6).map(|p| format!("small_python3_{p}.pkl")));
        names.map(|name| (name.clone(), std::fs::read(folder.join(name)).unwrap())).collect()
    }

    fn array(pickle: &Pickle, name: &str) -> Array {
        pickle.array(name).unwrap().unwrap()
    }

    #[test]
    fn all_protocols_of_python_2_and_3_give_the_same_arrays() {
        for (file, bytes) in small_pickles() {
            let pickle = Pickle::read(&bytes).unwrap_or_else(|message| panic!("{file}: {message}"));
            assert_eq!(pickle.keys(), ["int", "fortran", "flag", "sparse", "list", "scalar", "text"], "{file}");
            assert_eq!(array(&pickle, "int"), Array { shape: vec![2, 2], data: vec![1.0, -2.0, 300.0, 4.0] }, "{file}");
            let fortran = Array { shape: vec![2, 3], data: vec![0.5, 1.5, -2.5, 3.0, 1e300, 0.0] };
            assert_eq!(array(&pickle, "fortran"), fortran, "{file}");
            assert_eq!(array(&pickle, "flag").data, [1.0, 0.0], "{file}");
            let sparse = Array { shape: vec![2, 3], data: vec![0.0, 2.0, 0.0, 1.0, 0.0, 3.0] };
            assert_eq!(array(&pickle, "sparse"), sparse, "{file}");
            assert_eq!(array(&pickle, "list"), Array { shape: vec![3], data: vec![1.0, 2.5, 3.0] }, "{file}");
            assert_eq!(array(&pickle, "scalar").data, [1.25], "{file}");
            assert!(pickle.array("text").unwrap_err().contains("not an array"), "{file}");
            assert_eq!(pickle.array("absent").unwrap(), None, "{file}");
        }
    }

    #[test]
    fn names_outside_of_numpy_scipy_and_chumpy_are_refused() {
        let message = Pickle::read(b"cos\nsystem\n(S'true'\ntR.").unwrap_err();
        assert!(message.contains("`os.system`"), "{message}");
        let message = Pickle::read(b"\x80\x04\x8c\x08builtins\x8c\x04eval\x93.").unwrap_err();
        assert!(message.contains("`builtins.eval`"), "{message}");
    }

    #[test]
    fn unknown_opcodes_are_named_with_their_position() {
        let message = Pickle::read(b"N\xff.").unwrap_err();
        assert!(message.contains("0xff") && message.contains("byte 1"), "{message}");
    }

    #[test]
    fn truncated_pickles_are_errors() {
        for (file, bytes) in small_pickles() {
            for end in 0..bytes.len() {
                assert!(Pickle::read(&bytes[..end]).is_err(), "{file} cut at {end}");
            }
        }
    }

    #[test]
    fn recursive_values_are_errors() {
        // l = []; l.append(l); {"l": l}
        let pickle = Pickle::read(b"}S'l'\n]q\x00h\x00as.").unwrap();
        assert!(pickle.array("l").unwrap_err().contains("deep"));
    }

    #[test]
    fn lists_of_exponential_size_are_errors() {
        // Twelve levels, each a list of 100 times the one below: 100^12 numbers from a few kilobytes.
        let mut bytes = b"}S'l'\n]".to_vec();
        for level in 0..12u8 {
            bytes.extend([b'q', level, b'0', b']', b'(']);
            bytes.extend([b'h', level].repeat(100));
            bytes.push(b'e');
        }
        bytes.extend(b"s.");
        let pickle = Pickle::read(&bytes).unwrap();
        assert!(pickle.array("l").unwrap_err().contains("more numbers"));
    }

    #[test]
    fn stack_marks_memo_and_names_are_paid_from_one_account() {
        let name = [&b"X"[..], &100_000u32.to_le_bytes(), b"numpy.", &[b'a'; 99_994]].concat();
        let named = [&name[..], b"q\0", &name, b"q\x01"].concat();
        for (start, repeated, count) in [
            (&b"N"[..], &b"2"[..], 12 << 20),  // copies of the topmost value
            (b"", b"(", 12 << 20),             // marks
            (b"", b"]", 3 << 20),              // empty lists
            (b"N", b"\x94", 3 << 20),          // memo
            (b"Nq\0", b"h\0", 18 << 20),       // values from the memo
            (&named, b"h\0h\x01\x930", 2_000), // names of 200 kB each from six bytes
        ] {
            let bytes = [start, &repeated.repeat(count)].concat();
            let message = Pickle::read(&bytes).unwrap_err();
            assert!(message.contains("bytes of memory"), "{repeated:?}: {message}");
        }
    }

    #[test]
    fn an_object_whose_state_is_looked_through_again_and_again_is_an_error() {
        // A list of references to one chumpy object, whose state has many entries before the wanted one.
        let mut bytes = b"}S'l'\n](cchumpy.ch\nCh\n)R}(S'x'\nK\x01".to_vec();
        bytes.extend(b"NN".repeat(100_000));
        bytes.extend(b"ubq\0");
        bytes.extend(b"h\0".repeat(100_000));
        bytes.extend(b"es.");
        let pickle = Pickle::read(&bytes).unwrap();
        assert!(pickle.array("l").unwrap_err().contains("more numbers"));
    }

    #[test]
    fn an_ordered_dictionary_is_a_dictionary() {
        let pickle = Pickle::read(b"ccollections\nOrderedDict\n)RS'a'\nK\x05s.").unwrap();
        assert_eq!(array(&pickle, "a").data, [5.0]);
    }

    fn use_all(bytes: &[u8]) {
        if let Ok(pickle) = Pickle::read(bytes) {
            for key in pickle.keys() {
                let _ = pickle.array(&key);
            }
            let _ = pickle.root_array();
        }
    }

    proptest! {
        #[test]
        fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
            use_all(&bytes);
        }

        #[test]
        fn mutated_pickles_never_panic(
            which in 0usize..9,
            edits in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0u8..3), 1..8),
        ) {
            let mut bytes = small_pickles()[which].1.clone();
            for (at, byte, kind) in edits {
                let at = at.index(bytes.len());
                match kind {
                    0 => bytes[at] = byte,
                    1 => bytes.insert(at, byte),
                    _ => drop(bytes.remove(at)),
                }
            }
            use_all(&bytes);
        }
    }
}
