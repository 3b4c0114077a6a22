//! Opening of files from outside: regular files only, inside their data set, with bounded reads.

use std::fs::{File, OpenOptions};
use std::io::Read;
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::{Component, Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use super::limits::Limit;
use crate::error::{Error, Result};

/// True if links may leave their data set; `--follow-links`.
static FOLLOW_LINKS: AtomicBool = AtomicBool::new(false);

/// Lets symbolic links inside data sets lead outside of them, for all folders opened later in this process.
pub fn follow_links() {
    FOLLOW_LINKS.store(true, Ordering::Relaxed);
}

/// Opens a regular file to read.
///
/// # Errors
/// If there is none, or it is a directory, pipe, device or socket. It never waits for the other end of a pipe.
pub fn open(path: &Path) -> Result<File> {
    // Without O_NONBLOCK, opening a pipe waits for a writer. The flag has no effect on a regular file.
    let file = OpenOptions::new().read(true).custom_flags(libc::O_NONBLOCK).open(path).map_err(Error::io(path))?;
    let kind = file.metadata().map_err(Error::io(path))?.file_type();
    if kind.is_file() {
        return Ok(file);
    }
    let got = match kind {
        kind if kind.is_dir() => "a directory",
        kind if kind.is_fifo() => "a pipe",
        kind if kind.is_socket() => "a socket",
        _ => "a device",
    };
    Err(Error::file(path, format!("expected a regular file, got {got}")))
}

/// Reads a regular file whole.
///
/// # Errors
/// As [`open()`], and if the file is larger than `limit`, also where it grows while it is read.
pub fn read(path: &Path, limit: Limit) -> Result<Vec<u8>> {
    let file = open(path)?;
    let size = file.metadata().map_err(Error::io(path))?.len();
    limit.check(path, "size", size)?;
    let mut bytes = Vec::with_capacity(size as usize);
    file.take(limit.value().saturating_add(1)).read_to_end(&mut bytes).map_err(Error::io(path))?;
    limit.check(path, "size", bytes.len() as u64)?;
    Ok(bytes)
}

/// Reads a regular text file whole.
///
/// # Errors
/// As [`read()`], and if it is not UTF-8.
pub fn read_text(path: &Path, limit: Limit) -> Result<String> {
    String::from_utf8(read(path, limit)?).map_err(|error| {
        Error::file(path, format!("expected UTF-8 text, got another byte at {}", error.utf8_error().valid_up_to()))
    })
}

/// Folder of a data set. Names that its files contain, and its symbolic links, lead to files inside it alone.
///
/// In a snapshot of the Hugging Face cache, links to the `blobs` of the same repository count as inside.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct InputFolder {
    path: PathBuf,
    inside: PathBuf, // canonical folder that links may lead to
}

impl InputFolder {
    /// Opens a folder.
    ///
    /// # Errors
    /// If there is none.
    pub fn open(path: &Path) -> Result<Self> {
        let real = path.canonicalize().map_err(Error::io(path))?;
        if !real.is_dir() {
            return Err(Error::file(path, "expected a directory"));
        }
        let snapshots = real.parent().filter(|parent| parent.file_name().is_some_and(|name| name == "snapshots"));
        let repository = snapshots.and_then(Path::parent).filter(|repository| repository.join("blobs").is_dir());
        let inside = repository.unwrap_or(&real).to_path_buf();
        Ok(Self { path: path.to_path_buf(), inside })
    }

    /// Path of the folder, as given.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the path of a file or folder below this one, which need not exist.
    ///
    /// # Errors
    /// If the name is absolute or contains `..`, or a symbolic link on the way leads out of the folder.
    pub fn join(&self, name: impl AsRef<Path>) -> Result<PathBuf> {
        let name = name.as_ref();
        if !name.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir)) {
            let message = format!("expected names of files inside this folder, got {}", name.display());
            return Err(Error::file(&self.path, message));
        }
        let path = self.path.join(name);
        self.check(&path)?;
        Ok(path)
    }

    /// Checks that a path found in this folder, for instance by listing it, does not lead out of it.
    ///
    /// # Errors
    /// If it does, through a symbolic link.
    pub fn check(&self, path: &Path) -> Result<()> {
        if FOLLOW_LINKS.load(Ordering::Relaxed) {
            return Ok(());
        }
        match path.canonicalize() {
            Ok(real) if !real.starts_with(&self.inside) => Err(Error::file(
                path,
                format!(
                    "is a link to {}, outside of {}; --follow-links permits it",
                    real.display(),
                    self.path.display()
                ),
            )),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;
    use std::os::unix::net::UnixListener;

    use super::super::limits;
    use super::*;

    #[test]
    fn only_regular_files_are_opened() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("socket");
        let _listener = UnixListener::bind(&socket).unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let link = folder.path().join("link");
        symlink(&pipe, &link).unwrap();
        for (path, got) in
            [(folder.path(), "a directory"), (&pipe, "a pipe"), (&link, "a pipe"), (Path::new("/dev/zero"), "a device")]
        {
            let error = open(path).unwrap_err().to_string();
            assert!(error.ends_with(&format!("expected a regular file, got {got}")), "{error}");
        }
        assert!(open(&socket).is_err());
        std::fs::write(folder.path().join("file"), b"content").unwrap();
        assert_eq!(read(&folder.path().join("file"), limits::TEXT).unwrap(), b"content");
    }

    #[test]
    fn a_file_above_its_limit_is_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sparse");
        File::create(&path).unwrap().set_len(limits::TEXT.default + 1).unwrap();
        let error = read(&path, limits::TEXT).unwrap_err().to_string();
        assert!(error.contains("size: expected at most 67108864 bytes"), "{error}");
    }

    #[test]
    fn names_and_links_stay_inside_the_folder() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("set");
        std::fs::create_dir_all(root.join("data")).unwrap();
        std::fs::write(root.join("data/a"), b"a").unwrap();
        std::fs::write(folder.path().join("secret"), b"s").unwrap();
        symlink("data/a", root.join("inside")).unwrap();
        symlink("../secret", root.join("outside")).unwrap();
        symlink("..", root.join("up")).unwrap();
        let set = InputFolder::open(&root).unwrap();
        for name in ["data/a", "./data/a", "inside", "absent/file"] {
            assert_eq!(set.join(name).unwrap(), root.join(name));
        }
        for name in ["outside", "up/secret", "../secret", "/etc/passwd", "data/../../secret"] {
            assert!(set.join(name).is_err(), "{name}");
        }
    }

    #[test]
    fn a_hugging_face_snapshot_may_link_to_its_blobs() {
        let folder = tempfile::tempdir().unwrap();
        let snapshot = folder.path().join("datasets--a--b/snapshots/0f");
        std::fs::create_dir_all(&snapshot).unwrap();
        std::fs::create_dir_all(folder.path().join("datasets--a--b/blobs")).unwrap();
        std::fs::write(folder.path().join("datasets--a--b/blobs/9c"), b"x").unwrap();
        std::fs::write(folder.path().join("other"), b"x").unwrap();
        symlink("../../blobs/9c", snapshot.join("info.json")).unwrap();
        symlink("../../../other", snapshot.join("other")).unwrap();
        let set = InputFolder::open(&snapshot).unwrap();
        assert!(set.join("info.json").is_ok() && set.join("other").is_err());
    }
}
