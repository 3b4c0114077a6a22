//! Computes skinning weights by heat diffusion along the surface (Baran & Popović 2007).

use glam::DVec3;
use nalgebra::{DMatrix, DVector};

use super::anatomy::{self, Finger};
use crate::hand::N_JOINTS;

/// Factor of the heat that a vertex receives from its nearest bone; larger values give narrower joints.
const STIFFNESS: f64 = 1.0;
/// Value subtracted from every weight before normalisation; it removes the far tails without a discontinuity.
const CUT: f64 = 0.02;

/// Computes (V, 16) skinning weights; rows sum to 1.
///
/// Solves (L + H) w = H p per joint, with the cotangent Laplacian L, H = area x STIFFNESS / d², the distance d to the
/// nearest bone, and p = 1 at vertices nearest to the joint's bone. Heat spreads along the skin, so it does not cross
/// the gap between two fingers.
pub fn weights(points: &[DVec3], faces: &[[u32; 3]], fingers: &[Finger; 5]) -> Vec<[f64; N_JOINTS]> {
    let (mut matrix, areas) = laplacian(points, faces);
    let bones = bones(fingers);
    let nearest: Vec<(usize, f64)> = points.iter().map(|&point| nearest_bone(point, &bones)).collect();
    let mut heat = DVector::zeros(points.len());
    for (vertex, (_, distance)) in nearest.iter().enumerate() {
        heat[vertex] = areas[vertex] * STIFFNESS / (distance * distance);
        matrix[(vertex, vertex)] += heat[vertex];
    }
    let sources = DMatrix::from_fn(
        points.len(),
        N_JOINTS,
        |vertex, joint| {
            if nearest[vertex].0 == joint { heat[vertex] } else { 0.0 }
        },
    );
    // The matrix is diagonally dominant with a positive diagonal, hence positive definite.
    let solved = matrix.cholesky().expect("a diagonally dominant matrix").solve(&sources);
    let row = |vertex| {
        let kept: [f64; N_JOINTS] = std::array::from_fn(|joint| (solved[(vertex, joint)] - CUT).max(0.0));
        let total: f64 = kept.iter().sum();
        kept.map(|weight| weight / total)
    };
    (0..points.len()).map(row).collect()
}

/// Computes the stiffness matrix with positive cotangent weights, and the area of each vertex.
fn laplacian(points: &[DVec3], faces: &[[u32; 3]]) -> (DMatrix<f64>, Vec<f64>) {
    let mut matrix = DMatrix::zeros(points.len(), points.len());
    let mut areas = vec![0.0; points.len()];
    for face in faces {
        let corners = face.map(|vertex| vertex as usize);
        for k in 0..3 {
            let [a, b, c] = [corners[k], corners[(k + 1) % 3], corners[(k + 2) % 3]];
            let (p, q) = (points[a] - points[c], points[b] - points[c]);
            let double_area = p.cross(q).length();
            areas[a] += double_area / 6.0;
            // The negative weight of an obtuse angle could make a skinning weight negative.
            let weight = (0.5 * p.dot(q) / double_area).max(0.02);
            for (i, j) in [(a, b), (b, a)] {
                matrix[(i, j)] -= weight;
                matrix[(i, i)] += weight;
            }
        }
    }
    (matrix, areas)
}

/// Returns the bones as (joint, from, to): each phalanx, and the palm's bones, which move with the wrist.
fn bones(fingers: &[Finger; 5]) -> Vec<(usize, DVec3, DVec3)> {
    let mut bones = Vec::new();
    for finger in fingers {
        let joints = &finger.joints;
        bones.push((0, anatomy::WRIST + DVec3::X * 0.02, joints[0]));
        bones.extend((0..3).map(|i| (finger.first_joint + i, joints[i], joints[i + 1])));
    }
    // The web between thumb and index finger follows the thumb's metacarpal, not its phalanx.
    let [index, .., thumb] = fingers;
    let [carpal, base, ..] = thumb.joints;
    bones.push((thumb.first_joint, carpal.lerp(base, 0.6), base.lerp(index.base, 0.4)));
    bones
}

/// Returns the joint of the nearest bone, and its distance, m.
fn nearest_bone(point: DVec3, bones: &[(usize, DVec3, DVec3)]) -> (usize, f64) {
    let distance = |(from, to): (DVec3, DVec3)| {
        let along = to - from;
        let t = ((point - from).dot(along) / along.length_squared()).clamp(0.0, 1.0);
        (point - from - along * t).length()
    };
    let all = bones.iter().map(|&(joint, from, to)| (joint, distance((from, to))));
    all.fold((0, f64::INFINITY), |best, next| if next.1 < best.1 { next } else { best })
}
