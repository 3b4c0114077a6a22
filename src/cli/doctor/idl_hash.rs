//! Hash of a message layout; the build script includes this file too.

use std::io::Result;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

/// Returns the installed `.idl` files below `share` (`<prefix>/share/egotac_msgs`), sorted by path.
///
/// # Errors
/// If a directory can't be read.
pub fn idl_files(share: &Path) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for folder in ["action", "msg", "srv"] {
        let Ok(entries) = share.join(folder).read_dir() else { continue };
        for entry in entries {
            files.push(entry?.path());
        }
    }
    files.retain(|path| path.extension().is_some_and(|extension| extension == "idl"));
    files.sort();
    Ok(files)
}

/// Computes the first 16 digits of the SHA-256 of the output of `sha256sum` for these files. `scripts/lib/common.sh`
/// and `launch/cargo.cmake` compute the same hash.
///
/// # Errors
/// If a file can't be read.
pub fn idl_hash(share: &Path, files: &[PathBuf]) -> Result<String> {
    let mut sums = Sha256::new();
    for path in files {
        let name = path.strip_prefix(share).unwrap_or(path);
        sums.update(format!("{:x}  ./{}\n", Sha256::digest(std::fs::read(path)?), name.display()));
    }
    let mut digest = format!("{:x}", sums.finalize());
    digest.truncate(16);
    Ok(digest)
}
