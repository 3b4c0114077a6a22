//! Files of a store, in a folder or a zip file: regular files inside the store, with bounded reads.

use std::collections::HashMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use zarrs::storage::byte_range::{ByteRange, ByteRangeIterator, InvalidByteRangeError};
use zarrs::storage::{Bytes, MaybeBytesIterator, ReadableStorageTraits, StorageError, StoreKey};
use zip::ZipArchive;

use crate::dataset::copy::Tree;
use crate::error::{Error, Result};
use crate::file::input::{self, InputFolder};
use crate::file::limits::{self, Limit};

/// Ends of the names of files that hold metadata.
const METADATA: [&str; 5] = [".zarray", ".zattrs", ".zgroup", ".zmetadata", "zarr.json"];
/// Size of the buffer of small reads from a zip file, bytes.
const AHEAD: usize = 16 << 10;
/// Largest depth of folders below an array: one for each axis of its chunks, and some.
const DEPTH: usize = 12;

/// Files of one store.
pub(super) struct StoreFiles(Place);

enum Place {
    Folder(InputFolder),
    Zip(ZipFiles),
}

struct ZipFiles {
    path: PathBuf,
    archive: ZipArchive<SharedFile>,
    /// Places of the files by name. The library searches all files for a name that is absent.
    places: HashMap<String, usize>,
    /// Folder within the archive, ending in `/`, or empty.
    inside: String,
}

impl StoreFiles {
    /// Opens the store in the folder `path`.
    ///
    /// # Errors
    /// If there is no such folder.
    pub fn folder(path: &Path) -> Result<Self> {
        Ok(Self(Place::Folder(InputFolder::open(path)?)))
    }

    /// Opens the store in the folder `inside` of the zip file `path`; stored and deflated files are read.
    ///
    /// # Errors
    /// If it can't be read or is not a zip file.
    pub fn zip(path: &Path, inside: &str) -> Result<Self> {
        let archive = open_zip(path)?;
        let named = archive.file_names().enumerate().filter_map(|(place, name)| Some((name.ok()?.into_owned(), place)));
        let (places, inside) = (named.collect(), inside.to_string());
        Ok(Self(Place::Zip(ZipFiles { path: path.to_path_buf(), archive, places, inside })))
    }

    /// Returns the names of the folders directly in `folder`, which ends in `/`.
    ///
    /// # Errors
    /// If it can't be read.
    pub fn folders_in(&self, folder: &str) -> Result<Vec<String>> {
        let mut names = Vec::new();
        match &self.0 {
            Place::Folder(root) => {
                let path = root.join(folder)?;
                if !path.is_dir() {
                    return Ok(names);
                }
                for entry in path.read_dir().map_err(Error::io(&path))? {
                    let entry = entry.map_err(Error::io(&path))?;
                    if entry.path().is_dir() {
                        names.extend(entry.file_name().into_string().ok());
                    }
                }
            }
            Place::Zip(zip) => {
                let prefix = format!("{}{folder}", zip.inside);
                for name in zip.archive.file_names() {
                    let name = name.map_err(|e| Error::file(&zip.path, e))?;
                    names.extend(name.strip_prefix(&prefix).and_then(|rest| Some(rest.split_once('/')?.0.to_string())));
                }
            }
        }
        names.sort();
        names.dedup();
        Ok(names)
    }

    /// True if the store has a file of this name.
    ///
    /// # Errors
    /// If it can't be looked up.
    pub fn has(&self, name: &str) -> Result<bool> {
        match &self.0 {
            Place::Folder(root) => Ok(root.join(name)?.is_file()),
            Place::Zip(zip) => Ok(zip.place(name).is_some()),
        }
    }

    /// Returns the names below `folder` of all files and folders in it and in its folders, and their sizes in bytes.
    ///
    /// # Errors
    /// If a folder can't be read, or a link leads out of the store.
    pub fn entries_in(&self, folder: &str) -> Result<Vec<(String, u64)>> {
        let mut files = Vec::new();
        match &self.0 {
            Place::Folder(root) => {
                let (path, tree) = (root.join(folder)?, Tree::list(root, folder)?);
                for name in tree.files.into_iter().chain(tree.folders) {
                    let file = root.path().join(&name);
                    let size = file.metadata().map_err(Error::io(&file))?.len();
                    let name = file.strip_prefix(&path).unwrap_or(&file).to_string_lossy();
                    files.push((name.into_owned(), size));
                }
            }
            Place::Zip(zip) => {
                let (prefix, mut archive) = (zip.named(&format!("{folder}/")), zip.archive.clone());
                for index in 0..archive.len() {
                    let entry = archive.by_index_raw(index).map_err(|e| Error::file(&zip.path, e))?;
                    let name = entry.name().ok().and_then(|name| Some(name.strip_prefix(&prefix)?.to_string()));
                    files.extend(name.map(|name| (name, entry.compressed_size())));
                }
            }
        }
        Ok(files)
    }

