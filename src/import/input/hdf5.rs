//! HDF5 files: groups, arrays and attributes, within the limits of this program.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use hdf5_reader::group::Group;
use hdf5_reader::storage::{BlockCacheStorage, FileStorage};
use hdf5_reader::{Dataset, Datatype, H5Type, Hdf5File, OpenOptions, SliceInfo, SliceInfoElem};

use crate::error::{Error, Result};
use crate::file::{input, limits};

/// Size of the blocks that a file is read in, bytes, and how many stay in memory: indices lie scattered in small pieces.
const BLOCK: usize = 1 << 16;
const BLOCKS: usize = 64;
/// Decompressed chunks that stay in memory per file, bytes: rows are read one after another from the same chunk.
const CACHE: usize = 32 << 20;
/// Largest header of an object, bytes: it holds the attributes as well.
const HEADER: usize = 16 << 20;
/// Size of the reference to a list of varying length in a row, bytes: length, address and index.
const REFERENCE: usize = 16;

/// An open HDF5 file. Links to other files are not followed.
pub struct Hdf5 {
    path: PathBuf,
    file: Hdf5File,
    /// Arrays that were asked for, by their paths: finding one reads the headers of its whole group.
    arrays: Mutex<BTreeMap<String, Option<Arc<H5Array>>>>,
}

/// An array of an HDF5 file, not read yet.
pub struct H5Array {
    path: PathBuf,
    name: String,
    dataset: Dataset,
}

/// Reference to a list of varying length, as it lies in a row.
#[derive(Debug, Clone)]
struct Reference([u8; REFERENCE]);

/// One byte of an enumeration, such as h5py's truth values.
#[derive(Debug, Clone)]
struct Octet(u8);

impl Hdf5 {
    /// Opens a file.
    ///
    /// # Errors
    /// If it can't be read, or is no HDF5 file.
    pub fn open(path: &Path) -> Result<Self> {
        let storage = FileStorage::from_file(input::open(path)?).map_err(|error| failure(path, "content", &error))?;
        let storage = BlockCacheStorage::new(Arc::new(storage), BLOCK, BLOCKS);
        let most = |limit: limits::Limit| usize::try_from(limit.value()).unwrap_or(usize::MAX);
        let options = OpenOptions::default()
            .with_chunk_cache_bytes(CACHE)
            .with_max_chunk_bytes(most(limits::CHUNK))
            .with_max_read_bytes(most(limits::ARRAY))
            .with_max_object_header_bytes(HEADER);
        let file = Hdf5File::from_storage_with_options(Arc::new(storage), options)
            .map_err(|error| failure(path, "content", &error))?;
        Ok(Self { path: path.to_path_buf(), file, arrays: Mutex::default() })
    }

    /// Returns the names of the groups directly in a group, sorted by their numbers; none if there is no such group.
    ///
    /// # Errors
    /// If the file is damaged, or there are more than the limit of episodes.
    pub fn groups(&self, group: &str) -> Result<Vec<String>> {
        let Some(found) = self.group(group)? else { return Ok(Vec::new()) };
        let (mut names, _) = found.member_names().map_err(|error| failure(&self.path, group, &error))?;
        limits::EPISODES.check(&self.path, group, names.len() as u64)?;
        names.sort_by(|a, b| crate::dataset::image_folder::natural(a, b));
        Ok(names)
    }

    /// Returns an array by its path in the file; `None` if there is none.
    ///
    /// # Errors
    /// If the file is damaged.
    pub fn array(&self, name: &str) -> Result<Option<Arc<H5Array>>> {
        let mut arrays = self.arrays.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = arrays.get(name) {
            return Ok(known.clone());
        }
        let found = self.find(name)?.map(Arc::new);
        arrays.insert(name.into(), found.clone());
        Ok(found)
    }

    fn find(&self, name: &str) -> Result<Option<H5Array>> {
        let (group, last) = name.rsplit_once('/').unwrap_or(("", name));
        let Some(group) = self.group(group)? else { return Ok(None) };
        let (_, there) = group.member_names().map_err(|error| failure(&self.path, name, &error))?;
        if !there.iter().any(|found| found == last) {
            return Ok(None);
        }
        let dataset = group.dataset(last).map_err(|error| failure(&self.path, name, &error))?;
        Ok(Some(H5Array { path: self.path.clone(), name: name.into(), dataset }))
    }

    /// Returns an array that must be there.
    ///
    /// # Errors
    /// If there is none, or the file is damaged.
    pub fn required(&self, name: &str) -> Result<Arc<H5Array>> {
        self.array(name)?.ok_or_else(|| Error::file(&self.path, format!("{name}: expected this array, got none")))
    }

