//! Preparation of URDF files for MuJoCo.
//!
//! MuJoCo reads URDF, but merges links that do not move into their parents (fingertips often are such links), knows no
//! `package://`, DAE or glTF, and refuses a file if one mesh is missing. Preparation keeps the links, makes the paths of
//! meshes absolute, and removes and reports shapes that can't be loaded.

use std::ops::Range;
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::file::{input, limits};

/// URDF that MuJoCo reads.
#[derive(Debug, Clone, PartialEq)]
pub struct Prepared {
    /// Content.
    pub xml: String,
    /// Mesh files of the shapes that were removed, as the URDF names them.
    pub missing_meshes: Vec<String>,
}

/// Greatest number of XML nodes of a URDF; a humanoid has some ten thousand.
const MAX_NODES: u32 = 1_000_000;
/// Compiler options: keep fixed links, and substitute missing masses, which retargeting does not use.
const COMPILER: &str = "<mujoco><compiler fusestatic=\"false\" discardvisual=\"true\" strippath=\"false\" \
    balanceinertia=\"true\" boundmass=\"1e-5\" boundinertia=\"1e-9\"/></mujoco>";

/// Prepares a URDF file.
///
/// # Errors
/// If it can't be read or is no URDF.
pub fn prepare(path: &Path) -> Result<Prepared> {
    let text = input::read_text(path, limits::TEXT)?;
    let wrong = |message: String| Error::file(path, message);
    // An entity of a few bytes may stand for a text of any length.
    if text.contains("<!ENTITY") {
        return Err(wrong(
            "expected a URDF that declares no entities, got <!ENTITY; write their text in their places".into(),
        ));
    }
    let options = roxmltree::ParsingOptions { allow_dtd: true, nodes_limit: MAX_NODES, ..Default::default() };
    let document = roxmltree::Document::parse_with_options(&text, options)
        .map_err(|error| wrong(format!("expected XML of at most {MAX_NODES} nodes: {error}")))?;
    let robot = document.root_element();
    if !robot.has_tag_name("robot") {
        return Err(wrong(format!("expected a URDF, whose root is <robot>, got <{}>", robot.tag_name().name())));
    }
    let folder = path.parent().unwrap_or(Path::new("."));
    let mut edits: Vec<(Range<usize>, String)> = Vec::new();
    let mut missing_meshes = Vec::new();
    for node in robot.descendants().filter(roxmltree::Node::is_element) {
        match node.tag_name().name() {
            // Ours replaces it: MuJoCo accepts one block.
            "mujoco" => edits.push((node.range(), String::new())),
            "visual" => edits.push((node.range(), String::new())),
            "collision" => {
                let mesh = node.descendants().find(|node| node.has_tag_name("mesh"));
                let Some(attribute) = mesh.and_then(|mesh| mesh.attribute_node("filename")) else { continue };
                match find_mesh(folder, attribute.value()) {
                    Some(found) => edits.push((attribute.range_value(), escaped(&found))),
                    None => {
                        missing_meshes.push(attribute.value().to_owned());
                        edits.push((node.range(), String::new()));
                    }
                }
            }
            _ => {}
        }
    }
    let start = robot.range().start;
    let opening = start + text[start..].find('>').unwrap_or(0) + 1;
    edits.push((opening..opening, COMPILER.to_owned()));
    edits.sort_by_key(|(range, _)| range.start);
    let mut xml = String::with_capacity(text.len() + COMPILER.len());
    let mut at = 0;
    for (range, with) in edits {
        // Inside an element that was removed.
        if range.start < at {
            continue;
        }
        xml += &text[at..range.start];
        xml += &with;
        at = range.end;
    }
    xml += &text[at..];
    Ok(Prepared { xml, missing_meshes })
}

/// Returns the file of a mesh, if it exists and MuJoCo reads its format.
fn find_mesh(folder: &Path, name: &str) -> Option<PathBuf> {
    let extension = Path::new(name).extension()?.to_str()?.to_lowercase();
    if !["stl", "obj", "msh"].contains(&extension.as_str()) {
        return None;
    }
    let is_url = name.contains("://");
    let plain = name.strip_prefix("file://").unwrap_or(name);
    let plain = plain.strip_prefix("package://").unwrap_or(plain);
    let here = |base: &Path, path: &str| std::path::absolute(base.join(path)).ok().filter(|found| found.is_file());
    if !is_url || name.starts_with("file://") {
        return here(folder, plain);
    }
    // package://name/path: the package is this folder, one above it, or a sibling of one of these.
    let inside = plain.split_once('/').map_or(plain, |(_, inside)| inside);
    folder.ancestors().take(6).find_map(|base| here(base, plain).or_else(|| here(base, inside)))
}

/// Escapes a path for an XML attribute.
fn escaped(path: &Path) -> String {
    path.to_string_lossy().replace('&', "&amp;").replace('"', "&quot;").replace('<', "&lt;")
}

/// Names the mesh files that a model lacks beside the error that follows from their absence.
pub fn without_meshes(origin: &str, missing: &[String], error: Error) -> Error {
    /// Number of files that are named; the rest is counted.
    const MAX_NAMED: usize = 3;
    if missing.is_empty() {
        return error;
    }
    let named = missing.iter().take(MAX_NAMED).map(String::as_str).collect::<Vec<_>>().join(", ");
    let more = match missing.len().saturating_sub(MAX_NAMED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    let message = format!(
        "expected the mesh files that it names, found no OBJ or STL file for {named}{more}; without them: {error}"
    );
    Error::file(origin, message)
}
