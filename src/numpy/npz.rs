//! Reads numpy `.npz` archives.

use std::io::{Cursor, Read, Seek};

use super::array::{Array, Dtype, Outcome};
use super::pickle::Pickle;
use crate::file::limits;

/// An archive of named arrays, which are decompressed on access.
pub(crate) struct Npz<R> {
    archive: zip::ZipArchive<R>,
}

impl<'a> Npz<Cursor<&'a [u8]>> {
    /// Opens an archive in memory.
    ///
    /// # Errors
    /// If the bytes are not a zip archive.
    pub fn open(bytes: &'a [u8]) -> Outcome<Self> {
        Self::new(Cursor::new(bytes))
    }
}

impl<R: Read + Seek> Npz<R> {
    /// Opens an archive that is read member by member.
    ///
    /// # Errors
    /// If it is not a zip archive.
    pub fn new(reader: R) -> Outcome<Self> {
        let archive = zip::ZipArchive::new(reader).map_err(|error| format!("no .npz archive: {error}"))?;
        Ok(Self { archive })
    }

    /// Returns the array names.
    pub fn keys(&self) -> Vec<String> {
        let names = self.archive.file_names().filter_map(|name| name.ok());
        names.map(|name| name.strip_suffix(".npy").unwrap_or(&name).to_string()).collect()
    }

    /// Reads the array of a name; `None` if the archive has no such member.
    ///
    /// # Errors
    /// If the member is damaged or is not a numeric array.
    pub fn array(&mut self, name: &str) -> Outcome<Option<Array>> {
        self.member(name)?.map(|bytes| read_npy(&bytes)).transpose()
    }

    /// Reads the `.npy` file of a name; `None` if the archive has no such member.
    ///
    /// # Errors
    /// If the member is damaged, or larger than the limit of a chunk.
    pub fn member(&mut self, name: &str) -> Outcome<Option<Vec<u8>>> {
        let member = match self.archive.by_name(&format!("{name}.npy")) {
            Ok(member) => member,
            Err(zip::result::ZipError::FileNotFound) => return Ok(None),
            Err(error) => return Err(error.to_string()),
        };
        let mut bytes = Vec::new();
        // The header's size may lie, so the bytes are counted.
        let most = limits::CHUNK.value();
        member.take(most.saturating_add(1)).read_to_end(&mut bytes).map_err(|error| error.to_string())?;
        if bytes.len() as u64 > most {
            let variable = limits::CHUNK.variable();
            return Err(format!("expected at most {most} bytes, got more; {variable} raises the limit"));
        }
        Ok(Some(bytes))
    }
}

/// Reads a `.npy` file of version 1 to 3. An object array with one element gives the array in it.
///
/// # Errors
/// If it is damaged, or holds no numbers.
pub(crate) fn read_npy(bytes: &[u8]) -> Outcome<Array> {
    let (header, data) = npy_header(bytes)?;
    let descr = field(header, "descr").and_then(quoted).ok_or("a .npy header without descr")?;
    if descr.ends_with('O') {
        return Pickle::read(data)?.root_array();
    }
    let fortran = field(header, "fortran_order").ok_or("a .npy header without fortran_order")?.starts_with("True");
    let shape = field(header, "shape").and_then(numbers).ok_or("a .npy header without shape")?;
    Array::from_bytes(data, Dtype::parse(descr)?, shape, fortran)
}

/// Returns the pickle in a `.npy` file of objects.
///
/// # Errors
/// If the file holds numbers, or is damaged.
pub(crate) fn npy_pickle(bytes: &[u8]) -> Outcome<&[u8]> {
    let (header, data) = npy_header(bytes)?;
    match field(header, "descr").and_then(quoted) {
        Some(descr) if descr.ends_with('O') => Ok(data),
        other => Err(format!("expected a .npy file of objects, got elements {}", other.unwrap_or("without a type"))),
    }
}

/// Returns the first text of a `.npy` file of Unicode texts; `None` if it is damaged or holds something else.
pub(crate) fn first_text(bytes: &[u8]) -> Option<String> {
    let (header, data) = npy_header(bytes).ok()?;
    let length: usize = field(header, "descr").and_then(quoted)?.strip_prefix("<U")?.parse().ok()?;
    let words = data.get(..length.checked_mul(4)?)?.as_chunks::<4>().0;
    let text: Option<String> = words.iter().map(|word| char::from_u32(u32::from_le_bytes(*word))).collect();
    // Shorter texts are padded with zeros.
    text.map(|text| text.trim_end_matches('\0').to_string())
}

