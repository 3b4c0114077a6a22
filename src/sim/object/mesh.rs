//! Objects from OBJ and STL files, decomposed into convex pieces by parry's VHACD.

use std::io::Cursor;
use std::path::Path;

use glam::{DQuat, DVec3, Vec3};
use parry3d::math::Vector;
use parry3d::shape::SharedShape;
use parry3d::transformation::vhacd::VHACDParameters;

use super::assembly::{Object, TriangleMesh};
use super::piece::{Piece, PieceShape};
use crate::error::{Error, Result};
use crate::file::mesh::Mesh;
use crate::file::{self, input, limits};
use crate::mujoco::audit;
use crate::sim::convex::{self, double, single};
use crate::sim::scene::{Scene, ShapeSpec};
use crate::trial::Trial;

/// Largest number of triangles of a mesh file: finer meshes are made for display, not for contact.
const MAX_TRIANGLES: usize = 200_000;

/// Creates an object from a mesh file; the centre of the bounding box becomes its origin.
///
/// # Errors
/// If the file cannot be read, holds no surface, or spans no volume; the error names the file.
pub(super) fn mesh(path: &Path, scale: f64) -> Result<Object> {
    Trial::Mesh { file: path.to_path_buf(), scale }.run()?;
    let (mut vertices, triangles) = load(path)?;
    let [low, high] = corners(&vertices);
    let middle = 0.5 * (low + high);
    vertices.iter_mut().for_each(|vertex| *vertex = scale * (*vertex - middle));
    Object::from_surface(path, vertices, triangles, 0.5 * scale * (high - low).z)
}

/// Returns the lowest and the highest coordinates of points.
fn corners(vertices: &[DVec3]) -> [DVec3; 2] {
    let low = vertices.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    [low, vertices.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max)]
}

impl Object {
    /// Creates an object from a mesh that came from outside, in its own frame, m, whose lowest point is `height` below its origin, m.
    ///
    /// The decomposition is tried in a child process first.
    ///
    /// # Errors
    /// If the mesh spans no volume, has an implausible size, or exceeds a limit; the error names the mesh by `name`.
    pub(crate) fn from_foreign_mesh(name: &str, mesh: &Mesh, height: f64) -> Result<Self> {
        let folder = tempfile::tempdir().map_err(Error::io(std::env::temp_dir()))?;
        let file = folder.path().join("object.obj");
        file::write(&file, file::mesh::to_obj(mesh).as_bytes())?;
        // The file is a copy, whose path tells nobody anything.
        let place = format!("{}: ", file.display());
        let named = |error: Error| Error::file(name, error.to_string().replacen(&place, "", 1));
        Trial::Mesh { file, scale: 1.0 }.run().map_err(named)?;
        let vertices = mesh.0.iter().copied().map(Vec3::as_dvec3).collect();
        Self::from_surface(Path::new(name), vertices, mesh.1.clone(), height)
    }

    /// Creates an object from vertices in its own frame, m, and triangles, whose lowest point is `height` below its origin, m.
    ///
    /// # Errors
    /// If they span no volume, or have an implausible size; the error names `source`.
    fn from_surface(source: &Path, vertices: Vec<DVec3>, triangles: Vec<[u32; 3]>, height: f64) -> Result<Self> {
        let [low, high] = corners(&vertices);
        let size = high - low;
        if size.min_element() < 1e-4 || size.max_element() > 20.0 {
            let got = format!("{:.2e} x {:.2e} x {:.2e} m", size.x, size.y, size.z);
            let expected = "expected 0.1 mm to 20 m along each axis";
            return Err(Error::file(source, format!("{expected}, got {got}; check the scale")));
        }
        let flat = || Error::file(source, "expected a surface that spans a volume, got a flat one");
        let outline = convex::hull(&vertices).ok_or_else(flat)?;
        let pieces = decompose(&vertices, &triangles, &outline).ok_or_else(flat)?;
        Ok(Self { visual: Some((vertices, triangles)), ..Self::free(pieces, height, outline) })
    }
}

/// Creates an object from a mesh file and drops it.
///
/// # Errors
/// As for an object of a scene.
#[doc(hidden)]
pub fn try_mesh(path: &Path, scale: f64) -> Result<()> {
    mesh(path, scale).map(drop)
}

/// Checks the mesh files of a scene's objects; returns a line per file with faults: a surface that is open, or inside
/// out.
///
/// Such a surface is still decomposed into convex pieces, which may differ from the shape that its author sees.
///
/// # Errors
/// If a file cannot be read or holds no surface.
pub fn mesh_faults(scene: &Scene) -> Result<Vec<String>> {
    let mut lines = Vec::new();
    for object in &scene.spec.objects {
        let ShapeSpec::Mesh { file, scale } = &object.shape else { continue };
        Trial::Mesh { file: file.clone(), scale: scale.low() }.run()?;
        let (vertices, triangles) = load(file)?;
        let vertices: Vec<Vec3> = vertices.iter().map(|vertex| (scale.low() * *vertex).as_vec3()).collect();
        let faults: Vec<String> = audit::mesh_faults(&vertices, &triangles).iter().map(ToString::to_string).collect();
        if !faults.is_empty() {
            lines.push(format!("{}: the mesh {}", file.display(), faults.join(", ")));
        }
    }
    Ok(lines)
}

