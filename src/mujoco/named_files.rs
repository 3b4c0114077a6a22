//! Files that a model names: regular files only, because the engine would wait for the other end of a pipe.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use roxmltree::{Document, Node, ParsingOptions};

use crate::error::Result;
use crate::file::{input, limits};

/// Attributes of a `compiler` that name a folder of assets.
const FOLDERS: [&str; 3] = ["assetdir", "meshdir", "texturedir"];
/// Greatest number of XML files that a model includes and attaches.
const MAX_INCLUDED: usize = 1000;

/// Checks that all files that exist under a name of the model, or of a model that it includes, are regular files.
///
/// The engine reports files that do not exist and text that is no XML.
///
/// # Errors
/// If the model can't be read, or it names a pipe, device or socket.
pub fn check_named_files(model: &Path) -> Result<()> {
    let base = model.parent().unwrap_or(Path::new(""));
    let mut seen = BTreeSet::new();
    let mut queue = vec![model.to_path_buf()];
    while let Some(path) = queue.pop() {
        if seen.len() >= MAX_INCLUDED || !seen.insert(path.clone()) {
            continue;
        }
        let text = input::read(&path, limits::TEXT)?;
        let Ok(text) = std::str::from_utf8(&text) else { continue };
        let Ok(document) = Document::parse_with_options(text, ParsingOptions::default()) else { continue };
        let elements = || document.descendants().filter(Node::is_element);
        let own = path.parent().unwrap_or(Path::new(""));
        let named = elements().filter(|node| node.has_tag_name("compiler"));
        let named = named.flat_map(|node| FOLDERS.iter().filter_map(move |name| node.attribute(*name)));
        let folders: BTreeSet<PathBuf> = [base.to_path_buf(), own.to_path_buf()]
            .into_iter()
            .chain(named.flat_map(|name| [base.join(name), own.join(name)]))
            .collect();
        for node in elements() {
            let files = node.attributes().filter(|attribute| attribute.name().starts_with("file"));
            for file in files.flat_map(|file| folders.iter().map(move |folder| folder.join(file.value()))) {
                if file.exists() && !file.is_dir() {
                    input::open(&file)?;
                }
                if file.is_file() && ["include", "model"].iter().any(|name| node.has_tag_name(*name)) {
                    queue.push(file);
                }
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pipe_among_the_files_of_an_included_model_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("a.xml"), "<mujoco><include file=\"b.xml\"/></mujoco>").unwrap();
        let part = "<mujoco><compiler meshdir=\"assets\"/><asset><mesh file=\"m.stl\"/></asset></mujoco>";
        std::fs::write(at("b.xml"), part).unwrap();
        std::fs::create_dir(at("assets")).unwrap();
        assert!(check_named_files(&at("a.xml")).is_ok());
        assert!(std::process::Command::new("mkfifo").arg(at("assets/m.stl")).status().unwrap().success());
        let error = check_named_files(&at("a.xml")).unwrap_err().to_string();
        assert!(error.contains("m.stl") && error.contains("got a pipe"), "{error}");
    }
}
