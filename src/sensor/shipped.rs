//! Maps that come with egotac: installed beside the programs, or in the source tree.

use std::path::{Path, PathBuf};

use super::map::TaxelMap;
use crate::error::{Error, Result};
use crate::model::shipped;

/// Folder below the root of the source tree, and below `share/egotac` of an installation.
const FOLDER: &str = "sensors";

/// Names of the maps that come with egotac.
pub fn names() -> Vec<String> {
    let files = folder().and_then(|folder| std::fs::read_dir(folder).ok()).into_iter().flatten().flatten();
    let yaml = |path: PathBuf| path.extension().is_some_and(|e| e == "yaml").then_some(path);
    let mut names: Vec<String> =
        files.filter_map(|entry| Some(yaml(entry.path())?.file_stem()?.to_string_lossy().into_owned())).collect();
    names.sort();
    names
}

/// Reads a map by the name of a shipped one, or by the path of its YAML file.
///
/// # Errors
/// If there is no such map, or it can't be read.
pub fn open(name: &str) -> Result<TaxelMap> {
    TaxelMap::read(&path(name)?)
}

/// Returns the path of a map.
///
/// # Errors
/// If it is neither a file nor a shipped map; the error lists the names.
pub fn path(name: &str) -> Result<PathBuf> {
    if Path::new(name).is_file() {
        return Ok(name.into());
    }
    if names().iter().any(|known| known == name)
        && let Some(folder) = folder()
    {
        return Ok(folder.join(format!("{name}.yaml")));
    }
    Err(Error::unknown("taxel map (name or YAML file)", name, names().iter().map(String::as_str)))
}

fn folder() -> Option<PathBuf> {
    shipped::folders().into_iter().map(|folder| folder.join(FOLDER)).find(|folder| folder.is_dir())
}
