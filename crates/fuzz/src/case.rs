//! A hostile input: a file, or a folder of files.

use std::collections::BTreeMap;
use std::fs;
use std::io::Read;
use std::path::Path;

use anyhow::Context;

/// An input of a target.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Case {
    /// Content of a file.
    File(Vec<u8>),
    /// Contents of a folder's files, by relative path.
    Folder(BTreeMap<String, Vec<u8>>),
}

impl Case {
    /// Reads a file or folder, or the folder in a file `*.zip`.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        if !path.is_dir() {
            if path.extension().is_some_and(|end| end == "zip") {
                return read_zip(path).with_context(|| path.display().to_string());
            }
            return Ok(Self::File(fs::read(path).with_context(|| path.display().to_string())?));
        }
        let mut files = BTreeMap::new();
        read_folder(path, "", &mut files)?;
        Ok(Self::Folder(files))
    }

    /// Writes the input at `path` and removes what was there.
    pub fn write(&self, path: &Path) -> anyhow::Result<()> {
        if path.is_dir() {
            fs::remove_dir_all(path)?;
        }
        match self {
            Self::File(bytes) => fs::write(path, bytes)?,
            Self::Folder(files) => {
                fs::create_dir_all(path)?;
                for (name, bytes) in files {
                    let file = path.join(name);
                    fs::create_dir_all(file.parent().unwrap_or(path))?;
                    fs::write(file, bytes)?;
                }
            }
        }
        Ok(())
    }

    /// Returns the size of all files, bytes.
    pub fn size(&self) -> usize {
        match self {
            Self::File(bytes) => bytes.len(),
            Self::Folder(files) => files.values().map(Vec::len).sum(),
        }
    }

    /// Returns smaller inputs, the smallest first: files left out, and bytes cut off or out.
    pub fn smaller(&self) -> Vec<Self> {
        match self {
            Self::File(bytes) => shorter(bytes).into_iter().map(Self::File).collect(),
            Self::Folder(files) => {
                let mut found = Vec::new();
                for name in files.keys() {
                    let mut fewer = files.clone();
                    fewer.remove(name);
                    found.push(Self::Folder(fewer));
                }
                for (name, bytes) in files {
                    for short in shorter(bytes) {
                        let mut changed = files.clone();
                        changed.insert(name.clone(), short);
                        found.push(Self::Folder(changed));
                    }
                }
                found
            }
        }
    }
}

/// Returns `bytes` without its end, its start or its middle.
fn shorter(bytes: &[u8]) -> Vec<Vec<u8>> {
    let n = bytes.len();
    let mut found = Vec::new();
    for part in [2, 4, 8, 16] {
        let size = n / part;
        if size > 0 {
            found.push(bytes[..n - size].to_vec());
            found.push(bytes[size..].to_vec());
            let middle = (n - size) / 2;
            found.push([&bytes[..middle], &bytes[middle + size..]].concat());
        }
    }
    found
}

fn read_zip(path: &Path) -> anyhow::Result<Case> {
    let mut archive = zip::ZipArchive::new(fs::File::open(path)?)?;
    let mut files = BTreeMap::new();
    for index in 0..archive.len() {
        let mut member = archive.by_index(index)?;
        let (name, mut bytes) = (member.name()?.to_string(), Vec::new());
        member.read_to_end(&mut bytes)?;
        files.insert(name, bytes);
    }
    Ok(Case::Folder(files))
}

fn read_folder(folder: &Path, prefix: &str, files: &mut BTreeMap<String, Vec<u8>>) -> anyhow::Result<()> {
    for entry in fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let entry = entry?;
        let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
        match entry.file_type()?.is_dir() {
            true => read_folder(&entry.path(), &format!("{name}/"), files)?,
            false => drop(files.insert(name, fs::read(entry.path())?)),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_reads_back_and_has_smaller_forms() {
        let temp = tempfile::tempdir().unwrap();
        let files = BTreeMap::from([("a".into(), vec![1; 9]), ("b/c".into(), vec![2; 4])]);
        let case = Case::Folder(files);
        let path = temp.path().join("case");
        case.write(&path).unwrap();
        assert_eq!(Case::read(&path).unwrap(), case);
        let smaller = case.smaller();
        assert!(!smaller.is_empty() && smaller.iter().all(|other| other.size() < case.size()));
    }
}
