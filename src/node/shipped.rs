//! Where the files that come with egotac lie: installed beside the programs, or in the source tree.

use std::path::{Path, PathBuf};

use anyhow::bail;

/// The checkpoint that comes with egotac.
///
/// # Errors
/// If there is none; the error names the places.
pub fn model() -> anyhow::Result<PathBuf> {
    find("models/egotac.safetensors")
}

/// Finds a file by its path in the source tree, which is also its path in `share/egotac`.
fn find(name: &str) -> anyhow::Result<PathBuf> {
    let places = places();
    let found = places.iter().map(|place| place.join(name)).find(|path| path.is_file());
    match found {
        Some(path) => Ok(path),
        None => {
            let places: Vec<_> = places.iter().map(|place| place.display().to_string()).collect();
            bail!("there is no {name} in {}; give another with -p model:=PATH", places.join(" or "))
        }
    }
}

fn places() -> Vec<PathBuf> {
    // <prefix>/lib/egotac/<program> has its files in <prefix>/share/egotac.
    let installed = std::env::current_exe().ok();
    let installed = installed.as_deref().and_then(|program| program.ancestors().nth(3)).map(|p| p.join("share/egotac"));
    installed.into_iter().chain([Path::new(env!("CARGO_MANIFEST_DIR")).to_path_buf()]).collect()
}