/// Reads vertices and triangles of an OBJ or STL file.
///
/// # Errors
/// If the file has another extension, cannot be read, holds no triangles, or holds a number that is not finite.
pub(crate) fn load(path: &Path) -> Result<TriangleMesh> {
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let text = || input::read(path, limits::TEXT);
    let (vertices, triangles): TriangleMesh = match ending.as_str() {
        "obj" => obj(path, &text()?)?,
        "stl" => stl(path, &text()?)?,
        _ => return Err(Error::file(path, format!("expected a mesh ending in .obj or .stl, got {ending:?}"))),
    };
    if !(4..=MAX_TRIANGLES).contains(&triangles.len()) {
        let expected = format!("expected 4 to {MAX_TRIANGLES} triangles, got {}", triangles.len());
        return Err(Error::file(path, expected));
    }
    if let Some(bad) = vertices.iter().position(|vertex| !vertex.is_finite()) {
        return Err(Error::file(path, format!("vertex {bad}: expected finite numbers, got {}", vertices[bad])));
    }
    let count = vertices.len();
    if let Some(bad) = triangles.iter().flatten().find(|index| **index as usize >= count) {
        return Err(Error::file(path, format!("expected indices of {count} vertices, got {bad}")));
    }
    Ok((vertices, triangles))
}

fn obj(path: &Path, text: &[u8]) -> Result<TriangleMesh> {
    let (vertices, triangles) = file::mesh::obj(path, text)?;
    Ok((vertices.into_iter().map(Vec3::as_dvec3).collect(), triangles))
}

fn stl(path: &Path, bytes: &[u8]) -> Result<TriangleMesh> {
    check_stl_count(path, bytes)?;
    let mesh = stl_io::read_stl(&mut Cursor::new(bytes)).map_err(|e| Error::file(path, e))?;
    let vertices = mesh.vertices.iter().map(|v| DVec3::new(v[0].into(), v[1].into(), v[2].into())).collect();
    Ok((vertices, mesh.faces.iter().map(|face| face.vertices.map(|index| index as u32)).collect()))
}

/// Checks the number of triangles in the header of a binary STL file against the bytes that follow.
fn check_stl_count(path: &Path, bytes: &[u8]) -> Result<()> {
    /// Bytes before the number.
    const HEADER: usize = 80;
    /// Bytes of each triangle.
    const TRIANGLE: usize = 50;
    if bytes.starts_with(b"solid ") {
        return Ok(());
    }
    let Some((count, triangles)) = bytes.get(HEADER..).and_then(|rest| rest.split_first_chunk()) else {
        let expected = format!("expected an STL file with a header of {HEADER} bytes, got {} bytes", bytes.len());
        return Err(Error::file(path, expected));
    };
    let (count, there) = (u32::from_le_bytes(*count) as usize, triangles.len() / TRIANGLE);
    match count <= there {
        true => Ok(()),
        false => {
            Err(Error::file(path, format!("expected {count} triangles, as its header says, got bytes of {there}")))
        }
    }
}

/// Decomposes a surface into convex pieces; a convex surface is its outline. `None` if no piece spans a volume.
fn decompose(vertices: &[DVec3], triangles: &[[u32; 3]], outline: &SharedShape) -> Option<Vec<Piece>> {
    let points: Vec<Vector> = vertices.iter().copied().map(single).collect();
    let hull_volume = f64::from(outline.mass_properties(1.0).mass());
    let convex = hull_volume > 0.0 && volume(vertices, triangles) > 0.98 * hull_volume;
    let hulls: Vec<SharedShape> = if convex {
        vec![outline.clone()]
    } else {
        let parameters = VHACDParameters { resolution: 64, concavity: 0.005, ..VHACDParameters::default() };
        let compound = SharedShape::convex_decomposition_with_params(&points, triangles, &parameters);
        compound.as_compound()?.shapes().iter().map(|(_, shape)| shape.clone()).collect()
    };
    let piece = |shape: &SharedShape| {
        let corners = shape.as_convex_polyhedron()?.points().iter().copied().map(double).collect();
        // Pieces that span no volume are left out.
        Piece::new(PieceShape::Hull(corners), DVec3::ZERO, DQuat::IDENTITY, false).ok()
    };
    let pieces: Vec<Piece> = hulls.iter().filter_map(piece).collect();
    (!pieces.is_empty()).then_some(pieces)
}

