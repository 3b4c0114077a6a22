//! Phong tessellation (Boubekeur & Alexa 2008): replaces each triangle by a curved patch that follows the vertex
//! normals.

use glam::Vec3;
use image::Rgb;

use super::color::{encoded, linear};

/// Number of pieces that an edge is divided into.
const PIECES: u32 = 4;
/// Interpolation between the flat and the curved patch; 3/4 is the value of the paper.
const ROUNDNESS: f32 = 0.75;

/// A tessellated mesh.
#[derive(Debug, Default)]
pub struct FineMesh {
    /// Vertices, m.
    pub vertices: Vec<Vec3>,
    /// Unit normals.
    pub normals: Vec<Vec3>,
    /// Colours.
    pub colors: Vec<Rgb<u8>>,
    /// Triangles.
    pub faces: Vec<[u32; 3]>,
}

/// Tessellates every face. Neighbours stay connected, because the points of an edge depend on that edge alone.
pub fn tessellated(vertices: &[Vec3], normals: &[Vec3], colors: &[Rgb<u8>], faces: &[[u32; 3]]) -> FineMesh {
    let mut fine = FineMesh::default();
    for face in faces {
        let corners = face.map(|vertex| vertex as usize);
        let first = fine.vertices.len() as u32;
        for row in 0..=PIECES {
            for column in 0..=PIECES - row {
                let (u, v) = (row as f32 / PIECES as f32, column as f32 / PIECES as f32);
                let weights = [1.0 - u - v, u, v];
                let mix = |values: [Vec3; 3]| values[0] * weights[0] + values[1] * weights[1] + values[2] * weights[2];
                let flat = mix(corners.map(|k| vertices[k]));
                let curved = mix(corners.map(|k| flat - normals[k] * (flat - vertices[k]).dot(normals[k])));
                fine.vertices.push(flat.lerp(curved, ROUNDNESS));
                fine.normals.push(mix(corners.map(|k| normals[k])).normalize_or_zero());
                fine.colors.push(encoded(mix(corners.map(|k| linear(colors[k])))));
            }
        }
        // Rows have PIECES + 1, PIECES, ... points.
        let at = |row: u32, column: u32| first + row * (PIECES + 1) - row * (row.max(1) - 1) / 2 + column;
        for row in 0..PIECES {
            for column in 0..PIECES - row {
                fine.faces.push([at(row, column), at(row + 1, column), at(row, column + 1)]);
                if column + row + 1 < PIECES {
                    fine.faces.push([at(row + 1, column), at(row + 1, column + 1), at(row, column + 1)]);
                }
            }
        }
    }
    fine
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tessellated_octahedron_is_nearly_a_sphere() {
        let vertices = [Vec3::X, Vec3::Y, Vec3::NEG_X, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];
        let faces: Vec<[u32; 3]> = (0..4).flat_map(|i| [[i, (i + 1) % 4, 4], [(i + 1) % 4, i, 5]]).collect();
        let fine = tessellated(&vertices, &vertices, &[Rgb([9, 9, 9]); 6], &faces);
        assert_eq!(fine.faces.len(), 8 * (PIECES * PIECES) as usize);
        let least = fine.vertices.iter().map(|v| v.length()).fold(f32::MAX, f32::min);
        // The flat faces come within 0.58 of the centre.
        assert!(least > 0.85, "{least}");
        let area: f32 = crate::hand::vertex_areas(&fine.vertices, &fine.faces).iter().sum();
        assert!((10.0..13.0).contains(&area), "{area} of 12.57");
        for face in &fine.faces {
            let [a, b, c] = face.map(|v| fine.vertices[v as usize]);
            assert!((b - a).cross(c - a).dot(a + b + c) > 0.0, "a face looks inwards");
        }
    }
}
