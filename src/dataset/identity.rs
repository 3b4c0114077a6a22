//! Identity of an input: sizes and content of the files that hold its images and their times.

use std::fs::Metadata;
use std::io::ErrorKind;
use std::os::unix::fs::{FileExt, MetadataExt};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::copy::Tree;
use crate::error::{Error, Result};
use crate::file::input::{self, InputFolder};
use crate::text;

/// Largest number of files of a group whose content is read; of more files it is an even choice with the first and last.
const READ_FILES: usize = 64;
/// Size of a block that is read, bytes.
const BLOCK: u64 = 64 << 10;
/// Largest number of blocks that are read of a file: head, tail and an even choice between them.
const BLOCKS: u64 = 16;

/// Files of an input that hold images and their times.
#[derive(Debug, Clone, Default)]
pub struct InputFiles {
    roots: Vec<PathBuf>,
    /// Groups of files of one kind, each file with its name in the input.
    groups: Vec<Vec<(PathBuf, PathBuf)>>,
}

impl InputFiles {
    /// Starts the list of the input at `root`, a file or folder.
    pub fn new(root: &Path) -> Self {
        Self { roots: vec![root.to_path_buf()], groups: Vec::new() }
    }

    /// Adds a group of files; those that do not exist are left out.
    pub fn add(&mut self, files: impl IntoIterator<Item = PathBuf>) {
        let root = self.roots.first().cloned().unwrap_or_default();
        let named = |path: PathBuf| (path.strip_prefix(&root).unwrap_or(&path).to_path_buf(), path);
        let mut group: Vec<_> = files.into_iter().filter(|path| path.exists()).map(named).collect();
        group.sort();
        group.dedup();
        self.groups.push(group);
    }

    /// Adds all files below the folder `name` of the input, if there is one, as a group.
    ///
    /// # Errors
    /// If a folder can't be listed, or a link leads out of the input.
    pub fn add_folder(&mut self, name: &str) -> Result<()> {
        let root = InputFolder::open(self.roots.first().map_or(Path::new("."), PathBuf::as_path))?;
        let files = match root.join(name)?.is_dir() {
            true => Tree::list(&root, name)?.files,
            false => Vec::new(),
        };
        self.add(files.into_iter().map(|file| root.path().join(file)));
        Ok(())
    }

    /// Adds the files of another input.
    pub fn append(&mut self, other: Self) {
        self.roots.extend(other.roots);
        self.groups.extend(other.groups);
    }
}

/// Identity of an input wherever it lies. Equal identities mean the same images at the same times.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct InputIdentity {
    /// Number of files that hold images and their times.
    pub files: u64,
    /// Sum of their sizes, bytes.
    pub bytes: u64,
    /// SHA-256 over names, sizes and content: of each group of files up to 64, of each of these up to 16 blocks of 64 KiB.
    pub sha256: String,
}

impl std::fmt::Display for InputIdentity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { files, bytes, sha256 } = self;
        write!(f, "{files} files, {bytes} bytes, sha256 {}", sha256.get(..12).unwrap_or(sha256))
    }
}

/// State of an input at one place: its identity, and what shows a change of content that the identity does not read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct InputState {
    /// Identity.
    pub identity: InputIdentity,
    /// Absolute paths of the input.
    pub places: Vec<String>,
    /// SHA-256 over the modification times of the files that were not read whole; empty without such files.
    modified: String,
}

impl InputState {
    /// Reads the state of the input in `files`.
    ///
    /// # Errors
    /// If a file can't be read.
    pub fn of(files: &InputFiles) -> Result<Self> {
        let (mut content, mut modified) = (Sha256::new(), Sha256::new());
        let (mut n_files, mut bytes, mut partial) = (0, 0, false);
        for group in &files.groups {
            content.update((group.len() as u64).to_le_bytes());
            for (index, (name, path)) in group.iter().enumerate() {
                let metadata = path.metadata().map_err(Error::io(path))?;
                let name = name.as_os_str().as_encoded_bytes();
                content.update((name.len() as u64).to_le_bytes());
                content.update(name);
                content.update(metadata.len().to_le_bytes());
                let whole = is_read(index, group.len()) && add_content(&mut content, path, &metadata)?;
                if !whole {
                    partial = true;
                    modified.update([metadata.mtime(), metadata.mtime_nsec()].map(i64::to_le_bytes).concat());
                }
                n_files += 1;
                bytes += metadata.len();
            }
        }
        let hex = |hash: Sha256| hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect::<String>();
        let place = |root: &PathBuf| root.canonicalize().unwrap_or_else(|_| root.clone()).display().to_string();
        Ok(Self {
            identity: InputIdentity { files: n_files, bytes, sha256: hex(content) },
            places: files.roots.iter().map(place).collect(),
            modified: if partial { hex(modified) } else { String::new() },
        })
    }

