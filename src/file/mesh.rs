//! Triangle meshes in OBJ, PLY and GLB files.

mod glb;
mod ply;

use std::path::Path;

use glam::Vec3;

use super::{input, limits};
use crate::error::{Error, Result};

/// Vertices in the unit of the file, and triangles, counter-clockwise seen from outside.
pub type Mesh = (Vec<Vec3>, Vec<[u32; 3]>);

/// Reads the mesh at `path`; the extension tells the format.
///
/// # Errors
/// If the extension is another one, the file is damaged, or it holds no triangle or a number that is not finite.
pub fn read(path: &Path) -> Result<Mesh> {
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let (vertices, triangles) = match ending.as_str() {
        "obj" => obj(path, &input::read(path, limits::FILE)?)?,
        "ply" => ply::read(&input::read(path, limits::FILE)?).map_err(|message| Error::file(path, message))?,
        "glb" => glb::read(&input::read(path, limits::FILE)?).map_err(|message| Error::file(path, message))?,
        _ => return Err(Error::file(path, format!("expected a mesh ending in .obj, .ply or .glb, got {ending:?}"))),
    };
    checked(path, (vertices, triangles))
}

/// Checks a mesh that was read from `path`.
///
/// # Errors
/// If it holds no triangle, a number that is not finite, or an index without a vertex.
pub fn checked(path: &Path, (vertices, triangles): Mesh) -> Result<Mesh> {
    if triangles.is_empty() {
        return Err(Error::file(path, "expected a mesh with triangles, got none"));
    }
    if let Some(bad) = vertices.iter().position(|vertex| !vertex.is_finite()) {
        return Err(Error::file(path, format!("vertex {bad}: expected finite numbers, got {}", vertices[bad])));
    }
    let count = vertices.len();
    match triangles.iter().flatten().find(|index| **index as usize >= count) {
        Some(bad) => Err(Error::file(path, format!("expected indices of {count} vertices, got {bad}"))),
        None => Ok((vertices, triangles)),
    }
}

/// Formats a mesh as an OBJ file.
pub fn to_obj((vertices, triangles): &Mesh) -> String {
    let vertices = vertices.iter().map(|vertex| format!("v {} {} {}\n", vertex.x, vertex.y, vertex.z));
    let triangles = triangles.iter().map(|[a, b, c]| format!("f {} {} {}\n", a + 1, b + 1, c + 1));
    vertices.chain(triangles).collect()
}

/// Reads the content of an OBJ file; polygons become triangles, and materials are ignored.
///
/// # Errors
/// If it is damaged.
pub fn obj(path: &Path, mut text: &[u8]) -> Result<Mesh> {
    let options =
        tobj::LoadOptions { triangulate: true, ignore_lines: true, ignore_points: true, ..Default::default() };
    // Materials are ignored: a file that names missing ones still loads.
    let (models, _) =
        tobj::load_obj_buf(&mut text, &options, |_| Ok(Default::default())).map_err(|e| Error::file(path, e))?;
    let mut mesh = Mesh::default();
    for model in models {
        let first = mesh.0.len() as u32;
        mesh.0.extend(model.mesh.positions.chunks_exact(3).map(Vec3::from_slice));
        mesh.1.extend(model.mesh.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]].map(|index| first + index)));
    }
    Ok(mesh)
}
