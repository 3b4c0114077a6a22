//! Arrays in `.npy` files and pickles.

use std::path::Path;

use crate::error::{Error, Result};
use crate::file::{input, limits};
use crate::numpy::{Array, Id, Names, Outcome, Pickle, Value, array_or_tensor, npy_pickle, read_npy};

/// Names in the pickles of data sets. Those of arrays and tensors are interpreted, the others ignored.
const NAMES: Names = Names {
    packages: &["numpy", "torch", "collections"],
    names: &[
        "_codecs.encode",
        "copyreg._reconstructor",
        "copy_reg._reconstructor",
        "builtins.object",
        "__builtin__.object",
    ],
    kind: "annotations of arrays and tensors",
};

/// Reads a `.npy` file of numbers; `shape` has 0 for lengths that may be any.
///
/// # Errors
/// If the file can't be read, is damaged, or has another shape.
pub fn npy(path: &Path, shape: &[usize]) -> Result<Array> {
    let array = read_npy(&input::read(path, limits::FILE)?).map_err(|message| Error::file(path, message))?;
    check(path, "array", array, shape)
}

/// Checks the shape of an array, and that its numbers are finite; `shape` has 0 for lengths that may be any.
///
/// # Errors
/// If it differs.
pub fn check(path: &Path, field: &str, array: Array, shape: &[usize]) -> Result<Array> {
    finite(path, field, check_shape(path, field, array, shape)?)
}

/// Checks the shape of an array alone.
///
/// # Errors
/// If it differs.
pub fn check_shape(path: &Path, field: &str, array: Array, shape: &[usize]) -> Result<Array> {
    let fits = |(got, wanted): (&usize, &usize)| *wanted == 0 || got == wanted;
    if array.shape.len() != shape.len() || !array.shape.iter().zip(shape).all(fits) {
        let lengths: Vec<String> = shape.iter().map(|n| if *n == 0 { "any".into() } else { n.to_string() }).collect();
        let expected = format!("{field}: expected shape [{}], got {:?}", lengths.join(", "), array.shape);
        return Err(Error::file(path, expected));
    }
    Ok(array)
}

fn finite(path: &Path, field: &str, array: Array) -> Result<Array> {
    match array.data.iter().position(|value| !value.is_finite()) {
        Some(at) => {
            Err(Error::file(path, format!("{field}: expected finite numbers, entry {at} is {}", array.data[at])))
        }
        None => Ok(array),
    }
}

/// A pickle of dictionaries, arrays and tensors, read as data: nothing that it names is executed.
pub struct PickleFile<'a> {
    path: &'a Path,
    pickle: Pickle<'a>,
}

/// A value of a [`PickleFile`], with its place in the file.
#[derive(Clone)]
pub struct Node<'a> {
    file: &'a PickleFile<'a>,
    id: Id,
    place: String,
}

impl<'a> PickleFile<'a> {
    /// Reads the content of a pickle file.
    ///
    /// # Errors
    /// If it is damaged, or names anything but arrays and tensors.
    pub fn parse(path: &'a Path, content: &'a [u8]) -> Result<Self> {
        let pickle = Pickle::read_with(content, &NAMES).map_err(|message| Error::file(path, message))?;
        Ok(Self { path, pickle })
    }

    /// Reads the content of a `.npy` file that holds a pickled object.
    ///
    /// # Errors
    /// As [`PickleFile::parse`], and if it holds numbers.
    pub fn parse_npy(path: &'a Path, content: &'a [u8]) -> Result<Self> {
        Self::parse(path, npy_pickle(content).map_err(|message| Error::file(path, message))?)
    }

    /// Returns the outermost value; of a dictionary that numpy wrapped, the dictionary.
    pub fn root(&'a self) -> Node<'a> {
        Node { file: self, id: self.pickle.unwrapped(self.pickle.root()), place: String::new() }
    }
}

impl<'a> Node<'a> {
    /// Returns keys and values of a dictionary, in the order of the file; keys are texts or whole numbers.
    ///
    /// # Errors
    /// If the value is not a dictionary.
    pub fn entries(&self) -> Result<Vec<(String, Self)>> {
        let pickle = &self.file.pickle;
        let Value::Dict(entries) = pickle.value(self.id) else { return Err(self.expected("a dictionary")) };
        let named = |(key, value): &(Id, Id)| {
            let key = match pickle.value(*key) {
                Value::Int(number) => Some(number.to_string()),
                _ => pickle.text(*key),
            }?;
            let place = if self.place.is_empty() { key.clone() } else { format!("{}.{key}", self.place) };
            Some((key, Self { file: self.file, id: *value, place }))
        };
        Ok(entries.iter().filter_map(named).collect())
    }

    /// Returns the value of a key of a dictionary.
    ///
    /// # Errors
    /// If there is none; the error lists the keys that are there.
    pub fn get(&self, key: &str) -> Result<Self> {
        let found = self.file.pickle.value_of(self.id, key).map_err(|message| self.damaged(&message))?;
        let place = if self.place.is_empty() { key.to_string() } else { format!("{}.{key}", self.place) };
        match found {
            Some(id) => Ok(Self { file: self.file, id, place }),
            None => {
                let mut there: Vec<String> = self.entries()?.into_iter().map(|(key, _)| key).collect();
                there.truncate(20);
                let place = format!(
                    "{}{}{}",
                    self.file.path.display(),
                    if self.place.is_empty() { "" } else { ": " },
                    self.place
                );
                Err(Error::Missing { name: key.into(), place, present: there.join(", ") })
            }
        }
    }

    /// Returns the items of a list.
    ///
    /// # Errors
    /// If the value is not a list.
    pub fn items(&self) -> Result<Vec<Self>> {
        let Value::List(items) = self.file.pickle.value(self.id) else { return Err(self.expected("a list")) };
        let item =
            |(index, id): (usize, &Id)| Self { file: self.file, id: *id, place: format!("{}[{index}]", self.place) };
        Ok(items.iter().enumerate().map(item).collect())
    }

    /// Returns a text; `None` if the value is none.
    pub fn text(&self) -> Option<String> {
        self.file.pickle.text(self.id)
    }

    /// Returns the place of the value in the file.
    pub fn place(&self) -> &str {
        &self.place
    }

    /// Reads an array or tensor of any shape that has this number of elements.
    ///
    /// # Errors
    /// If the value is none, or has another number of elements, or one that is not finite.
    pub fn numbers<const N: usize>(&self) -> Result<[f64; N]> {
        let array = self.array()?;
        let got = array.data.len();
        array.data.try_into().map_err(|_| self.damaged(&format!("expected {N} numbers, got {got}")))
    }

    /// Reads an array or tensor of any shape.
    ///
    /// # Errors
    /// If the value is none, or a number is not finite.
    pub fn array(&self) -> Result<Array> {
        let array: Outcome<Array> = array_or_tensor(&self.file.pickle, self.id);
        finite(self.file.path, &self.place, array.map_err(|message| self.damaged(&message))?)
    }

    /// Reads an array or tensor of a shape; 0 stands for lengths that may be any.
    ///
    /// # Errors
    /// As [`Node::array`], and if the shape differs.
    pub fn shaped(&self, shape: &[usize]) -> Result<Array> {
        check(self.file.path, &self.place, self.array()?, shape)
    }

    fn expected(&self, what: &str) -> Error {
        self.damaged(&format!("expected {what}"))
    }

    fn damaged(&self, message: &str) -> Error {
        let place = if self.place.is_empty() { "content" } else { &self.place };
        Error::file(self.file.path, format!("{place}: {message}"))
    }
}
