//! Triangle-mesh geometry of a hand: normals, vertex areas, edges.

use std::collections::BTreeMap;

use glam::Vec3;

/// Computes area-weighted unit normals per vertex, pointing outwards.
///
/// The normal of a vertex without area (no face, or only degenerate ones) is zero.
pub fn vertex_normals(vertices: &[Vec3], faces: &[[u32; 3]]) -> Vec<Vec3> {
    let mut normals = vec![Vec3::ZERO; vertices.len()];
    for face in faces {
        let cross = face_cross(vertices, face);
        for &vertex in face {
            normals[vertex as usize] += cross;
        }
    }
    normals.iter().map(|n| n.normalize_or_zero()).collect()
}

/// Computes the area per vertex, m²: a third of each adjacent triangle, so that the sum is the surface's area.
pub fn vertex_areas(vertices: &[Vec3], faces: &[[u32; 3]]) -> Vec<f32> {
    let mut areas = vec![0.0; vertices.len()];
    for face in faces {
        let third = face_cross(vertices, face).length() / 6.0;
        for &vertex in face {
            areas[vertex as usize] += third;
        }
    }
    areas
}

/// Returns every undirected edge, lower index first, with its number of faces (2 on a closed surface).
pub fn edges(faces: &[[u32; 3]]) -> BTreeMap<(u32, u32), u32> {
    let mut edges = BTreeMap::new();
    for &[a, b, c] in faces {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            *edges.entry((from.min(to), from.max(to))).or_insert(0) += 1;
        }
    }
    edges
}

/// Computes the cross product of a face's edges: twice its area along the outward normal.
fn face_cross(vertices: &[Vec3], face: &[u32; 3]) -> Vec3 {
    let [a, b, c] = face.map(|vertex| vertices[vertex as usize]);
    (b - a).cross(c - a)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a regular octahedron of unit radius.
    fn octahedron() -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let vertices = vec![Vec3::X, Vec3::Y, Vec3::NEG_X, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];
        let faces = (0..4).flat_map(|i| [[i, (i + 1) % 4, 4], [(i + 1) % 4, i, 5]]).collect();
        (vertices, faces)
    }

    #[test]
    fn octahedron_normals_point_along_its_corners() {
        let (vertices, faces) = octahedron();
        for (normal, vertex) in vertex_normals(&vertices, &faces).iter().zip(&vertices) {
            assert!((*normal - *vertex).length() < 1e-6);
        }
    }

    #[test]
    fn vertex_areas_sum_to_the_surface() {
        let (vertices, faces) = octahedron();
        let total: f32 = vertex_areas(&vertices, &faces).iter().sum();
        assert!((total - 4.0 * 3f32.sqrt()).abs() < 1e-5);
    }

    #[test]
    fn closed_surface_has_two_faces_at_each_edge() {
        let (_, faces) = octahedron();
        let edges = edges(&faces);
        assert_eq!(edges.len(), 12);
        assert!(edges.values().all(|&count| count == 2));
    }
}
