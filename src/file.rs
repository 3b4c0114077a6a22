//! Opening of files from outside, durable file writes, tensor and mesh files, file locks and checksums.

pub mod input;
pub mod limits;
pub mod mesh;
pub mod tensors;
pub(crate) mod turn;

use std::fs::{File, TryLockError};
use std::io::{Cursor, ErrorKind, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::Duration;

use ::image::{ImageFormat, RgbImage};
use sha2::{Digest, Sha256};

use self::turn::turn;
use crate::error::{Error, Result};

/// Name of the file in a temporary folder that the process that writes there keeps locked.
pub const LOCK: &str = "lock";
/// Number of attempts of [`lock`].
const LOCK_ATTEMPTS: usize = 20;
/// Pause between attempts of [`lock`].
const LOCK_PAUSE: Duration = Duration::from_millis(10);

/// Writes a file atomically and durably: to a temporary file in the same directory, which then replaces the target. After a
/// power loss the path holds the old content or the new one, whole.
///
/// Creates missing parent directories and follows symbolic links. Writes directly to a target that is not a regular
/// file, such as `/dev/stdout`.
///
/// # Errors
/// If the path has no file name, or writing fails.
pub fn write(path: &Path, content: &[u8]) -> Result<()> {
    if path.file_name().is_none() {
        return Err(Error::file(path, "expected a path that ends in a file name"));
    }
    let real = path.canonicalize().ok();
    let path = real.as_deref().unwrap_or(path);
    let prefix = partial_prefix(path);
    if path.metadata().is_ok_and(|there| !there.is_file() && !there.is_dir()) {
        return std::fs::write(path, content).map_err(Error::io(path));
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(Error::io(folder))?;
    // Temporary files are readable by their owner alone by default; the umask decides here, as for any other file.
    let mode = PermissionsExt::from_mode(0o666);
    let mut builder = tempfile::Builder::new();
    builder.permissions(mode).prefix(&prefix);
    remove_leftovers(folder, &prefix);
    let mut file = loop {
        let file = builder.tempfile_in(folder).map_err(Error::io(folder))?;
        // Another process that removes leftovers may have taken it before this one locked it.
        if lock(file.as_file()) && file.path().exists() {
            break file;
        }
    };
    file.write_all(content).map_err(Error::io(path))?;
    file.as_file().sync_all().map_err(Error::io(path))?;
    turn();
    file.persist(path).map_err(|error| Error::io(path)(error.error))?;
    sync_folder(folder)
}

/// Renames a file or folder whose content is on disk already, durably.
///
/// # Errors
/// If renaming fails.
pub fn rename(from: &Path, to: &Path) -> Result<()> {
    turn();
    std::fs::rename(from, to).map_err(Error::io(to))?;
    sync_folder(to.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new(".")))
}

/// Writes the names in a folder to disk: a file that was created or renamed there is found after a power loss.
///
/// # Errors
/// If the folder can't be opened or written.
pub fn sync_folder(folder: &Path) -> Result<()> {
    let result = File::open(folder).and_then(|folder| folder.sync_all());
    match result {
        // Some network file systems have no fsync of folders.
        Err(error) if matches!(error.kind(), ErrorKind::InvalidInput | ErrorKind::Unsupported) => Ok(()),
        other => other.map_err(Error::io(folder)),
    }
}

/// Writes all files and names below a folder to disk, so that [`rename()`] may publish it.
///
/// # Errors
/// If a file can't be opened or written.
pub fn sync_tree(folder: &Path) -> Result<()> {
    for entry in std::fs::read_dir(folder).map_err(Error::io(folder))? {
        let entry = entry.map_err(Error::io(folder))?;
        let (path, kind) = (entry.path(), entry.file_type().map_err(Error::io(folder))?);
        if kind.is_dir() {
            sync_tree(&path)?;
        } else if kind.is_file() {
            File::open(&path).and_then(|file| file.sync_all()).map_err(Error::io(&path))?;
        }
    }
    sync_folder(folder)
}

/// Returns the beginning of the names under which the file or folder `path` is written before it gets its name.
pub fn partial_prefix(path: &Path) -> String {
    format!(".{}.partial-", path.file_name().unwrap_or_default().to_string_lossy())
}

/// Removes what killed processes left in `folder` under names that begin with `prefix`: files, and folders with a file
/// [`LOCK`], that no living process has locked. What can't be removed stays; without locks in the file system, everything.
pub fn remove_leftovers(folder: &Path, prefix: &str) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        if !entry.file_name().to_string_lossy().starts_with(prefix) {
            continue;
        }
        let (path, is_folder) = (entry.path(), entry.file_type().is_ok_and(|kind| kind.is_dir()));
        let locked = if is_folder { path.join(LOCK) } else { path.clone() };
        let Ok(held) = input::open(&locked) else { continue };
        if held.try_lock().is_ok() {
            let removed = if is_folder { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) };
            // Ignore a leftover that can't be removed: it belongs to somebody else, or another process was faster.
            let _ = removed;
        }
    }
}

