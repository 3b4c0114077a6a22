//! File copies into an unfinished output, which a later attempt can resume.

use std::collections::BTreeSet;
use std::fs;
use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::file::input::{self, InputFolder};
use crate::file::turn::turn;

/// Folders and files below a folder of a data set, by their paths in the data set, sorted.
#[derive(Debug, Default)]
pub(super) struct Tree {
    pub folders: Vec<PathBuf>,
    pub files: Vec<PathBuf>,
    /// Targets of the links to folders that were followed.
    targets: BTreeSet<PathBuf>,
}

impl Tree {
    /// Lists everything below the folder `name` of the data set `root`, links followed.
    ///
    /// # Errors
    /// If a folder can't be listed, or a link leads out of the data set, to a folder around it, or to a folder that another
    /// link leads to.
    pub fn list(root: &InputFolder, name: impl AsRef<Path>) -> Result<Self> {
        let mut tree = Self::default();
        tree.add(root, name.as_ref())?;
        tree.folders.sort();
        tree.files.sort();
        Ok(tree)
    }

    fn add(&mut self, root: &InputFolder, name: &Path) -> Result<()> {
        let folder = root.path().join(name);
        for entry in fs::read_dir(&folder).map_err(Error::io(&folder))? {
            let entry = entry.map_err(Error::io(&folder))?;
            let (path, name) = (entry.path(), name.join(entry.file_name()));
            let is_link = entry.file_type().map_err(Error::io(&path))?.is_symlink();
            if is_link {
                root.check(&path)?;
            }
            if !fs::metadata(&path).map_err(Error::io(&path))?.is_dir() {
                self.files.push(name);
                continue;
            }
            if is_link {
                self.follow(&folder, &path)?;
            }
            self.folders.push(name.clone());
            self.add(root, &name)?;
        }
        Ok(())
    }

    /// Checks the link at `path` in `folder`, which leads to a folder: a hostile data set must not be copied without end.
    fn follow(&mut self, folder: &Path, path: &Path) -> Result<()> {
        let real = |path: &Path| path.canonicalize().map_err(Error::io(path));
        let target = real(path)?;
        let around = real(folder)?.starts_with(&target);
        if around || !self.targets.insert(target.clone()) {
            let to = if around { "a folder around it" } else { "a folder that another link leads to" };
            return Err(Error::file(path, format!("expected no link to {to}, got one to {}", target.display())));
        }
        Ok(())
    }
}

/// Copies the folder `from` into `to`. Links inside of `from` are followed, so that the copy holds no link. With `resume`,
/// the copy skips files of `to` that have the size of the original; otherwise it skips every existing file, since the
/// caller wrote those.
///
/// # Errors
/// If a file can't be read or written, is not a regular file, or a link leads out of `from`.
pub fn copy_folder(from: &Path, to: &Path, resume: bool) -> Result<()> {
    let root = InputFolder::open(from)?;
    let tree = Tree::list(&root, "")?;
    fs::create_dir_all(to).map_err(Error::io(to))?;
    for folder in tree.folders {
        let folder = to.join(folder);
        fs::create_dir_all(&folder).map_err(Error::io(&folder))?;
    }
    for name in tree.files {
        let (source, path) = (from.join(&name), to.join(&name));
        if resume || !path.exists() {
            copy_regular(&source, &path)?;
        }
    }
    Ok(())
}

/// Copies a regular file, unless `to` has its size.
///
/// # Errors
/// If it is not a regular file, or a file can't be read or written; the system does not tell which, so the error names both.
pub(super) fn copy_regular(from: &Path, to: &Path) -> Result<()> {
    let mut source = input::open(from)?;
    let size = source.metadata().map_err(Error::io(from))?.len();
    copy_file(to, size, |file| std::io::copy(&mut source, file)).map_err(|error| match error {
        Error::Io { path, source } if path == to => {
            Error::io(format!("{}, copied to {}", from.display(), to.display()))(source)
        }
        other => other,
    })
}

/// Writes `path` by way of a temporary name, unless it exists with `size` bytes.
///
/// # Errors
/// If `write` fails, or the file can't be written.
pub(super) fn copy_file(path: &Path, size: u64, write: impl FnOnce(&mut File) -> std::io::Result<u64>) -> Result<()> {
    if path.metadata().is_ok_and(|there| there.is_file() && there.len() == size) {
        return Ok(());
    }
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(Error::io(folder))?;
    }
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    let mut file = File::create(&partial).map_err(Error::io(&partial))?;
    // Write to disk before the rename: after a power loss, a file with the right name and size has the right content.
    if let Err(error) = write(&mut file).and_then(|_| file.sync_all()) {
        // Ignore a failed removal: the first error says more.
        let _ = fs::remove_file(&partial);
        return Err(Error::io(path)(error));
    }
    fs::rename(&partial, path).map_err(Error::io(path))
}

/// Removes a file or folder that an earlier, killed attempt left.
///
/// # Errors
/// If it can't be removed.
pub(crate) fn remove(at: &Path) -> Result<()> {
    let there = at.symlink_metadata();
    turn();
    let removed = match there {
        Ok(there) if there.is_dir() => fs::remove_dir_all(at),
        Ok(_) => fs::remove_file(at),
        Err(_) => Ok(()),
    };
    match removed {
        // Another process was faster.
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        removed => removed.map_err(Error::io(at)),
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn links_out_of_the_folder_pipes_and_circles_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let [from, to] = ["from", "to"].map(|name| folder.path().join(name));
        fs::create_dir_all(from.join("a/b")).unwrap();
        fs::write(from.join("a/b/file"), b"content").unwrap();
        fs::write(folder.path().join("secret"), b"secret").unwrap();
        symlink("a/b/file", from.join("inside")).unwrap();
        symlink("a/b", from.join("folder")).unwrap();
        copy_folder(&from, &to, false).unwrap();
        for name in ["a/b/file", "inside", "folder/file"] {
            assert_eq!(fs::read(to.join(name)).unwrap(), b"content");
            assert!(!to.join(name).is_symlink());
        }
        let bad = from.join("a/bad");
        for (target, words) in [
            ("../../secret", "outside of"),
            ("/etc/passwd", "outside of"),
            ("../a", "a folder around it"),
            ("b", "another link"),
        ] {
            symlink(target, &bad).unwrap();
            fs::remove_dir_all(&to).unwrap();
            let error = copy_folder(&from, &to, false).unwrap_err().to_string();
            assert!(error.contains(words) && error.contains("from/"), "{target}: {error}");
            assert!(!to.join("a/bad").exists());
            fs::create_dir_all(&to).unwrap();
            fs::remove_file(&bad).unwrap();
        }
        assert!(std::process::Command::new("mkfifo").arg(&bad).status().unwrap().success());
        let error = copy_folder(&from, &to, false).unwrap_err().to_string();
        assert!(error.contains("expected a regular file, got a pipe"), "{error}");
    }
}
