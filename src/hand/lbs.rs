//! Linear blend skinning as MANO defines it (Romero et al. 2017, eq. 2-4; SMPL, eq. 1-10).

use glam::{Mat3, Vec3};
use nalgebra::{Matrix3, Vector3};

use super::{HandModel, HandParams, N_BETAS, N_JOINTS, PosedHand};

/// Entries of (R - I) over joints 1..16.
const N_POSE_FEATURES: usize = 9 * (N_JOINTS - 1);

/// Rigid motion `x -> rotation x + translation`.
#[derive(Clone, Copy)]
struct Rigid {
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
}

/// Joints at rest and in a pose, before `transl`, and the rotations between them.
struct Skeleton {
    /// Template plus shape blend shapes, (778), m.
    shaped: Vec<Vector3<f64>>,
    /// Joints of the shaped hand at rest, m.
    rest_joints: [Vector3<f64>; N_JOINTS],
    /// Rotation of each joint relative to its parent.
    local: [Matrix3<f64>; N_JOINTS],
    /// Rotation and position of each posed joint in the hand's frame.
    world: [Rigid; N_JOINTS],
}

/// Poses the joints of `model` without its vertices.
fn skeleton(model: &HandModel, params: &HandParams) -> Skeleton {
    let shaped = shaped_vertices(model, &params.betas);
    let rest_joints = regress_joints(model, &shaped);
    let mut local = [Matrix3::identity(); N_JOINTS];
    local[0] = rotation_from_axis_angle(params.global_orient);
    for (joint, axis_angle) in params.hand_pose.iter().enumerate() {
        local[joint + 1] = rotation_from_axis_angle(*axis_angle);
    }
    let world = rigid_chain(&model.parents, &rest_joints, &local);
    Skeleton { shaped, rest_joints, local, world }
}

/// Computes the joints of `model` alone, (16), m; bit-equal to those of [`forward`].
pub(super) fn joints(model: &HandModel, params: &HandParams) -> [Vec3; N_JOINTS] {
    let transl = vector(params.transl);
    skeleton(model, params).world.map(|motion| vec3(motion.translation + transl))
}

/// Poses `model`; computes in f64 and returns f32.
pub(super) fn forward(model: &HandModel, params: &HandParams) -> PosedHand {
    let Skeleton { shaped, rest_joints, local, world } = skeleton(model, params);
    let transl = vector(params.transl);

    // Motion from rest space with each joint: move the joint to the origin, then apply its pose.
    let from_rest = std::array::from_fn::<_, N_JOINTS, _>(|joint| Rigid {
        rotation: world[joint].rotation,
        translation: world[joint].translation - world[joint].rotation * rest_joints[joint],
    });
    let offsets = pose_offsets(model, &local);
    let skin = |(vertex, weights): (usize, &[f32])| {
        let point = shaped[vertex] + offsets.get(vertex).copied().unwrap_or_default();
        let mut posed = transl;
        for (motion, &weight) in from_rest.iter().zip(weights) {
            if weight != 0.0 {
                posed += f64::from(weight) * (motion.rotation * point + motion.translation);
            }
        }
        vec3(posed)
    };
    PosedHand {
        vertices: model.lbs_weights.chunks_exact(N_JOINTS).enumerate().map(skin).collect(),
        joints: world.map(|motion| vec3(motion.translation + transl)),
        rotations: world.map(|motion| mat3(motion.rotation)),
    }
}

/// Computes the joints at rest with zero betas, m.
pub(super) fn rest_joints(model: &HandModel) -> [Vec3; N_JOINTS] {
    regress_joints(model, &shaped_vertices(model, &[0.0; N_BETAS])).map(vec3)
}

/// Computes template plus shape blend shapes, (778), m.
fn shaped_vertices(model: &HandModel, betas: &[f32; N_BETAS]) -> Vec<Vector3<f64>> {
    let shape = |row: &[f32]| -> f64 { row.iter().zip(betas).map(|(d, b)| f64::from(*d) * f64::from(*b)).sum() };
    let rows = model.shapedirs.chunks_exact(3 * N_BETAS);
    let vertex = |(rest, rows): (&Vec3, &[f32])| {
        vector(*rest)
            + Vector3::new(shape(&rows[..N_BETAS]), shape(&rows[N_BETAS..2 * N_BETAS]), shape(&rows[2 * N_BETAS..]))
    };
    model.v_template.iter().zip(rows).map(vertex).collect()
}

/// Computes the joints of the shaped hand at rest, m.
fn regress_joints(model: &HandModel, shaped: &[Vector3<f64>]) -> [Vector3<f64>; N_JOINTS] {
    std::array::from_fn(|joint| {
        let row = &model.j_regressor[joint * shaped.len()..(joint + 1) * shaped.len()];
        row.iter().zip(shaped).filter(|(w, _)| **w != 0.0).map(|(w, v)| *v * f64::from(*w)).sum()
    })
}