    /// Returns the number of bytes of the files below `folder`, or a number above `enough` as soon as it is reached.
    ///
    /// # Errors
    /// If the folder can't be read.
    pub fn bytes_below(&self, folder: &str, enough: u64) -> Result<u64> {
        match &self.0 {
            Place::Folder(root) => bytes_in(&root.join(folder)?, enough, DEPTH),
            Place::Zip(zip) => {
                let (prefix, mut archive) = (zip.named(&format!("{folder}/")), zip.archive.clone());
                let mut bytes = 0;
                for index in 0..archive.len() {
                    let entry = archive.by_index_raw(index).map_err(|e| Error::file(&zip.path, e))?;
                    if bytes > enough {
                        break;
                    }
                    bytes += if entry.name().is_ok_and(|name| name.starts_with(&prefix)) {
                        entry.compressed_size()
                    } else {
                        0
                    };
                }
                Ok(bytes)
            }
        }
    }

    /// Reads ranges of a file; None if there is no such file.
    fn read(&self, key: &str, ranges: ByteRangeIterator<'_>) -> std::result::Result<Option<Vec<Bytes>>, StorageError> {
        let limit = limit(key);
        let (path, size, whole) = match &self.0 {
            Place::Folder(root) => {
                let path = root.join(key).map_err(storage_error)?;
                let file = match input::open(&path) {
                    Ok(file) => file,
                    Err(Error::Io { source, .. }) if is_absent(&source) => return Ok(None),
                    Err(error) => return Err(storage_error(error)),
                };
                let size = file.metadata().map_err(|e| storage_error(Error::io(&path)(e)))?.len();
                (path, size, FileContent::File(file))
            }
            Place::Zip(zip) => match zip.read(key, limit).map_err(storage_error)? {
                Some(bytes) => (zip.path.clone(), bytes.len() as u64, FileContent::Bytes(bytes)),
                None => return Ok(None),
            },
        };
        let mut parts = Vec::new();
        for range in ranges {
            let (start, length) = within(range, size)?;
            limit.check(&path, "bytes to read", length).map_err(storage_error)?;
            parts.push(match &whole {
                FileContent::Bytes(bytes) => Bytes::copy_from_slice(&bytes[start as usize..(start + length) as usize]),
                FileContent::File(file) => {
                    let mut bytes = vec![0; length as usize];
                    file.read_exact_at(&mut bytes, start).map_err(|e| storage_error(Error::io(&path)(e)))?;
                    bytes.into()
                }
            });
        }
        Ok(Some(parts))
    }
}

/// Wraps an error for the library; [`failed_read`] finds an error of the operating system again, with its file.
fn storage_error(error: Error) -> StorageError {
    match &error {
        Error::Io { source, .. } => std::io::Error::new(source.kind(), error).into(),
        _ => StorageError::Other(error.to_string()),
    }
}

/// Returns the error of the operating system that made a read of a store fail, if one did.
pub(super) fn failed_read(error: &StorageError) -> Option<Error> {
    let StorageError::IOError(error) = error else { return None };
    match error.get_ref()?.downcast_ref::<Error>()? {
        Error::Io { path, source } => Some(Error::io(path)(std::io::Error::from_raw_os_error(source.raw_os_error()?))),
        _ => None,
    }
}

/// Content of a file that is read in ranges.
enum FileContent {
    File(File),
    Bytes(Vec<u8>),
}

impl ReadableStorageTraits for StoreFiles {
    fn get_partial_many<'a>(
        &'a self,
        key: &StoreKey,
        byte_ranges: ByteRangeIterator<'a>,
    ) -> std::result::Result<MaybeBytesIterator<'a>, StorageError> {
        Ok(match self.read(key.as_str(), byte_ranges)? {
            Some(parts) => Some(Box::new(parts.into_iter().map(Ok))),
            None => None,
        })
    }

    fn size_key(&self, key: &StoreKey) -> std::result::Result<Option<u64>, StorageError> {
        match &self.0 {
            Place::Folder(root) => match root.join(key.as_str()).map_err(storage_error)?.metadata() {
                Ok(there) if there.is_file() => Ok(Some(there.len())),
                Ok(_) => Ok(None),
                Err(error) if is_absent(&error) => Ok(None),
                Err(error) => Err(error.into()),
            },
            Place::Zip(zip) => {
                let Some(index) = zip.place(key.as_str()) else { return Ok(None) };
                let mut archive = zip.archive.clone();
                let entry = archive.by_index_raw(index).map_err(|e| StorageError::Other(e.to_string()))?;
                Ok(Some(entry.size()))
            }
        }
    }

    fn supports_get_partial(&self) -> bool {
        true
    }
}