/// Returns the volume inside a closed surface, m³, for either orientation of its triangles.
fn volume(vertices: &[DVec3], triangles: &[[u32; 3]]) -> f64 {
    let of = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|index| vertices[index as usize]);
        a.dot(b.cross(c)) / 6.0
    };
    triangles.iter().map(of).sum::<f64>().abs()
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::io::Write;

    use super::*;

    /// Returns an L of three cubes with 20 mm edges.
    fn corner_obj() -> String {
        let outline = [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]];
        let mut text = String::new();
        for z in [0, 1] {
            for [x, y] in outline {
                text += &format!("v {} {} {}\n", 20 * x, 20 * y, 20 * z);
            }
        }
        // Bottom and top (a fan from the inner corner covers the L), then sides.
        for [a, b] in [[4, 5], [5, 6], [6, 1], [1, 2], [2, 3]] {
            text += &format!("f 4 {b} {a}\n");
            text += &format!("f 10 {} {}\n", a + 6, b + 6);
        }
        for a in 1..=6 {
            let b = a % 6 + 1;
            text += &format!("f {a} {b} {} {}\n", b + 6, a + 6);
        }
        text
    }

    /// Returns the sum of the pieces' volumes, m³.
    fn volume_of(object: &Object) -> f64 {
        object.pieces.iter().map(Piece::volume).sum()
    }

    #[test]
    fn concave_mesh_keeps_its_hollow() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("corner.obj");
        std::fs::write(&path, corner_obj()).unwrap();
        let object = mesh(&path, 1e-3).unwrap();
        assert!(object.pieces.len() > 1, "{} pieces", object.pieces.len());
        assert!((object.half_height - 0.01).abs() < 1e-9);
        // The origin, the centre of the bounding box, lies on the L's inner corner.
        assert!(object.distance(DVec3::new(0.01, 0.01, 0.0)) > 0.008, "the hollow is filled");
        assert!(object.distance(DVec3::new(-0.01, -0.01, 0.0)) < -0.005, "the corner is empty");
        let full = 3.0 * 0.02f64.powi(3);
        assert!((volume_of(&object) / full - 1.0).abs() < 0.1, "{} of {full} m3", volume_of(&object));
    }

    #[test]
    fn convex_stl_becomes_one_piece() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("wedge.stl");
        let corners = [[0.0f32, 0.0, 0.0], [30.0, 0.0, 0.0], [0.0, 20.0, 0.0], [0.0, 0.0, 40.0]];
        let mut file = File::create(&path).unwrap();
        writeln!(file, "solid wedge").unwrap();
        for face in [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]] {
            writeln!(file, "facet normal 0 0 0\nouter loop").unwrap();
            for [x, y, z] in face.map(|i: usize| corners[i]) {
                writeln!(file, "vertex {x} {y} {z}").unwrap();
            }
            writeln!(file, "endloop\nendfacet").unwrap();
        }
        writeln!(file, "endsolid wedge").unwrap();
        drop(file);
        let object = mesh(&path, 1e-3).unwrap();
        assert_eq!(object.pieces.len(), 1);
        assert!((volume_of(&object) - 30.0 * 20.0 * 40.0 / 6.0 * 1e-9).abs() < 1e-9, "{}", volume_of(&object));
    }

    #[test]
    fn mesh_from_outside_is_cut_or_refused_by_its_name() {
        let (vertices, triangles) = file::mesh::obj(Path::new("corner.obj"), corner_obj().as_bytes()).unwrap();
        let scaled = |scale: f32| vertices.iter().map(|vertex| scale * *vertex).collect::<Vec<_>>();
        let object = Object::from_foreign_mesh("mesh of a corner", &(scaled(1e-3), triangles.clone()), 0.0).unwrap();
        assert!(object.pieces.len() > 1, "{} pieces", object.pieces.len());
        let flat = scaled(1e-3).into_iter().map(|vertex| vertex.with_z(0.0)).collect();
        for vertices in [flat, scaled(1.0)] {
            let error = Object::from_foreign_mesh("mesh of a corner", &(vertices, triangles.clone()), 0.0);
            let error = error.expect_err("a flat or huge mesh is refused").to_string();
            assert!(error.starts_with("mesh of a corner: expected"), "{error}");
        }
    }

    #[test]
    fn error_names_the_file_that_is_no_mesh() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            let error = mesh(&path, 1.0).unwrap_err().to_string();
            assert!(error.contains(name), "{error}");
            error
        };
        assert!(refused("a.ply", "ply").contains(".obj or .stl"));
        assert!(refused("b.obj", "v 0 0 0\n").contains("triangles"));
        assert!(refused("c.obj", &corner_obj()).contains("scale"));
        refused("d.stl", "nothing");
        assert!(mesh(&folder.path().join("e.obj"), 1.0).unwrap_err().to_string().contains("e.obj"));
    }
}
