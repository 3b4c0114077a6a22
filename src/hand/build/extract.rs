//! Meshes an implicit surface by surface nets (Gibson 1998).

use std::collections::HashMap;

use glam::{DVec3, IVec3};

/// Meshes the zero level of `value` (negative inside) within `low..high` on a grid of `step`.
///
/// Each grid cell that the surface crosses gives one vertex, each crossed grid edge a quad of two triangles,
/// counter-clockwise seen from outside. The surface must not touch the bounds. The mesh is manifold if the surface is
/// smooth at the scale of `step`.
pub fn surface_nets(value: impl Fn(DVec3) -> f64, low: DVec3, high: DVec3, step: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let size = ((high - low) / step).ceil().as_ivec3() + IVec3::ONE;
    let corner = |cell: IVec3| low + cell.as_dvec3() * step;
    let slot = |cell: IVec3| ((cell.z * size.y + cell.y) * size.x + cell.x) as usize;
    let cells = |size: IVec3| {
        (0..size.z).flat_map(move |z| (0..size.y).flat_map(move |y| (0..size.x).map(move |x| IVec3::new(x, y, z))))
    };
    let values: Vec<f64> = cells(size).map(|cell| value(corner(cell))).collect();

    let mut vertices = Vec::new();
    let mut vertex_of_cell = HashMap::new();
    for cell in cells(size - IVec3::ONE) {
        if let Some(centre) = crossing_centre(cell, |cell| values[slot(cell)]) {
            vertex_of_cell.insert(cell, vertices.len() as u32);
            vertices.push(low + centre * step);
        }
    }

    let mut faces = Vec::new();
    for cell in cells(size - IVec3::ONE) {
        for [along, u, v] in
            [[IVec3::X, IVec3::Y, IVec3::Z], [IVec3::Y, IVec3::Z, IVec3::X], [IVec3::Z, IVec3::X, IVec3::Y]]
        {
            let (here, there) = (values[slot(cell)] < 0.0, values[slot(cell + along)] < 0.0);
            if here == there {
                continue;
            }
            // The four cells around the grid edge. One is absent only if the surface leaves the bounds.
            let quad = [cell - u - v, cell - v, cell, cell - u].map(|cell| vertex_of_cell.get(&cell).copied());
            let [Some(a), Some(b), Some(c), Some(d)] = quad else { continue };
            let [a, b, c, d] = if here { [a, b, c, d] } else { [d, c, b, a] };
            faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    (vertices, faces)
}

/// Computes the mean of the points where the cell's edges cross the surface, in grid units; `None` if no edge does.
fn crossing_centre(cell: IVec3, value: impl Fn(IVec3) -> f64) -> Option<DVec3> {
    let mut sum = DVec3::ZERO;
    let mut count = 0;
    for corner in 0..8 {
        let from = cell + IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2 & 1);
        for axis in [IVec3::X, IVec3::Y, IVec3::Z] {
            if (from - cell).dot(axis) == 1 {
                continue;
            }
            let (a, b) = (value(from), value(from + axis));
            if (a < 0.0) != (b < 0.0) {
                sum += from.as_dvec3() + axis.as_dvec3() * (a / (a - b));
                count += 1;
            }
        }
    }
    (count > 0).then(|| sum / f64::from(count))
}