    /// True if `later` is the same input: by content wherever it lies; at the same place, files whose content was not read
    /// whole must not have been written to either.
    pub fn is_same(&self, later: &Self) -> bool {
        self.identity == later.identity && (self.places != later.places || self.modified == later.modified)
    }

    /// Returns the place of the input for messages.
    pub fn place(&self) -> String {
        text::printable_name(&self.places.join(", ")).into_owned()
    }
}

/// True if the content of file `index` of `n` takes part in the identity.
fn is_read(index: usize, n: usize) -> bool {
    // Choose READ_FILES of n: file i is chosen where the rounded line through (0, 0) and (n - 1, READ_FILES - 1) steps.
    let line = |index: usize| index * (READ_FILES - 1) / (n - 1).max(1);
    n <= READ_FILES || index == 0 || line(index) > line(index - 1)
}

/// Adds a file's content, or blocks of it; true if it was the whole content.
fn add_content(hash: &mut Sha256, path: &Path, metadata: &Metadata) -> Result<bool> {
    let file = input::open(path)?;
    let size = metadata.len();
    let mut buffer = vec![0; BLOCK as usize];
    let mut add = |start: u64| -> Result<()> {
        let block = &mut buffer[..(size - start).min(BLOCK) as usize];
        match file.read_exact_at(block, start) {
            Ok(()) => hash.update(block),
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => {
                return Err(Error::file(path, "became shorter while it was read"));
            }
            Err(error) => return Err(Error::io(path)(error)),
        }
        Ok(())
    };
    if size <= BLOCK * BLOCKS {
        (0..size).step_by(BLOCK as usize).try_for_each(&mut add)?;
        return Ok(true);
    }
    // The last block ends with the file.
    let last = size - BLOCK;
    (0..BLOCKS)
        .map(|block| (u128::from(last) * u128::from(block) / u128::from(BLOCKS - 1)) as u64)
        .try_for_each(add)?;
    Ok(false)
}

#[cfg(test)]
mod tests {
    use std::fs::{self, File};
    use std::time::{Duration, SystemTime};

    use super::*;

    fn state(path: &Path) -> InputState {
        let mut files = InputFiles::new(path);
        files.add([path.to_path_buf()]);
        InputState::of(&files).unwrap()
    }

    fn touch(path: &Path) {
        let file = File::options().write(true).open(path).unwrap();
        file.set_modified(SystemTime::UNIX_EPOCH + Duration::from_secs(7)).unwrap();
    }

    #[test]
    fn an_input_is_known_by_content_and_a_large_one_at_its_place_by_its_time_too() {
        let folder = tempfile::tempdir().unwrap();
        let [small, large, copy] = ["small", "large", "copy"].map(|name| folder.path().join(name));
        let content: Vec<u8> = (0..2_000_000u32).map(|i| (i / 251) as u8).collect();
        fs::write(&small, &content[..100_000]).unwrap();
        fs::write(&large, &content).unwrap();
        fs::write(&copy, &content).unwrap();
        touch(&copy);
        let (of_small, of_large) = (state(&small), state(&large));
        assert!(of_large.is_same(&state(&copy)), "a copy");
        assert!(!of_small.is_same(&of_large));
        touch(&small);
        touch(&large);
        assert!(of_small.is_same(&state(&small)), "content that is read whole decides alone");
        assert!(!of_large.is_same(&state(&large)), "written to in place");
        for place in [0, 1_000_000, 1_999_999] {
            let mut other = content.clone();
            other[place] ^= 1;
            fs::write(&copy, other).unwrap();
            assert_eq!(of_large.identity == state(&copy).identity, place == 1_000_000, "{place}");
        }
        fs::write(&copy, &content[..1_999_999]).unwrap();
        assert!(!of_large.is_same(&state(&copy)));
    }

    #[test]
    fn of_many_files_an_even_choice_is_read() {
        for n in [1, 2, 64, 65, 1000, 100_000] {
            let read: Vec<usize> = (0..n).filter(|index| is_read(*index, n)).collect();
            assert_eq!((read.len(), read[0], read[read.len() - 1]), (n.min(READ_FILES), 0, n - 1));
        }
    }
}
