//! Fits a hand model to 21 keypoints: shape, pose, size and place, by damped least squares.

use glam::Vec3;
use nalgebra::{DMatrix, DVector};

use super::{HandModel, HandParams, N_BETAS, N_JOINTS, N_KEYPOINTS, PosedHand};

/// Unknowns: log scale, transl, global_orient, betas, hand_pose.
const N_UNKNOWNS: usize = 1 + 3 + 3 + N_BETAS + 3 * (N_JOINTS - 1);
/// What a beta of one costs, as metres of keypoint error: keypoints that don't need it leave it at zero.
const BETA_COST: f64 = 0.0005;
/// What a radian of pose costs, as metres of keypoint error.
const POSE_COST: f64 = 0.005;

/// A hand fitted to keypoints.
#[derive(Debug, Clone)]
pub struct Fit {
    /// Shape, pose and place.
    pub params: HandParams,
    /// Size on top of the betas, about the wrist joint.
    pub scale: f64,
    /// Root mean square distance of the keypoints, m.
    pub residual: f64,
}

impl Fit {
    /// The fitted hand, scaled about its wrist.
    pub fn posed(&self, model: &HandModel) -> PosedHand {
        let mut posed = model.forward(&self.params);
        let (wrist, scale) = (posed.joints[0], self.scale as f32);
        posed.vertices.iter_mut().chain(&mut posed.joints).for_each(|point| *point = wrist + (*point - wrist) * scale);
        posed
    }
}

/// Finds the shape, pose, size and place in which `model` has the given keypoints, starting from rest.
///
/// `targets`: metres, in the order of [`HandModel::keypoints`]. What keypoints can't tell (twist, girth) stays at rest.
pub fn fit_keypoints(model: &HandModel, targets: &[Vec3; N_KEYPOINTS]) -> Fit {
    // Pose blend shapes move tips by less than the fit's cost terms, and cost most of the time.
    let plain = HandModel { posedirs: Vec::new(), ..model.clone() };
    let mut unknowns = DVector::zeros(N_UNKNOWNS);
    let mut residuals = residuals(&plain, &unknowns, targets);
    let mut damping = 1e-3;
    for _ in 0..40 {
        let jacobian = jacobian(&plain, &unknowns, targets);
        let normal = jacobian.transpose() * &jacobian;
        let gradient = jacobian.transpose() * &residuals;
        let damped = &normal + DMatrix::from_diagonal(&normal.diagonal().map(|entry| damping * entry + 1e-12));
        let Some(step) = damped.cholesky().map(|damped| damped.solve(&gradient)) else { break };
        let next = &unknowns - &step;
        let next_residuals = self::residuals(&plain, &next, targets);
        let gain = residuals.norm_squared() - next_residuals.norm_squared();
        if gain > 0.0 {
            (unknowns, residuals) = (next, next_residuals);
            damping = (damping * 0.3).max(1e-9);
            if gain < 1e-12 {
                break;
            }
        } else {
            damping *= 8.0;
            if damping > 1e6 {
                break;
            }
        }
    }
    let keypoints = residuals.rows(0, 3 * N_KEYPOINTS).norm_squared();
    let (params, scale) = unpacked(&unknowns);
    Fit { params, scale, residual: (keypoints / N_KEYPOINTS as f64).sqrt() }
}

/// Keypoint errors, then the costs of leaving rest, m.
fn residuals(model: &HandModel, unknowns: &DVector<f64>, targets: &[Vec3; N_KEYPOINTS]) -> DVector<f64> {
    let (params, scale) = unpacked(unknowns);
    let posed = Fit { params, scale, residual: 0.0 }.posed(model);
    let keypoints = model.keypoints(&posed);
    let errors = keypoints.iter().zip(targets).flat_map(|(point, target)| (*point - *target).as_dvec3().to_array());
    let betas = unknowns.rows(7, N_BETAS);
    let pose = unknowns.rows(7 + N_BETAS, 3 * (N_JOINTS - 1));
    let costs = betas.iter().map(|beta| beta * BETA_COST).chain(pose.iter().map(|angle| angle * POSE_COST));
    DVector::from_iterator(3 * N_KEYPOINTS + N_BETAS + 3 * (N_JOINTS - 1), errors.chain(costs))
}

/// By central differences; a step of 1e-3 is far above the rounding of single-precision vertices.
fn jacobian(model: &HandModel, unknowns: &DVector<f64>, targets: &[Vec3; N_KEYPOINTS]) -> DMatrix<f64> {
    const STEP: f64 = 1e-3;
    let column = |k: usize| {
        let at = |offset: f64| {
            let mut moved = unknowns.clone();
            moved[k] += offset;
            residuals(model, &moved, targets)
        };
        (at(STEP) - at(-STEP)) / (2.0 * STEP)
    };
    DMatrix::from_columns(&(0..N_UNKNOWNS).map(column).collect::<Vec<_>>())
}

fn unpacked(unknowns: &DVector<f64>) -> (HandParams, f64) {
    let vec3 = |at: usize| Vec3::new(unknowns[at] as f32, unknowns[at + 1] as f32, unknowns[at + 2] as f32);
    let params = HandParams {
        transl: vec3(1),
        global_orient: vec3(4),
        betas: std::array::from_fn(|beta| unknowns[7 + beta] as f32),
        hand_pose: std::array::from_fn(|joint| vec3(7 + N_BETAS + 3 * joint)),
    };
    (params, unknowns[0].exp())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::Side;

    #[test]
    fn fit_finds_a_posed_scaled_hand_again() {
        let model = HandModel::builtin(Side::Right);
        let mut betas = [0.0; N_BETAS];
        (betas[1], betas[4]) = (1.5, -1.0);
        let params = HandParams {
            betas,
            global_orient: Vec3::new(0.1, -0.4, 0.2),
            hand_pose: std::array::from_fn(|joint| Vec3::Z * (0.05 * joint as f32)),
            transl: Vec3::new(0.02, -0.01, 0.03),
        };
        let truth = Fit { params, scale: 1.1, residual: 0.0 }.posed(&model);
        let targets = model.keypoints(&truth);
        let fit = fit_keypoints(&model, &targets);
        assert!(fit.residual < 0.0008, "{} m", fit.residual);
        let found = fit.posed(&model);
        let errors = found.vertices.iter().zip(&truth.vertices).map(|(a, b)| a.distance(*b));
        let mean = errors.sum::<f32>() / truth.vertices.len() as f32;
        // Girth and twist are not in the keypoints.
        assert!(mean < 0.004, "{mean} m");
    }
}