/// Computes the pose blend shapes, (778), m; empty if the model has none.
fn pose_offsets(model: &HandModel, local: &[Matrix3<f64>; N_JOINTS]) -> Vec<Vector3<f64>> {
    let features: Vec<f64> = local[1..]
        .iter()
        .flat_map(|rotation| (rotation - Matrix3::identity()).transpose().as_slice().to_vec()) // row-major
        .collect();
    // Features of joints at rest are 0; skipping them makes the rest pose and one-finger poses cheap.
    let active: Vec<usize> = (0..N_POSE_FEATURES).filter(|&i| features[i] != 0.0).collect();
    let dot = |row: &[f32]| -> f64 { active.iter().map(|&i| f64::from(row[i]) * features[i]).sum() };
    let vertex = |rows: &[f32]| {
        let mut rows = rows.chunks_exact(N_POSE_FEATURES).map(dot);
        Vector3::from_fn(|_, _| rows.next().unwrap_or(0.0))
    };
    model.posedirs.chunks_exact(3 * N_POSE_FEATURES).map(vertex).collect()
}

/// Computes rotation and position of each posed joint.
///
/// Parents precede their children in MANO's order, so one pass over the joints suffices.
fn rigid_chain(
    parents: &[usize; N_JOINTS],
    rest: &[Vector3<f64>; N_JOINTS],
    local: &[Matrix3<f64>; N_JOINTS],
) -> [Rigid; N_JOINTS] {
    let mut world = [Rigid { rotation: local[0], translation: rest[0] }; N_JOINTS];
    for joint in 1..N_JOINTS {
        let parent = world[parents[joint]];
        world[joint] = Rigid {
            rotation: parent.rotation * local[joint],
            translation: parent.translation + parent.rotation * (rest[joint] - rest[parents[joint]]),
        };
    }
    world
}

/// Computes Rodrigues' formula without cancellation at any angle: R = I + (sin t / t) K + ((1 - cos t) / t²) K².
fn rotation_from_axis_angle(axis_angle: Vec3) -> Matrix3<f64> {
    let v = vector(axis_angle);
    let angle = v.norm();
    // Below 1e-4 the two-term series is exact to the last digit of f64, and avoids a division by zero.
    let (sine, cosine) = if angle < 1e-4 {
        (1.0 - angle * angle / 6.0, 0.5 - angle * angle / 24.0)
    } else {
        // (1 - cos t) / t² = 2 (sin(t/2) / t)², without cancellation.
        (angle.sin() / angle, 2.0 * ((0.5 * angle).sin() / angle).powi(2))
    };
    let k = v.cross_matrix();
    Matrix3::identity() + k * sine + k * k * cosine
}

fn vector(v: Vec3) -> Vector3<f64> {
    Vector3::new(f64::from(v.x), f64::from(v.y), f64::from(v.z))
}

fn vec3(v: Vector3<f64>) -> Vec3 {
    Vec3::new(v.x as f32, v.y as f32, v.z as f32)
}

fn mat3(m: Matrix3<f64>) -> Mat3 {
    Mat3::from_cols(vec3(m.column(0).into()), vec3(m.column(1).into()), vec3(m.column(2).into()))
}

#[cfg(test)]
mod tests {
    use std::f32::consts::PI;

    use super::*;

    /// Computes the same rotation through a quaternion, an independent formula.
    fn by_quaternion(v: Vec3) -> Matrix3<f64> {
        let v = vector(v);
        let half = 0.5 * v.norm();
        let axis = if half > 0.0 { v / (2.0 * half) } else { Vector3::x() };
        let q = nalgebra::Quaternion::from_parts(half.cos(), axis * half.sin());
        *nalgebra::UnitQuaternion::from_quaternion(q).to_rotation_matrix().matrix()
    }

    #[test]
    fn rotation_is_exact_near_zero_at_pi_and_beyond() {
        let axis = Vec3::new(0.48, -0.6, 0.64);
        for angle in [0.0, 1e-30, 1e-8, 9.9e-5, 1.01e-4, 0.5, PI - 1e-6, PI, PI + 1e-6, 2.0 * PI, 7.5, -40.0] {
            let rotation = rotation_from_axis_angle(axis * angle);
            assert!((rotation - by_quaternion(axis * angle)).norm() < 1e-12, "angle {angle}");
            assert!((rotation * rotation.transpose() - Matrix3::identity()).norm() < 1e-12, "angle {angle}");
        }
    }
}