    /// Returns a text in the attributes of a group; `None` if there is none.
    pub fn text(&self, group: &str, attribute: &str) -> Option<String> {
        let group = self.group(group).ok()??;
        group.attribute(attribute).ok()?.read_string().ok()
    }

    /// Returns a number in the attributes of a group; `None` if there is none.
    pub fn number(&self, group: &str, attribute: &str) -> Option<f64> {
        let group = self.group(group).ok()??;
        group.attribute(attribute).ok()?.read_as_f64().ok()
    }

    /// Returns the names of the arrays directly in a group; none if there is no such group.
    ///
    /// # Errors
    /// If the file is damaged.
    pub fn arrays(&self, group: &str) -> Result<Vec<String>> {
        let Some(found) = self.group(group)? else { return Ok(Vec::new()) };
        Ok(found.member_names().map_err(|error| failure(&self.path, group, &error))?.1)
    }

    /// Opens a group; `None` if there is none.
    fn group(&self, path: &str) -> Result<Option<Group>> {
        let mut group = self.file.root_group().map_err(|error| failure(&self.path, "/", &error))?;
        for part in path.split('/').filter(|part| !part.is_empty()) {
            let (groups, _) = group.member_names().map_err(|error| failure(&self.path, path, &error))?;
            if !groups.iter().any(|name| name == part) {
                return Ok(None);
            }
            group = group.group(part).map_err(|error| failure(&self.path, path, &error))?;
        }
        Ok(Some(group))
    }
}

impl H5Array {
    /// Returns the lengths of the axes.
    pub fn shape(&self) -> Vec<u64> {
        self.dataset.shape().to_vec()
    }

    /// Returns the number of rows, the length of the first axis.
    ///
    /// # Errors
    /// If there are none, or more than the limit of frames.
    pub fn rows(&self) -> Result<usize> {
        let rows = self.dataset.shape().first().copied().unwrap_or(0);
        if rows == 0 {
            return Err(self.damaged("expected at least one row, got none"));
        }
        limits::FRAMES.check(&self.path, &self.name, rows)?;
        Ok(rows as usize)
    }

    /// Checks the lengths of the axes; 0 stands for lengths that may be any.
    ///
    /// # Errors
    /// If they differ.
    pub fn expect(self: Arc<Self>, shape: &[usize]) -> Result<Arc<Self>> {
        let got = self.dataset.shape();
        let fits = |(got, wanted): (&u64, &usize)| *wanted == 0 || *got == *wanted as u64;
        if got.len() == shape.len() && got.iter().zip(shape).all(fits) {
            return Ok(self);
        }
        let lengths: Vec<String> = shape.iter().map(|n| if *n == 0 { "any".into() } else { n.to_string() }).collect();
        Err(self.damaged(&format!("expected shape [{}], got {got:?}", lengths.join(", "))))
    }

    /// Reads rows of any type as numbers; NaN stays.
    ///
    /// # Errors
    /// If the array holds no numbers, is damaged, or the rows exceed the limit of an array.
    pub fn numbers(&self, rows: Range<usize>) -> Result<Vec<f64>> {
        let size = match self.dataset.dtype() {
            Datatype::FixedPoint { size, signed, .. } => (i8::from(*signed), *size),
            Datatype::FloatingPoint { size, .. } => (2, *size),
            Datatype::Enum { base, .. } if matches!(**base, Datatype::FixedPoint { size: 1, .. }) => (3, 1),
            _ => return Err(self.expected("numbers")),
        };
        match size {
            (0, 1) => Ok(self.read::<u8>(rows)?.into_iter().map(f64::from).collect()),
            (0, 2) => Ok(self.read::<u16>(rows)?.into_iter().map(f64::from).collect()),
            (0, 4) => Ok(self.read::<u32>(rows)?.into_iter().map(f64::from).collect()),
            (0, 8) => Ok(self.read::<u64>(rows)?.into_iter().map(|value| value as f64).collect()),
            (1, 1) => Ok(self.read::<i8>(rows)?.into_iter().map(f64::from).collect()),
            (1, 2) => Ok(self.read::<i16>(rows)?.into_iter().map(f64::from).collect()),
            (1, 4) => Ok(self.read::<i32>(rows)?.into_iter().map(f64::from).collect()),
            (1, 8) => Ok(self.read::<i64>(rows)?.into_iter().map(|value| value as f64).collect()),
            (2, 4) => Ok(self.read::<f32>(rows)?.into_iter().map(f64::from).collect()),
            (2, 8) => self.read::<f64>(rows),
            (3, 1) => Ok(self.read::<Octet>(rows)?.into_iter().map(|Octet(value)| f64::from(value)).collect()),
            _ => Err(self.expected("numbers of 1, 2, 4 or 8 bytes")),
        }
    }

