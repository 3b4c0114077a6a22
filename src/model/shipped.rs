//! Where the checkpoint that comes with egotac lies: installed beside the programs, or in the source tree.

use std::path::{Path, PathBuf};

use crate::error::{Error, Result};

/// Its path in the source tree, which is also its path in `share/egotac` of an installation.
const NAME: &str = "models/egotac.safetensors";

/// The checkpoint that comes with egotac.
///
/// # Errors
/// If there is none; the error names the places.
pub fn path() -> Result<PathBuf> {
    let places: Vec<PathBuf> = folders().iter().map(|folder| folder.join(NAME)).collect();
    let found = places.iter().find(|path| path.is_file()).cloned();
    found.ok_or_else(|| {
        let looked: Vec<_> = places.iter().map(|path| path.display().to_string()).collect();
        Error::value("checkpoint", format!("the one that comes with egotac, in {}", looked.join(" or ")), "none there")
    })
}

fn folders() -> Vec<PathBuf> {
    // <prefix>/lib/egotac/<program> has its files in <prefix>/share/egotac.
    let program = std::env::current_exe().ok();
    let installed = program.as_deref().and_then(|program| program.ancestors().nth(3)).map(|p| p.join("share/egotac"));
    installed.into_iter().chain([Path::new(env!("CARGO_MANIFEST_DIR")).to_path_buf()]).collect()
}
