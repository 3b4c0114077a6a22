//! Closedness, orientation, winding number and distance of triangle meshes.
//!
//! A mesh has an inside if the directed edges of its triangles cancel. Each point then has an integer winding number,
//! even if the mesh has several shells, edges of four triangles, or triangles without area. Vertices at equal positions
//! count as one.

use std::collections::HashMap;

use glam::{DVec3, Vec3};
use robust::{Coord, Coord3D, orient2d, orient3d};

use crate::error::{Error, Result};

/// Largest coordinate of a mesh, m; beyond it single precision cannot resolve millimetres.
pub const MAX_COORDINATE: f32 = 1e4;

/// Smallest ratio of squared double area to fourth power of the longest edge of a triangle; below it, single-precision
/// corners do not define a plane.
const MIN_AREA_RATIO: f64 = 1e-16;

/// Smallest ratio of volume to area^1.5 at which a shell's orientation is above rounding.
const MIN_VOLUME_RATIO: f64 = 1e-6;

/// Result of the search for inside and outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Sides {
    /// Closed with outward-facing triangles; distances inside are negative.
    Closed,
    /// Some edges belong to an odd number of triangles: the mesh has no inside.
    Open {
        /// Number of such edges.
        edges: usize,
    },
    /// Some neighbouring triangles face opposite ways: the mesh has no inside.
    Twisted {
        /// Number of edges between such triangles.
        edges: usize,
    },
    /// Some closed shells face inwards: the solid side is unknown.
    InsideOut {
        /// Number of such shells.
        shells: usize,
    },
}

impl Sides {
    /// Returns true if inside and outside are known.
    pub fn is_known(self) -> bool {
        self == Self::Closed
    }
}

/// Validates coordinates and indices.
///
/// # Errors
/// If an index is out of range, or a coordinate is not finite or beyond [`MAX_COORDINATE`].
pub(super) fn check(vertices: &[Vec3], triangles: &[[u32; 3]]) -> Result<()> {
    if let Some(bad) = vertices.iter().position(|v| !v.is_finite() || v.abs().max_element() > MAX_COORDINATE) {
        let expected = format!("finite, within {MAX_COORDINATE} m");
        return Err(Error::value(format!("vertex {bad}"), expected, vertices[bad]));
    }
    match triangles.iter().flatten().find(|index| **index as usize >= vertices.len()) {
        Some(index) => Err(Error::value("triangle index", format!("below {}", vertices.len()), index)),
        None => Ok(()),
    }
}

/// Determines the sides of a mesh that passed [`check`].
pub(super) fn sides(vertices: &[Vec3], triangles: &[[u32; 3]]) -> Sides {
    let welded = weld(vertices, triangles);
    // Per edge: number of uses, and uses from its lower to its higher index minus the opposite ones.
    let mut edges: HashMap<(u32, u32), (usize, i64)> = HashMap::new();
    for &[a, b, c] in &welded {
        for (from, to) in [(a, b), (b, c), (c, a)].into_iter().filter(|(from, to)| from != to) {
            let edge = edges.entry((from.min(to), from.max(to))).or_default();
            edge.0 += 1;
            edge.1 += if from < to { 1 } else { -1 };
        }
    }
    let uneven = |odd: bool| edges.values().filter(|(uses, net)| *net != 0 && (uses % 2 == 1) == odd).count();
    match (uneven(true), uneven(false)) {
        (0, 0) => match inside_out(vertices, triangles, &welded) {
            0 => Sides::Closed,
            shells => Sides::InsideOut { shells },
        },
        (0, edges) => Sides::Twisted { edges },
        (edges, _) => Sides::Open { edges },
    }
}

/// Replaces each vertex index by the lowest index of the vertices at the same position.
fn weld(vertices: &[Vec3], triangles: &[[u32; 3]]) -> Vec<[u32; 3]> {
    let mut places = HashMap::new();
    // Adding 0 turns -0 into 0.
    let key = |v: Vec3| (v + Vec3::ZERO).to_array().map(f32::to_bits);
    let first: Vec<u32> = vertices.iter().zip(0..).map(|(v, index)| *places.entry(key(*v)).or_insert(index)).collect();
    triangles.iter().map(|triangle| triangle.map(|index| first[index as usize])).collect()
}