    /// Reads rows as whole numbers, such as stamps in nanoseconds, which would lose digits as real numbers.
    ///
    /// # Errors
    /// As [`H5Array::numbers`], and if the array holds other numbers.
    pub fn whole(&self, rows: Range<usize>) -> Result<Vec<i64>> {
        match self.dataset.dtype() {
            Datatype::FixedPoint { size: 8, signed: true, .. } => self.read::<i64>(rows),
            Datatype::FixedPoint { size: 8, signed: false, .. } => {
                let whole = |value| i64::try_from(value).map_err(|_| self.damaged(&format!("{value} is too large")));
                self.read::<u64>(rows)?.into_iter().map(whole).collect()
            }
            Datatype::FixedPoint { .. } => Ok(self.numbers(rows)?.into_iter().map(|value| value as i64).collect()),
            _ => Err(self.expected("whole numbers")),
        }
    }

    /// Reads one row as bytes: a row of u8, or a list of u8 of varying length.
    ///
    /// # Errors
    /// If the row is neither, is damaged, or exceeds the limit of a chunk.
    pub fn bytes(&self, row: usize) -> Result<Vec<u8>> {
        let Datatype::VarLen { base, .. } = self.dataset.dtype() else { return self.read::<u8>(row..row + 1) };
        if !matches!(**base, Datatype::FixedPoint { size: 1, .. }) {
            return Err(self.expected("lists of bytes"));
        }
        let references = self.read::<Reference>(row..row + 1)?;
        let [Reference(reference)] = references.as_slice() else {
            return Err(self.damaged(&format!("expected one list per row, got {}", references.len())));
        };
        let length = u32::from_le_bytes([reference[0], reference[1], reference[2], reference[3]]);
        limits::CHUNK.check(&self.path, &format!("{}[{row}]", self.name), u64::from(length))?;
        self.dataset.resolve_vlen_reference_bytes(reference, 1).map_err(|error| failure(&self.path, &self.name, &error))
    }

    /// Reads rows as bytes.
    ///
    /// # Errors
    /// If the array holds other numbers, is damaged, or the rows exceed the limit of an array.
    pub fn octets(&self, rows: Range<usize>) -> Result<Vec<u8>> {
        match self.dataset.dtype() {
            Datatype::FixedPoint { size: 1, signed: false, .. } => self.read::<u8>(rows),
            _ => Err(self.expected("bytes")),
        }
    }

    /// Returns the number of rows in a chunk; 1 for an array without chunks.
    pub fn chunk_rows(&self) -> usize {
        self.dataset.chunks().and_then(|chunks| chunks.first().copied()).unwrap_or(1) as usize
    }

    /// Checks a quantity of this array against a limit.
    ///
    /// # Errors
    /// If it exceeds the limit.
    pub fn check(&self, limit: limits::Limit, got: u64) -> Result<()> {
        limit.check(&self.path, &self.name, got)
    }

    fn read<T: H5Type>(&self, rows: Range<usize>) -> Result<Vec<T>> {
        let shape = self.dataset.shape();
        let row = shape.iter().skip(1).try_fold(1u64, |product, length| product.checked_mul(*length));
        let size = self.dataset.raw_element_size().map_err(|error| failure(&self.path, &self.name, &error))? as u64;
        let bytes = row.and_then(|row| row.checked_mul(size)?.checked_mul(rows.len() as u64)).unwrap_or(u64::MAX);
        limits::ARRAY.check(&self.path, &self.name, bytes)?;
        let mut selections = vec![SliceInfoElem::Slice { start: rows.start as u64, end: rows.end as u64, step: 1 }];
        selections.extend(shape.iter().skip(1).map(|length| SliceInfoElem::Slice { start: 0, end: *length, step: 1 }));
        if shape.is_empty() {
            selections.clear();
        }
        let values = self.dataset.read_slice::<T>(&SliceInfo { selections });
        let values = values.map_err(|error| failure(&self.path, &self.name, &error))?;
        Ok(values.into_iter().collect())
    }

    fn expected(&self, what: &str) -> Error {
        self.damaged(&format!("expected {what}, got {:?}", self.dataset.dtype()))
    }

    /// Creates the error of this array.
    pub fn damaged(&self, message: &str) -> Error {
        Error::file(&self.path, format!("{}: {message}", self.name))
    }
}

impl H5Type for Reference {
    fn hdf5_type() -> Datatype {
        Datatype::Opaque { size: REFERENCE as u32, tag: String::new() }
    }