/// Locks a file against other processes. Returns false if another process holds the lock, and true if the file system
/// does not support locks: then the user must prevent concurrent use.
///
/// It retries for 0.2 s, because a child process that is being spawned holds the locks of its parent until `exec`.
pub fn lock(file: &File) -> bool {
    for _ in 0..LOCK_ATTEMPTS {
        turn();
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => turn::pause(LOCK_PAUSE),
            Ok(()) | Err(TryLockError::Error(_)) => return true,
        }
    }
    false
}

/// Writes a picture as PNG, atomically as [`write()`].
///
/// # Errors
/// As [`write()`].
pub fn write_png(path: &Path, picture: &RgbImage) -> Result<()> {
    let mut png = Cursor::new(Vec::new());
    picture.write_to(&mut png, ImageFormat::Png).map_err(|error| Error::file(path, error))?;
    write(path, &png.into_inner())
}

/// Computes the SHA-256 in lower-case hexadecimal, as `sha256sum` prints it.
pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_write_replaces_the_file_and_leaves_no_temporary_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/a.txt");
        write(&path, b"long before").unwrap();
        write(&path, b"after").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"after");
        assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    #[test]
    fn what_a_killed_write_left_is_removed_unless_a_process_holds_it() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in [".a.partial-left", ".a.partial-held", ".b.partial-other"] {
            std::fs::write(at(name), b"part").unwrap();
        }
        for name in [".a.partial-folder", ".a.partial-young"] {
            std::fs::create_dir(at(name)).unwrap();
        }
        std::fs::write(at(".a.partial-folder/lock"), b"").unwrap();
        let held = File::open(at(".a.partial-held")).unwrap();
        assert!(lock(&held));
        write(&at("a"), b"whole").unwrap();
        let mut names: Vec<_> =
            std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        assert_eq!(names, [".a.partial-held", ".a.partial-young", ".b.partial-other", "a"]);
    }

    #[test]
    fn links_are_followed_and_devices_are_written_directly() {
        let folder = tempfile::tempdir().unwrap();
        let [link, target] = ["link", "target"].map(|name| folder.path().join(name));
        std::fs::write(&target, b"before").unwrap();
        std::os::unix::fs::symlink(&target, &link).unwrap();
        write(&link, b"after").unwrap();
        assert!(link.is_symlink());
        assert_eq!(std::fs::read(&target).unwrap(), b"after");
        write(Path::new("/dev/null"), b"gone").unwrap();
        assert!(!Path::new("/dev/null").metadata().unwrap().is_file());
    }

    #[test]
    fn a_failed_write_leaves_existing_files() {
        let folder = tempfile::tempdir().unwrap();
        assert!(write(&folder.path().join(".."), b"x").is_err());
        // The target is a directory.
        std::fs::create_dir(folder.path().join("a")).unwrap();
        std::fs::write(folder.path().join("a/b"), b"kept").unwrap();
        let error = write(&folder.path().join("a"), b"x").unwrap_err().to_string();
        assert!(error.contains("/a"), "{error}");
        assert_eq!(std::fs::read(folder.path().join("a/b")).unwrap(), b"kept");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
