//! Finds faults of a triangle mesh that the engine accepts without a warning.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use glam::{DVec3, Vec3};

/// Ratio of longest edge to height above which a triangle counts as a needle.
const NEEDLE: f64 = 1e4;
/// Ratio of longest edge to height above which a triangle has no area: single-precision coordinates have seven digits.
const NO_AREA: f64 = 1e6;

/// A fault of a mesh, with its number of occurrences.
#[derive(Debug, Clone, PartialEq)]
pub enum MeshFault {
    /// Vertices with a coordinate that is not finite.
    NotFinite(usize),
    /// Triangles with a vertex index out of range.
    BadIndex(usize),
    /// Triangles without area: two equal corners, or three corners on a line.
    ZeroArea(usize),
    /// Triangles more than ten thousand times as long as high.
    Needle(usize),
    /// Vertices at the position of another vertex.
    Duplicate(usize),
    /// Edges that do not belong to exactly two triangles of opposite direction.
    Open(usize),
    /// Enclosed volume, m³, which is negative because the faces look inwards.
    InsideOut(f64),
}

impl fmt::Display for MeshFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite(n) => write!(f, "has {n} vertices that are not finite"),
            Self::BadIndex(n) => write!(f, "has {n} triangles that name a missing vertex"),
            Self::ZeroArea(n) => write!(f, "has {n} triangles without area"),
            Self::Needle(n) => write!(f, "has {n} needle-shaped triangles"),
            Self::Duplicate(n) => write!(f, "has {n} vertices twice"),
            Self::Open(n) => write!(f, "is open: {n} edges do not join two triangles"),
            Self::InsideOut(volume) => write!(f, "is inside out: its volume is {volume:.1e} m³"),
        }
    }
}

/// Returns the faults of a mesh; a closed, outward-facing surface of proper triangles has none.
///
/// `vertices` in m; `faces` counter-clockwise seen from outside.
pub fn mesh_faults(vertices: &[Vec3], faces: &[[u32; 3]]) -> Vec<MeshFault> {
    let mut faults = Vec::new();
    let mut add = |count: usize, fault: fn(usize) -> MeshFault| {
        if count > 0 {
            faults.push(fault(count));
        }
    };
    add(vertices.iter().filter(|v| !v.is_finite()).count(), MeshFault::NotFinite);
    let known = |face: &&[u32; 3]| face.iter().all(|i| (*i as usize) < vertices.len());
    add(faces.iter().filter(|face| !known(face)).count(), MeshFault::BadIndex);

    let corners = |face: &[u32; 3]| face.map(|i| vertices[i as usize].as_dvec3());
    let proper: Vec<&[u32; 3]> = faces.iter().filter(known).collect();
    let slender = |face: &[u32; 3]| {
        let [a, b, c] = corners(face);
        let longest = (b - a).length().max((c - b).length()).max((a - c).length());
        let height = (b - a).cross(c - a).length() / longest.max(f64::MIN_POSITIVE);
        longest / height.max(f64::MIN_POSITIVE)
    };
    let flat = |face: &[u32; 3]| slender(face) > NO_AREA;
    add(proper.iter().filter(|face| flat(face)).count(), MeshFault::ZeroArea);
    add(proper.iter().filter(|face| !flat(face) && slender(face) >= NEEDLE).count(), MeshFault::Needle);

    let key = |v: &Vec3| v.to_array().map(|x| (x + 0.0).to_bits());
    let places: BTreeSet<_> = vertices.iter().map(key).collect();
    add(vertices.len() - places.len(), MeshFault::Duplicate);

    // Edges are identified by position, so that duplicate vertices do not count as holes.
    let mut edges: BTreeMap<_, i32> = BTreeMap::new();
    for face in proper.iter().filter(|face| !flat(face)) {
        let [a, b, c] = face.map(|i| key(&vertices[i as usize]));
        for (from, to) in [(a, b), (b, c), (c, a)] {
            *edges.entry((from, to)).or_default() += 1;
        }
    }
    let lone = edges.iter().filter(|((from, to), n)| **n != 1 || edges.get(&(*to, *from)) != Some(&1)).count();
    add(lone, MeshFault::Open);
    if lone == 0 && !proper.is_empty() {
        let volume: f64 =
            proper.iter().map(|face| corners(face)).map(|[a, b, c]: [DVec3; 3]| a.dot(b.cross(c)) / 6.0).sum();
        if volume < 0.0 {
            faults.push(MeshFault::InsideOut(volume));
        }
    }
    faults
}
