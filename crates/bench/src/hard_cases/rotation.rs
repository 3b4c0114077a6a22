//! Rotations near zero, half a turn and a whole turn.

use std::f64::consts::PI;

use egotac::error::Result;
use egotac::hand::{HandModel, HandParams, Side};
use glam::{Mat3, Vec3};

use super::{Family, HardCase, Outcome};

const FAMILY: Family = Family::Rotation;

pub(super) const CASES: &[HardCase] = &[
    FAMILY.case(
        "axis_angle_near_zero",
        "axis-angle of 0 to 1e-6 rad, by sine over angle in single precision",
        "the hand model: a series in double precision",
        || axis_angle(&[0.0, 1e-30, 1e-20, 1e-12, 1e-8, 1e-7, 1e-6]),
    ),
    FAMILY.case(
        "axis_angle_near_pi",
        "axis-angle within 1e-6 rad of half and of whole turns, by its formula in single precision",
        "the hand model: double precision",
        || axis_angle(&[PI - 1e-6, PI, PI + 1e-6, 2.0 * PI - 1e-6, 2.0 * PI, 2.0 * PI + 1e-6, 20.0 * PI]),
    ),
    #[cfg(feature = "sim")]
    FAMILY.case(
        "logarithm_near_zero",
        "angle of a rotation by its matrix's trace, 1e-12 to 1e-6 rad",
        "the logarithm of its quaternion with atan2",
        || logarithm(&[1e-12, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6]),
    ),
    #[cfg(feature = "sim")]
    FAMILY.case(
        "logarithm_near_pi",
        "rotation vector by trace and skew part, within 1e-6 rad of half a turn",
        "the logarithm of its quaternion with atan2",
        || logarithm(&[PI - 1e-6, PI - 1e-8, PI - 1e-10, PI]),
    ),
    #[cfg(feature = "sim")]
    FAMILY.case(
        "logarithm_beyond_pi",
        "rotation vectors of 3.2 to 12 rad and back: the result is another vector of the same rotation",
        "compare rotations, not vectors",
        beyond_half_a_turn,
    ),
];

/// Axis of all rotations, about of unit length.
const AXIS: [f64; 3] = [0.48, -0.6, 0.64];

/// Returns the largest difference between the entries of a matrix and of the quaternion's matrix; infinite if one is NaN.
fn difference(matrix: &[[f64; 3]; 3], angle: f64) -> f64 {
    let exact = by_quaternion(angle);
    let entries = matrix.iter().flatten().zip(exact.iter().flatten());
    entries.map(|(a, b)| (a - b).abs()).fold(0.0, |most, d| if d.is_nan() { f64::INFINITY } else { most.max(d) })
}

/// Computes the rows of the rotation about [`AXIS`] by the quaternion: another formula than the model's.
fn by_quaternion(angle: f64) -> [[f64; 3]; 3] {
    let length = AXIS.iter().map(|x| x * x).sum::<f64>().sqrt();
    let w = (0.5 * angle).cos();
    let [x, y, z] = AXIS.map(|a| a / length * (0.5 * angle).sin());
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// Computes Rodrigues' formula as textbooks have it, in single precision.
fn textbook(vector: Vec3) -> [[f64; 3]; 3] {
    let angle = vector.length();
    let [x, y, z] = (vector / angle).to_array();
    let (s, c) = angle.sin_cos();
    let k = Mat3::from_cols_array(&[0.0, z, -y, -z, 0.0, x, y, -x, 0.0]);
    rows(Mat3::IDENTITY + k * s + k * k * (1.0 - c))
}

fn rows(m: Mat3) -> [[f64; 3]; 3] {
    m.transpose().to_cols_array_2d().map(|row| row.map(f64::from))
}

fn axis_angle(angles: &[f64]) -> Result<Outcome> {
    let model = HandModel::builtin(Side::Right);
    let (mut naive, mut ours) = (0f64, 0f64);
    for angle in angles {
        let length = AXIS.iter().map(|x| x * x).sum::<f64>().sqrt();
        let vector = Vec3::from_array(AXIS.map(|a| (a / length * angle) as f32));
        // The vector rounded to single precision defines the rotation asked for.
        let asked = vector.as_dvec3().length();
        naive = naive.max(difference(&textbook(vector), asked));
        let posed = model.forward(&HandParams { global_orient: vector, ..HandParams::default() });
        ours = ours.max(difference(&rows(posed.rotations[0]), asked));
    }
    Ok(Outcome {
        error_of: "entries of the rotation matrix",
        // Rounding of the vector to single precision turns its axis by up to 6e-8, at large angles as at small ones.
        tolerance: 5e-7,
        unguarded: Some(naive),
        guard: if naive <= 5e-7 { String::new() } else { "not used: no part of egotac has this formula".into() },
        remedied: ours,
        remedied_guard: String::new(),
    })
}

#[cfg(feature = "sim")]
fn logarithm(angles: &[f64]) -> Result<Outcome> {
    use glam::{DMat3, DQuat, DVec3};
    let axis = DVec3::from_array(AXIS).normalize();
    let (mut naive, mut ours) = (0f64, 0f64);
    for angle in angles {
        let q = DQuat::from_xyzw(0.0, 0.0, 0.0, (0.5 * angle).cos());
        let v = axis * (0.5 * angle).sin();
        let q = DQuat::from_xyzw(v.x, v.y, v.z, q.w);
        let asked = axis * *angle;
        // At exactly half a turn both signs are right.
        let error =
            |found: DVec3| (found - asked).length().min((found + asked).length().max(2.0 * (PI - angle))) / angle;
        let m = DMat3::from_quat(q);
        let theta = (0.5 * (m.x_axis.x + m.y_axis.y + m.z_axis.z - 1.0)).acos();
        let skew = DVec3::new(m.y_axis.z - m.z_axis.y, m.z_axis.x - m.x_axis.z, m.x_axis.y - m.y_axis.x);
        let by_trace = error(skew * (theta / (2.0 * theta.sin())));
        naive = if by_trace.is_nan() { f64::INFINITY } else { naive.max(by_trace) };
        ours = ours.max(error(egotac::sim::rig::rotation_vector(q)));
    }
    Ok(Outcome {
        error_of: "rotation vector, relative",
        tolerance: 1e-9,
        unguarded: Some(naive),
        guard: "not used: no part of egotac has this formula".into(),
        remedied: ours,
        remedied_guard: String::new(),
    })
}

#[cfg(feature = "sim")]
fn beyond_half_a_turn() -> Result<Outcome> {
    use glam::{DQuat, DVec3};
    let axis = DVec3::from_array(AXIS).normalize();
    let (mut of_vector, mut of_rotation) = (0f64, 0f64);
    for angle in [3.2, 4.0, 5.0, 6.2, 7.0, 9.0, 12.0] {
        let q = DQuat::from_axis_angle(axis, angle);
        let vector = egotac::sim::rig::rotation_vector(q);
        of_vector = of_vector.max((vector - axis * angle).length());
        let again = DQuat::from_scaled_axis(vector);
        of_rotation = of_rotation.max(
            (DVec3::new(again.x, again.y, again.z) * again.w.signum() - DVec3::new(q.x, q.y, q.z) * q.w.signum())
                .length(),
        );
    }
    Ok(Outcome {
        error_of: "vector after conversion to a rotation and back, rad",
        tolerance: 1e-12,
        unguarded: Some(of_vector),
        guard: "documented: the result has an angle of at most half a turn".into(),
        remedied: of_rotation,
        remedied_guard: String::new(),
    })
}
