//! Triangle-mesh geometry of a hand: normals and vertex areas.

use glam::Vec3;

/// Unit normals per vertex, area weighted, pointing outwards.
pub fn vertex_normals(_vertices: &[Vec3], _faces: &[[u32; 3]]) -> Vec<Vec3> {
    unimplemented!()
}

/// Area per vertex in m²: a third of each adjacent triangle; the sum is the surface's area.
pub fn vertex_areas(_vertices: &[Vec3], _faces: &[[u32; 3]]) -> Vec<f32> {
    unimplemented!()
}
