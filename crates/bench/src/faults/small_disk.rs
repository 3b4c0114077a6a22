//! A small disk of its own for an output: a tmpfs, which only root can mount.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use egotac::error::{Error, Result};
use egotac::text::tell;

/// Smallest disk, bytes: a page.
const SMALLEST: u64 = 4096;
/// Size after somebody made room, bytes.
const ROOM: u64 = 1 << 30;

/// A mounted tmpfs; dropping it unmounts it.
#[derive(Debug)]
pub struct SmallDisk(PathBuf);

impl SmallDisk {
    /// True if this process may mount one.
    pub fn is_possible() -> bool {
        let Ok(folder) = tempfile::tempdir() else { return false };
        Self::mount(folder.path(), SMALLEST).is_ok()
    }

    /// Mounts a disk of `size` bytes at the folder `at`.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn mount(at: &Path, size: u64) -> Result<Self> {
        fs::create_dir_all(at).map_err(Error::io(at))?;
        let options = format!("size={}", size.max(SMALLEST));
        system("mount", &["-t", "tmpfs", "-o", &options, "tmpfs"], at)?;
        Ok(Self(at.to_path_buf()))
    }

    /// Makes room, as somebody who deletes other files.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn make_room(&self) -> Result<()> {
        system("mount", &["-o", &format!("remount,size={ROOM}")], &self.0)
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        // A process that still has a file open there keeps the disk until it ends.
        if let Err(error) = system("umount", &["-l"], &self.0) {
            tell(format_args!("{error}"));
        }
    }
}

fn system(program: &str, arguments: &[&str], at: &Path) -> Result<()> {
    let mut command = Command::new(program);
    let output = command.args(arguments).arg(at).stdin(Stdio::null()).output().map_err(Error::io(program))?;
    match output.status.success() {
        true => Ok(()),
        false => Err(Error::file(at, format!("{program}: {}", String::from_utf8_lossy(&output.stderr).trim()))),
    }
}

#[cfg(test)]
mod tests {
    use std::io::ErrorKind;

    use super::*;

    #[test]
    fn a_small_disk_is_full_until_somebody_makes_room() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path().join("disk");
        let Ok(disk) = SmallDisk::mount(&at, 16384) else {
            return assert!(!SmallDisk::is_possible());
        };
        let file = at.join("file");
        let error = fs::write(&file, [0; 32768]).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::StorageFull);
        disk.make_room().unwrap();
        fs::write(&file, [0; 32768]).unwrap();
        drop(disk);
        assert!(!file.exists());
    }
}
