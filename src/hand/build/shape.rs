//! Shape blend shapes of the built-in hand, and the regressor of its joints.

use glam::DVec3;
use nalgebra::{DMatrix, DVector};

use super::anatomy::{self, Finger, WRIST};
use crate::hand::{N_BETAS, N_JOINTS};

/// Number of vertices that determine a joint.
const REGRESSOR_VERTICES: usize = 36;

/// Relative growth per unit of a beta: along the bones, across (width), through (thickness).
#[derive(Debug, Clone, Copy, Default)]
struct Growth {
    length: f64,
    width: f64,
    thickness: f64,
}

/// Effect of one beta on the palm and on thumb, index, middle, ring and little finger.
#[derive(Debug, Clone, Copy, Default)]
struct Beta {
    palm: Growth,
    fingers: [Growth; 5],
    /// Additional relative length of the fingers' last bones.
    end_length: f64,
}

/// Returns the effects of the ten betas; at 3 each moves some part by about a centimetre, as MANO's betas do.
fn betas() -> [Beta; N_BETAS] {
    let growth = |length, width, thickness| Growth { length, width, thickness };
    let lengths = |lengths: [f64; 5]| lengths.map(|length| growth(length, 0.0, 0.0));
    let all = |growth| [growth; 5];
    [
        // 0 size of the whole hand
        Beta { palm: growth(0.035, 0.035, 0.035), fingers: all(growth(0.035, 0.035, 0.035)), end_length: 0.0 },
        // 1 length of all fingers
        Beta { fingers: lengths([0.04, 0.05, 0.05, 0.05, 0.05]), ..Beta::default() },
        // 2 breadth of the palm
        Beta { palm: growth(0.0, 0.05, 0.0), ..Beta::default() },
        // 3 girth
        Beta { palm: growth(0.0, 0.01, 0.06), fingers: all(growth(0.0, 0.06, 0.06)), end_length: 0.0 },
        // 4 length of the palm
        Beta { palm: growth(0.045, 0.0, 0.0), ..Beta::default() },
        // 5 length of the thumb
        Beta { fingers: lengths([0.06, 0.0, 0.0, 0.0, 0.0]), ..Beta::default() },
        // 6 index side long, little side short
        Beta { fingers: lengths([0.0, 0.05, 0.015, -0.02, -0.06]), ..Beta::default() },
        // 7 middle and ring finger long
        Beta { fingers: lengths([0.0, -0.02, 0.04, 0.04, -0.02]), ..Beta::default() },
        // 8 long finger ends on short bases
        Beta { fingers: lengths([-0.02; 5]), end_length: 0.10, ..Beta::default() },
        // 9 thickness of the palm against that of the fingers
        Beta { palm: growth(0.0, 0.0, 0.06), fingers: all(growth(0.0, -0.04, -0.03)), end_length: 0.0 },
    ]
}

/// Computes the (V, 3, 10) row-major displacement per unit of each beta, m.
///
/// Each bone is scaled about its joint along its own axes and moved by the bones before it, so that joints stay
/// connected. The skin blends the bones' displacements with the skinning weights.
pub fn shapedirs(points: &[DVec3], weights: &[[f64; N_JOINTS]], fingers: &[Finger; 5]) -> Vec<f64> {
    let mut shapedirs = vec![0.0; points.len() * 3 * N_BETAS];
    for (beta, meaning) in betas().iter().enumerate() {
        for (vertex, (&point, row)) in points.iter().zip(weights).enumerate() {
            let moved: DVec3 =
                (0..N_JOINTS).map(|joint| bone_displacement(meaning, fingers, joint, point) * row[joint]).sum();
            for (axis, value) in moved.to_array().into_iter().enumerate() {
                shapedirs[(vertex * 3 + axis) * N_BETAS + beta] = value;
            }
        }
    }
    shapedirs
}

/// Computes the displacement of `point` as if it were fixed to one joint's bone.
fn bone_displacement(beta: &Beta, fingers: &[Finger; 5], joint: usize, point: DVec3) -> DVec3 {
    let palm = |point: DVec3| {
        let offset = point - WRIST;
        DVec3::new(offset.x * beta.palm.length, offset.y * beta.palm.thickness, offset.z * beta.palm.width)
    };
    let Some(finger) = fingers.iter().find(|finger| (finger.first_joint..finger.first_joint + 3).contains(&joint))
    else {
        return palm(point);
    };
    // Row of the table, which has the thumb first and the ring finger before the little finger.
    let row = match finger.first_joint {
        13 => 0,
        1 => 1,
        4 => 2,
        10 => 3,
        _ => 4,
    };
    let growth = beta.fingers[row];
    let bone = joint - finger.first_joint;
    let lengthening = |bone: usize| growth.length + if bone == 2 { beta.end_length } else { 0.0 };
    let axis = |bone: usize| (finger.joints[bone + 1] - finger.joints[bone]).normalize();
    let mut moved = palm(finger.joints[0]);
    for before in 0..bone {
        moved += (finger.joints[before + 1] - finger.joints[before]) * lengthening(before);
    }
    let offset = point - finger.joints[bone];
    let along = axis(bone);
    let through = finger.palmar.reject_from(along).normalize();
    let across = along.cross(through);
    moved
        + along * (offset.dot(along) * lengthening(bone))
        + across * (offset.dot(across) * growth.width)
        + through * (offset.dot(through) * growth.thickness)
}

/// Computes the (16, V) row-major weights of nearby vertices that reproduce each joint exactly; rows sum to 1.
///
/// Of all such weights it takes those with the least sum of w² d², with d the distance to the joint: the weights are
/// small, and largest for near vertices.
pub fn j_regressor(points: &[DVec3]) -> Vec<f64> {
    let mut regressor = vec![0.0; N_JOINTS * points.len()];
    for (joint, &place) in anatomy::joints().iter().enumerate() {
        let mut near: Vec<usize> = (0..points.len()).collect();
        near.sort_by(|&a, &b| points[a].distance(place).total_cmp(&points[b].distance(place)));
        near.truncate(REGRESSOR_VERTICES);
        // Minimise w' D w subject to A w = b: w = D⁻¹ A' (A D⁻¹ A')⁻¹ b, with offsets from the joint so that b = (0, 0,
        // 0, 1).
        let scale = points[near[0]].distance(place);
        let constraints = DMatrix::from_fn(4, near.len(), |row, column| match row {
            3 => 1.0,
            axis => (points[near[column]] - place)[axis] / scale,
        });
        let cost = DMatrix::from_diagonal(&DVector::from_iterator(
            near.len(),
            near.iter().map(|&vertex| (scale / points[vertex].distance(place)).powi(2)),
        ));
        let damped = &cost * constraints.transpose();
        let system = &constraints * &damped;
        let goal = DVector::from_vec(vec![0.0, 0.0, 0.0, 1.0]);
        // The vertices surround the joint, so they span space and the system is regular.
        let solved = damped * system.cholesky().expect("vertices around a joint span space").solve(&goal);
        for (&vertex, &weight) in near.iter().zip(solved.iter()) {
            regressor[joint * points.len() + vertex] = weight;
        }
    }
    regressor
}