impl ZipFiles {
    fn named(&self, name: &str) -> String {
        format!("{}{name}", self.inside)
    }

    /// Returns the index of a file of the store.
    fn place(&self, name: &str) -> Option<usize> {
        self.places.get(&self.named(name)).copied()
    }

    /// Reads a file of the archive whole, and checks its checksum; None if there is none.
    fn read(&self, name: &str, limit: Limit) -> Result<Option<Vec<u8>>> {
        let fail = |error: &dyn std::fmt::Display| Error::file(&self.path, format!("{}: {error}", self.named(name)));
        let Some(place) = self.place(name) else { return Ok(None) };
        let mut archive = self.archive.clone();
        let entry = archive.by_index(place).map_err(|error| fail(&error))?;
        limit.check(&self.path, name, entry.size())?;
        let mut bytes = Vec::new();
        // The size in the archive's directory may be wrong.
        entry.take(limit.value().saturating_add(1)).read_to_end(&mut bytes).map_err(|e| match e.raw_os_error() {
            Some(_) => Error::io(self.path.join(self.named(name)))(e),
            None => fail(&e),
        })?;
        limit.check(&self.path, name, bytes.len() as u64)?;
        Ok(Some(bytes))
    }
}

/// Opens a zip file.
///
/// # Errors
/// If it can't be read or is not a zip file.
pub(super) fn open_zip(path: &Path) -> Result<ZipArchive<SharedFile>> {
    let file = input::open(path)?;
    let size = file.metadata().map_err(Error::io(path))?.len();
    let shared = SharedFile { file: Arc::new(file), at: 0, size, ahead: Vec::new(), ahead_at: 0 };
    ZipArchive::new(shared).map_err(|e| Error::file(path, format!("expected a zip file: {e}")))
}

/// An open file with a position of its own, which threads can share. Small reads are buffered: the directory of an archive
/// consists of them.
#[derive(Debug)]
pub(super) struct SharedFile {
    file: Arc<File>,
    at: u64,
    size: u64,
    /// Bytes that were read ahead, and their offset in the file.
    ahead: Vec<u8>,
    ahead_at: u64,
}

impl Clone for SharedFile {
    fn clone(&self) -> Self {
        Self { file: self.file.clone(), at: self.at, size: self.size, ahead: Vec::new(), ahead_at: 0 }
    }
}

impl Read for SharedFile {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        if buffer.len() >= AHEAD {
            let count = self.file.read_at(buffer, self.at)?;
            self.at += count as u64;
            return Ok(count);
        }
        if !(self.ahead_at..self.ahead_at + self.ahead.len() as u64).contains(&self.at) {
            self.ahead.resize(AHEAD, 0);
            let count = self.file.read_at(&mut self.ahead, self.at);
            self.ahead.truncate(*count.as_ref().unwrap_or(&0));
            count?;
            self.ahead_at = self.at;
        }
        let ready = &self.ahead[(self.at - self.ahead_at) as usize..];
        let count = ready.len().min(buffer.len());
        buffer[..count].copy_from_slice(&ready[..count]);
        self.at += count as u64;
        Ok(count)
    }
}

impl Seek for SharedFile {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        let place = match to {
            SeekFrom::Start(place) => Some(place),
            SeekFrom::End(by) => self.size.checked_add_signed(by),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
        };
        self.at = place.ok_or(std::io::ErrorKind::InvalidInput)?;
        Ok(self.at)
    }
}

fn limit(key: &str) -> Limit {
    if METADATA.iter().any(|name| key.ends_with(name)) { limits::TEXT } else { limits::CHUNK }
}

fn is_absent(error: &std::io::Error) -> bool {
    matches!(error.kind(), std::io::ErrorKind::NotFound | std::io::ErrorKind::NotADirectory)
}

/// Returns start and length of a range in a file of `size` bytes.
fn within(range: ByteRange, size: u64) -> std::result::Result<(u64, u64), StorageError> {
    let place = match range {
        ByteRange::FromStart(start, length) => size.checked_sub(start).and_then(|rest| {
            let length = length.unwrap_or(rest);
            (length <= rest).then_some((start, length))
        }),
        ByteRange::Suffix(length) => size.checked_sub(length).map(|start| (start, length)),
    };
    place.ok_or_else(|| InvalidByteRangeError::new(range, size).into())
}

fn bytes_in(folder: &Path, enough: u64, depth: usize) -> Result<u64> {
    let mut bytes = 0;
    for entry in folder.read_dir().map_err(Error::io(folder))? {
        let path = entry.map_err(Error::io(folder))?.path();
        match path.metadata() {
            Ok(there) if there.is_file() => bytes += there.len(),
            Ok(there) if there.is_dir() && depth > 0 => bytes += bytes_in(&path, enough, depth - 1)?,
            _ => {}
        }
        if bytes > enough {
            break;
        }
    }
    Ok(bytes)
}