    fn from_bytes(bytes: &[u8], _: &Datatype) -> hdf5_reader::error::Result<Self> {
        let reference = bytes.get(..REFERENCE).and_then(|bytes| bytes.try_into().ok());
        reference.map(Self).ok_or_else(|| hdf5_reader::error::Error::InvalidData("a short reference to a list".into()))
    }

    fn element_size(_: &Datatype) -> usize {
        REFERENCE
    }
}

impl H5Type for Octet {
    fn hdf5_type() -> Datatype {
        Datatype::Opaque { size: 1, tag: String::new() }
    }

    fn from_bytes(bytes: &[u8], _: &Datatype) -> hdf5_reader::error::Result<Self> {
        let first = bytes.first().copied();
        first.map(Self).ok_or_else(|| hdf5_reader::error::Error::InvalidData("a value without bytes".into()))
    }

    fn element_size(_: &Datatype) -> usize {
        1
    }
}

impl std::fmt::Debug for Hdf5 {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Hdf5").field("path", &self.path).finish_non_exhaustive()
    }
}

/// Converts an error of the library; a failure of the medium stays one.
fn failure(path: &Path, name: &str, error: &hdf5_reader::error::Error) -> Error {
    Error::library(path, format!("{name}: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn golden(name: &str) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/hdf5").join(name)
    }

    #[test]
    fn files_of_h5py_read_back() {
        for name in ["small.h5", "latest.h5"] {
            let file = Hdf5::open(&golden(name)).unwrap();
            assert_eq!(file.groups("data").unwrap(), ["demo_2", "demo_10"], "{name}");
            assert_eq!(file.text("", "title").as_deref(), Some("tächtig"));
            assert_eq!(file.text("", "fixed").as_deref(), Some("fixed text"));
            assert_eq!((file.number("", "fps"), file.text("", "absent")), (Some(30.0), None));
            let array = |array: &str| file.required(&format!("data/demo_10/{array}")).unwrap();
            let quarters: Vec<f64> = (24..48).map(|k| f64::from(k) * 0.25).collect();
            assert_eq!(array("chunked").expect(&[5, 3, 4]).unwrap().numbers(2..4).unwrap(), quarters);
            assert_eq!(array("checked").numbers(4..5).unwrap(), (48..60).map(f64::from).collect::<Vec<_>>());
            assert_eq!(array("stamps").whole(3..5).unwrap(), [1_700_000_000_123_456_792, 1_700_000_000_123_456_793]);
            assert_eq!(array("truth").numbers(0..3).unwrap(), [1.0, 0.0, 1.0]);
            assert_eq!(array("growing").numbers(2..7).unwrap(), [2.0, 3.0, 4.0, 5.0, 6.0]);
            assert!(array("empty_chunks").numbers(0..4).unwrap().iter().all(|value| value.is_nan()));
            let lists = array("lists");
            assert_eq!(
                [0, 1, 2].map(|row| lists.bytes(row).unwrap()),
                [vec![0, 1, 2], vec![], vec![20, 21, 22, 23, 24]]
            );
            let error = array("pairs").numbers(0..2).unwrap_err().to_string();
            assert!(error.contains("data/demo_10/pairs: expected numbers, got Compound"), "{error}");
            assert!(file.array("data/demo_10/absent").unwrap().is_none() && file.array("no/where").unwrap().is_none());
        }
    }

    #[test]
    fn a_file_cut_or_damaged_anywhere_gives_values_or_an_error() {
        let whole = std::fs::read(golden("small.h5")).unwrap();
        let file = tempfile::NamedTempFile::new().unwrap();
        let read = |bytes: &[u8]| {
            std::fs::write(file.path(), bytes).unwrap();
            let file = Hdf5::open(file.path())?;
            for clip in file.groups("data")? {
                for name in file.arrays(&format!("data/{clip}"))? {
                    let array = file.required(&format!("data/{clip}/{name}"))?;
                    let rows = array.rows()?.min(5);
                    let _ = (array.numbers(0..rows).is_ok(), array.bytes(0).is_ok(), array.whole(0..rows).is_ok());
                }
            }
            Ok::<_, Error>(file.text("", "title"))
        };
        assert_eq!(read(&whole).unwrap().as_deref(), Some("tächtig"));
        for cut in (0..whole.len()).step_by(97) {
            let _ = read(&whole[..cut]);
        }
        for at in (0..whole.len()).step_by(53) {
            for damage in [0xff, 0x80, 0x01] {
                let mut bytes = whole.clone();
                bytes[at] ^= damage;
                let _ = read(&bytes);
            }
        }
    }
}