/// Splits a `.npy` file into header and data.
fn npy_header(bytes: &[u8]) -> Outcome<(&str, &[u8])> {
    let rest = bytes.strip_prefix(b"\x93NUMPY").ok_or("no .npy magic number")?;
    let ([version, _minor], rest) = rest.split_first_chunk().ok_or("no .npy version")?;
    let (length, rest) = if *version == 1 {
        rest.split_first_chunk().map(|(length, rest)| (usize::from(u16::from_le_bytes(*length)), rest))
    } else {
        rest.split_first_chunk().map(|(length, rest)| (u32::from_le_bytes(*length) as usize, rest))
    }
    .ok_or("no .npy header")?;
    let (header, data) = rest.split_at_checked(length).ok_or("a truncated .npy header")?;
    let header = std::str::from_utf8(header).map_err(|_| "a .npy header that is not text")?;
    Ok((header, data))
}

/// Returns the text after `'name':` in the header, which is a Python dictionary literal.
fn field<'a>(header: &'a str, name: &str) -> Option<&'a str> {
    let (_, value) = header.split_once(&format!("'{name}':"))?;
    Some(value.trim_start())
}

/// Parses a Python string literal.
fn quoted(value: &str) -> Option<&str> {
    value.strip_prefix('\'')?.split('\'').next()
}

/// Parses a Python tuple of numbers.
fn numbers(value: &str) -> Option<Vec<usize>> {
    let (inner, _) = value.strip_prefix('(')?.split_once(')')?;
    inner.split(',').map(str::trim).filter(|item| !item.is_empty()).map(|item| item.parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn npy(header: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(data);
        bytes
    }

    #[test]
    fn npy_with_fortran_order_reads_row_major() {
        let bytes = npy("{'descr': '|u1', 'fortran_order': True, 'shape': (2, 2), }\n", &[1, 2, 3, 4]);
        assert_eq!(read_npy(&bytes).unwrap(), Array { shape: vec![2, 2], data: vec![1.0, 3.0, 2.0, 4.0] });
    }

    #[test]
    fn a_header_of_many_dimensions_is_refused() {
        for count in [33, 60_000] {
            let shape = "1,".repeat(count);
            let header = format!("{{'descr': '|u1', 'fortran_order': True, 'shape': ({shape}), }}\n");
            let mut bytes = b"\x93NUMPY\x02\x00".to_vec();
            bytes.extend((header.len() as u32).to_le_bytes());
            bytes.extend(header.as_bytes());
            bytes.push(0);
            let message = read_npy(&bytes).unwrap_err();
            assert!(message.contains("at most 32 dimensions"), "{message}");
        }
    }

    #[test]
    fn sparse_matrix_in_an_object_array_is_read_as_a_dense_array() {
        let bytes = include_bytes!("../../tests/data/hand/small.npz");
        let mut npz = Npz::open(bytes).unwrap();
        let dense = Array { shape: vec![2, 3], data: vec![0.0, 2.0, 0.0, 1.0, 0.0, 3.0] };
        assert_eq!(npz.array("box").unwrap(), Some(dense));
        assert_eq!(npz.array("empty").unwrap().unwrap().shape, [0, 3]);
        assert_eq!(npz.array("absent").unwrap(), None);
    }

    #[test]
    fn first_of_several_unicode_texts_is_read_without_its_padding() {
        let header = "{'descr': '<U3', 'fortran_order': False, 'shape': (2,), }\n";
        let data: Vec<u8> = "P1\0abc".chars().flat_map(|char| (char as u32).to_le_bytes()).collect();
        assert_eq!(first_text(&npy(header, &data)).as_deref(), Some("P1"));
        assert_eq!(first_text(&npy(header, &data[..11])), None);
        assert_eq!(first_text(&npy(&header.replace("<U3", "<f8"), &data)), None);
    }

    #[test]
    fn damaged_npy_is_an_error() {
        let bytes = npy("{'descr': '<f8', 'fortran_order': False, 'shape': (2,), }\n", &[0; 16]);
        assert!(read_npy(&bytes).is_ok());
        for end in 0..bytes.len() {
            assert!(read_npy(&bytes[..end]).is_err(), "cut at {end}");
        }
    }
}