/// Counts the shells that face inwards without bounding a cavity of another shell.
fn inside_out(vertices: &[Vec3], triangles: &[[u32; 3]], welded: &[[u32; 3]]) -> usize {
    let mut shell_of: Vec<u32> = (0..vertices.len() as u32).collect();
    fn root(of: &mut [u32], mut index: u32) -> u32 {
        while of[index as usize] != index {
            of[index as usize] = of[of[index as usize] as usize];
            index = of[index as usize];
        }
        index
    }
    for &[a, b, c] in welded {
        for other in [b, c] {
            let (a, other) = (root(&mut shell_of, a), root(&mut shell_of, other));
            shell_of[a.max(other) as usize] = a.min(other);
        }
    }
    let mut shells: HashMap<u32, (f64, f64)> = HashMap::new(); // six times the volume, twice the area
    for (triangle, &[first, ..]) in triangles.iter().zip(welded) {
        let shell = root(&mut shell_of, first);
        // Relative to a vertex of the shell: the volume of a small shell far from the origin would cancel to noise.
        let origin = vertices[shell as usize].as_dvec3();
        let [a, b, c] = triangle.map(|index| vertices[index as usize].as_dvec3() - origin);
        let sums = shells.entry(shell).or_default();
        sums.0 += a.dot(b.cross(c));
        sums.1 += (b - a).cross(c - a).length();
    }
    let mut count = 0;
    for (shell, (volume, area)) in shells {
        if volume > -MIN_VOLUME_RATIO * area.powf(1.5) {
            continue;
        }
        let others = triangles.iter().zip(welded).filter(|(_, w)| root(&mut shell_of, w[0]) != shell);
        let at = vertices[shell as usize];
        let around: i32 = others.map(|(t, _)| crossing(t.map(|index| vertices[index as usize]), at)).sum();
        count += usize::from(around < 1);
    }
    count
}

/// Computes the contribution of a triangle to the winding number of `point`: 1 if the ray along +x leaves through its
/// front, -1 if it enters, else 0.
///
/// The predicates are exact: the sum over a closed surface is the winding number even if the ray meets edges or
/// corners. For a point on the surface, the sum may be the winding number of either side.
pub(super) fn crossing([a, b, c]: [Vec3; 3], point: Vec3) -> i32 {
    let flat = |v: Vec3| Coord { x: v.y, y: v.z };
    // Winding number of the triangle's projection onto the yz plane. Both triangles at an edge evaluate the same
    // predicate, so a ray through the edge counts once.
    let edge = |from: Vec3, to: Vec3| match (from.z <= point.z, to.z <= point.z) {
        (true, false) => i32::from(orient2d(flat(from), flat(to), flat(point)) > 0.0),
        (false, true) => -i32::from(orient2d(flat(from), flat(to), flat(point)) < 0.0),
        _ => 0,
    };
    let shadow = edge(a, b) + edge(b, c) + edge(c, a);
    if shadow == 0 {
        return 0;
    }
    let corner = |v: Vec3| Coord3D { x: v.x, y: v.y, z: v.z };
    // Positive behind the triangle's front.
    let behind = orient3d(corner(a), corner(b), corner(c), corner(point));
    if behind * f64::from(shadow) > 0.0 { shadow } else { 0 }
}

/// Computes the squared distance of a point from a triangle, m²; a triangle without area counts as its longest edge, or
/// as a point.
pub(super) fn distance_squared([a, b, c]: [DVec3; 3], point: DVec3) -> f64 {
    let (ab, bc, ca) = (b - a, c - b, a - c);
    let normal = ab.cross(-ca);
    let (area, longest) =
        (normal.length_squared(), ab.length_squared().max(bc.length_squared()).max(ca.length_squared()));
    let (pa, pb, pc) = (point - a, point - b, point - c);
    let segment = |edge: DVec3, from: DVec3| {
        let length = edge.length_squared();
        let along = if length > 0.0 { (edge.dot(from) / length).clamp(0.0, 1.0) } else { 0.0 };
        (from - along * edge).length_squared()
    };
    if area <= MIN_AREA_RATIO * longest * longest {
        return segment(ab, pa).min(segment(bc, pb)).min(segment(ca, pc));
    }
    // A point beyond an edge is nearest to one of those edges; otherwise its projection lies inside of the triangle.
    let beyond = |edge: DVec3, from: DVec3| match normal.dot(edge.cross(from)) < 0.0 {
        true => segment(edge, from),
        false => f64::INFINITY,
    };
    let edge = beyond(ab, pa).min(beyond(bc, pb)).min(beyond(ca, pc));
    if edge.is_finite() { edge } else { normal.dot(pa).powi(2) / area }
}
