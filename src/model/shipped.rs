//! Path of the checkpoint that is shipped with egotac: installed beside the programs, or in the source tree.

use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::host;

/// Path below the root of the source tree, and below `share/egotac` of an installation.
const NAME: &str = "models/egotac.safetensors";

/// Returns the path of the shipped checkpoint.
///
/// # Errors
/// If no such file exists; names the places.
pub fn path() -> Result<PathBuf> {
    let places: Vec<PathBuf> = folders().iter().map(|folder| folder.join(NAME)).collect();
    let found = places.iter().find(|path| path.is_file()).cloned();
    found.ok_or_else(|| {
        let looked: Vec<_> = places.iter().map(|path| path.display().to_string()).collect();
        Error::value("checkpoint", format!("the one that comes with egotac, in {}", looked.join(" or ")), "none there")
    })
}

/// Returns the folders that may hold shipped files: of a host program, of the installation, and the source tree.
pub(crate) fn folders() -> Vec<PathBuf> {
    // <prefix>/lib/egotac/<program> has its files in <prefix>/share/egotac.
    let program = std::env::current_exe().ok();
    let installed = program.as_deref().and_then(|program| program.ancestors().nth(3)).map(|p| p.join("share/egotac"));
    host::share()
        .map(Path::to_path_buf)
        .into_iter()
        .chain(installed)
        .chain([Path::new(env!("CARGO_MANIFEST_DIR")).to_path_buf()])
        .collect()
}
