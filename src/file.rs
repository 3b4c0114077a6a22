//! Files that are there whole or not at all.

use std::fs::{File, TryLockError};
use std::io::{Cursor, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::Duration;

use ::image::{ImageFormat, RgbImage};
use sha2::{Digest, Sha256};

use crate::error::{Error, Result};

/// Writes a file under another name beside it, then renames it: a reader sees all of it, or what was there before.
/// Folders that lack are made, links are followed; what is no file, such as `/dev/stdout`, is written to as it is.
///
/// # Errors
/// If the path names no file, or writing fails.
pub fn write(path: &Path, content: &[u8]) -> Result<()> {
    if path.file_name().is_none() {
        return Err(Error::file(path, "is not a name for a file"));
    }
    let real = path.canonicalize().ok();
    let path = real.as_deref().unwrap_or(path);
    if path.metadata().is_ok_and(|there| !there.is_file() && !there.is_dir()) {
        return std::fs::write(path, content).map_err(Error::io(path));
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(Error::io(folder))?;
    // The library's default is readable by its owner alone; this leaves it to the umask, as for any other file.
    let mode = PermissionsExt::from_mode(0o666);
    let mut file = tempfile::Builder::new().permissions(mode).tempfile_in(folder).map_err(Error::io(folder))?;
    file.write_all(content).map_err(Error::io(path))?;
    file.persist(path).map_err(|error| Error::io(path)(error.error))?;
    Ok(())
}

/// Locks a file against other processes; false = one has it. Where files can't be locked, the user sees to it that nobody else
/// is at work.
///
/// A process that is being started by this one holds all locks of this one for a moment: a lock that is not free is asked for
/// again for a while.
pub fn lock(file: &File) -> bool {
    const TRIES: usize = 20;
    for _ in 0..TRIES {
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => std::thread::sleep(Duration::from_millis(10)),
            Ok(()) | Err(TryLockError::Error(_)) => return true,
        }
    }
    false
}

/// Writes a picture as PNG, as [`write()`] does.
///
/// # Errors
/// As [`write()`].
pub fn write_png(path: &Path, picture: &RgbImage) -> Result<()> {
    let mut png = Cursor::new(Vec::new());
    picture.write_to(&mut png, ImageFormat::Png).map_err(|error| Error::file(path, error))?;
    write(path, &png.into_inner())
}

/// SHA-256 as `sha256sum` prints it: lower-case hexadecimal.
pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_whole_and_leaves_nothing_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/a.txt");
        write(&path, b"long before").unwrap();
        write(&path, b"after").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"after");
        assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    #[test]
    fn a_link_is_followed_and_a_device_stays_one() {
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
    fn a_failed_write_leaves_what_was_there() {
        let folder = tempfile::tempdir().unwrap();
        assert!(write(&folder.path().join(".."), b"x").is_err());
        // A folder has the name.
        std::fs::create_dir(folder.path().join("a")).unwrap();
        std::fs::write(folder.path().join("a/b"), b"kept").unwrap();
        let error = write(&folder.path().join("a"), b"x").unwrap_err().to_string();
        assert!(error.contains("/a"), "{error}");
        assert_eq!(std::fs::read(folder.path().join("a/b")).unwrap(), b"kept");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
