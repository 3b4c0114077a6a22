//! Fits a hand model to keypoints and a surface: shape, pose, size and place, by damped least squares.

use glam::Vec3;
use nalgebra::{DMatrix, DVector};

use super::{HandModel, HandParams, N_BETAS, N_JOINTS, N_KEYPOINTS, PosedHand};

/// Unknowns: log scale, transl, global_orient, betas, hand_pose.
const N_UNKNOWNS: usize = 1 + 3 + 3 + N_BETAS + 3 * (N_JOINTS - 1);
/// What a beta of one costs, as metres of keypoint error: keypoints that don't need it leave it at zero.
const BETA_COST: f64 = 0.001;
/// What a radian of pose costs, as metres of keypoint error.
const POSE_COST: f64 = 0.005;
/// What doubling the size costs (per unit of log scale), as metres of keypoint error; the first beta is size, too.
const SCALE_COST: f64 = 0.02;
/// What a metre of distance between skins counts, against a metre between keypoints.
const SKIN_WEIGHT: f64 = 0.3;

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

/// A vertex that shall lie on a plane: the nearest piece of another skin.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pull {
    pub vertex: usize,
    pub place: Vec3,
    pub normal: Vec3,
}

/// Finds the shape, pose, size and place in which `model` has the given keypoints, starting from rest.
///
/// `targets`: metres, in the order of [`HandModel::keypoints`]. What keypoints can't tell (twist, girth) stays at rest.
pub fn fit_keypoints(model: &HandModel, targets: &[Vec3; N_KEYPOINTS]) -> Fit {
    let rest = Fit { params: HandParams::default(), scale: 1.0, residual: f64::INFINITY };
    refine(model, &rest, targets, &[])
}

/// Continues a fit with skin to follow as well.
pub(super) fn refine(model: &HandModel, start: &Fit, targets: &[Vec3; N_KEYPOINTS], pulls: &[Pull]) -> Fit {
    // Pose blend shapes move tips by less than the fit's cost terms, and cost most of the time.
    let plain = HandModel { posedirs: Vec::new(), ..model.clone() };
    let goal = Goal { model: &plain, keypoints: targets, pulls };
    let mut unknowns = packed(start);
    let mut residuals = goal.residuals(&unknowns);
    let mut damping = 1e-3;
    for _ in 0..40 {
        let jacobian = goal.jacobian(&unknowns);
        let normal = jacobian.transpose() * &jacobian;
        let gradient = jacobian.transpose() * &residuals;
        let damped = &normal + DMatrix::from_diagonal(&normal.diagonal().map(|entry| damping * entry + 1e-12));
        let Some(step) = damped.cholesky().map(|damped| damped.solve(&gradient)) else { break };
        let next = &unknowns - &step;
        let next_residuals = goal.residuals(&next);
        let gain = residuals.norm_squared() - next_residuals.norm_squared();
        if gain > 0.0 {
            (unknowns, residuals) = (next, next_residuals);
            damping = (damping * 0.3).max(1e-9);
            // Of no use where the keypoints' rounding begins.
            if gain < 1e-9 {
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

/// What the fit makes small.
struct Goal<'a> {
    model: &'a HandModel,
    keypoints: &'a [Vec3; N_KEYPOINTS],
    pulls: &'a [Pull],
}

impl Goal<'_> {
    /// Keypoint errors, the costs of leaving rest, then distances between skins, m.
    fn residuals(&self, unknowns: &DVector<f64>) -> DVector<f64> {
        let (params, scale) = unpacked(unknowns);
        let posed = Fit { params, scale, residual: 0.0 }.posed(self.model);
        let keypoints = self.model.keypoints(&posed);
        let errors = keypoints.iter().zip(self.keypoints);
        let errors = errors.flat_map(|(point, target)| (*point - *target).as_dvec3().to_array());
        let cost = |k: usize| match k {
            0 => SCALE_COST,
            1..7 => 0.0,
            7..17 => BETA_COST,
            _ => POSE_COST,
        };
        let costs = unknowns.iter().enumerate().map(|(k, value)| value * cost(k));
        let distance =
            |pull: &Pull| f64::from((posed.vertices[pull.vertex] - pull.place).dot(pull.normal)) * SKIN_WEIGHT;
        let distances = self.pulls.iter().map(distance);
        let count = 3 * N_KEYPOINTS + N_UNKNOWNS + self.pulls.len();
        DVector::from_iterator(count, errors.chain(costs).chain(distances))
    }

    /// By central differences; a step of 1e-3 is far above the rounding of single-precision vertices.
    fn jacobian(&self, unknowns: &DVector<f64>) -> DMatrix<f64> {
        const STEP: f64 = 1e-3;
        let column = |k: usize| {
            let at = |offset: f64| {
                let mut moved = unknowns.clone();
                moved[k] += offset;
                self.residuals(&moved)
            };
            (at(STEP) - at(-STEP)) / (2.0 * STEP)
        };
        DMatrix::from_columns(&(0..N_UNKNOWNS).map(column).collect::<Vec<_>>())
    }
}

fn packed(fit: &Fit) -> DVector<f64> {
    let HandParams { betas, global_orient, hand_pose, transl } = &fit.params;
    let vectors = [transl, global_orient].into_iter().flat_map(|v| v.to_array());
    let pose = hand_pose.iter().flat_map(|v| v.to_array());
    let rest = vectors.chain(*betas).chain(pose).map(f64::from);
    DVector::from_iterator(N_UNKNOWNS, std::iter::once(fit.scale.ln()).chain(rest))
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
