//! Fits a hand model to keypoints and a surface by Levenberg-Marquardt least squares: shape, pose, scale and
//! translation.

use glam::{DVec3, Vec3};
use nalgebra::{DMatrix, DVector};

use super::hinges::FingerHinges;
use super::{HandModel, HandParams, N_BETAS, N_JOINTS, N_KEYPOINTS, PosedHand};

/// Number of unknowns: log scale, transl, global_orient, betas, hand_pose.
const N_UNKNOWNS: usize = 1 + 3 + 3 + N_BETAS + 3 * (N_JOINTS - 1);
/// Weight of a surface distance relative to a keypoint distance.
const SKIN_WEIGHT: f64 = 0.3;
/// Maximum number of steps; a fit that converges stops earlier, at [`MIN_GAIN`].
const MAX_STEPS: usize = 40;
/// Decrease of the squared error, m², below which the fit stops: single-precision vertices round away smaller ones.
const MIN_GAIN: f64 = 1e-9;
/// Damping above which the fit stops: no step decreases the error.
const MAX_DAMPING: f64 = 1e6;

/// Regularisation of a fit: the keypoint error, m, that a unit of each parameter costs as much as. It keeps parameters at
/// zero that the keypoints do not determine.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FitCosts {
    /// Cost of a unit of log scale. The first beta changes the size too, and is cheaper.
    scale: f64,
    /// Cost of a beta of 1.
    betas: f64,
    /// Cost of a rotation by one radian.
    pose: f64,
    /// Cost of a rotation by one radian that finger joints do not allow, such as the twist of a straight finger, which
    /// keypoints do not show.
    hinges: f64,
}

impl FitCosts {
    /// For hands of other models, whose keypoints mean slightly different places.
    pub const OTHER_MODEL: Self = Self { scale: 0.02, betas: 0.001, pose: 0.005, hinges: 0.0 };
    /// For measured keypoints of hands in any pose: bent fingers must not be pulled straight.
    pub const MEASURED: Self = Self { scale: 0.01, betas: 0.001, pose: 0.0005, hinges: 0.01 };
}

/// A hand fitted to keypoints.
#[derive(Debug, Clone)]
pub struct Fit {
    /// Shape, pose and translation.
    pub params: HandParams,
    /// Scale about the wrist joint, on top of the betas.
    pub scale: f64,
    /// Root mean square distance of the keypoints, m.
    pub residual: f64,
}

impl Fit {
    /// Poses the fitted hand, scaled about its wrist.
    pub fn posed(&self, model: &HandModel) -> PosedHand {
        let mut posed = model.forward(&self.params);
        let (wrist, scale) = (posed.joints[0], self.scale as f32);
        posed.vertices.iter_mut().chain(&mut posed.joints).for_each(|point| *point = wrist + (*point - wrist) * scale);
        posed
    }
}

/// Target of one vertex: the tangent plane of another surface at its nearest point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PlaneTarget {
    pub vertex: usize,
    /// Point on the plane, m.
    pub point: Vec3,
    pub normal: Vec3,
}

/// Fits shape, pose, scale and translation of `model` to keypoints, starting from rest.
///
/// `targets`: metres, in the order of [`HandModel::keypoints`]. Parameters that keypoints do not determine (twist,
/// girth) stay at rest.
pub(super) fn fit_keypoints(model: &HandModel, targets: &[Vec3; N_KEYPOINTS]) -> Fit {
    let rest = Fit { params: HandParams::default(), scale: 1.0, residual: f64::INFINITY };
    refine(model, &rest, targets, &[], FitCosts::OTHER_MODEL)
}

/// Continues a fit with surface targets as well.
pub(crate) fn refine(
    model: &HandModel,
    start: &Fit,
    targets: &[Vec3; N_KEYPOINTS],
    planes: &[PlaneTarget],
    costs: FitCosts,
) -> Fit {
    // Pose blend shapes move tips by less than the regularisation does, and take most of the time.
    let plain = HandModel { posedirs: Vec::new(), ..model.clone() };
    let hinges = (costs.hinges > 0.0).then(|| FingerHinges::of(model));
    let problem = FitProblem { model: &plain, keypoints: targets, planes, costs, hinges };
    let mut unknowns = packed(start);
    let mut residuals = problem.residuals(&unknowns);
    let mut damping = 1e-3;
    for _ in 0..MAX_STEPS {
        let jacobian = problem.jacobian(&unknowns);
        let normal = jacobian.transpose() * &jacobian;
        let gradient = jacobian.transpose() * &residuals;
        let damped = &normal + DMatrix::from_diagonal(&normal.diagonal().map(|entry| damping * entry + 1e-12));
        let Some(step) = damped.cholesky().map(|damped| damped.solve(&gradient)) else { break };
        let next = &unknowns - &step;
        let next_residuals = problem.residuals(&next);
        let gain = residuals.norm_squared() - next_residuals.norm_squared();
        if gain > 0.0 {
            (unknowns, residuals) = (next, next_residuals);
            damping = (damping * 0.3).max(1e-9);
            if gain < MIN_GAIN {
                break;
            }
        } else {
            damping *= 8.0;
            if damping > MAX_DAMPING {
                break;
            }
        }
    }
    let keypoints = residuals.rows(0, 3 * N_KEYPOINTS).norm_squared();
    let (params, scale) = unpacked(&unknowns);
    Fit { params, scale, residual: (keypoints / N_KEYPOINTS as f64).sqrt() }
}

/// Residuals that the fit minimises.
struct FitProblem<'a> {
    model: &'a HandModel,
    keypoints: &'a [Vec3; N_KEYPOINTS],
    planes: &'a [PlaneTarget],
    costs: FitCosts,
    /// Axes of the finger joints; `None` = all rotations are allowed.
    hinges: Option<FingerHinges>,
}

impl FitProblem<'_> {
    /// Computes keypoint errors, regularisation terms, weighted distances from the planes, then rotations off the hinges, m.
    fn residuals(&self, unknowns: &DVector<f64>) -> DVector<f64> {
        let (params, scale) = unpacked(unknowns);
        let posed = Fit { params, scale, residual: 0.0 }.posed(self.model);
        let keypoints = self.model.keypoints(&posed);
        let errors = keypoints.iter().zip(self.keypoints);
        let errors = errors.flat_map(|(point, target)| (*point - *target).as_dvec3().to_array());
        let cost = |k: usize| match k {
            0 => self.costs.scale,
            1..7 => 0.0,
            7..17 => self.costs.betas,
            _ => self.costs.pose,
        };
        let costs = unknowns.iter().enumerate().map(|(k, value)| value * cost(k));
        let distance = |plane: &PlaneTarget| {
            f64::from((posed.vertices[plane.vertex] - plane.point).dot(plane.normal)) * SKIN_WEIGHT
        };
        let distances = self.planes.iter().map(distance);
        let pose = std::array::from_fn(|joint| {
            let at = 7 + N_BETAS + 3 * joint;
            DVec3::new(unknowns[at], unknowns[at + 1], unknowns[at + 2])
        });
        let off_axis = self.hinges.as_ref().map_or_else(Vec::new, |hinges| hinges.residuals(&pose));
        let count = 3 * N_KEYPOINTS + N_UNKNOWNS + self.planes.len() + off_axis.len();
        let off_axis = off_axis.into_iter().map(|angle| angle * self.costs.hinges);
        DVector::from_iterator(count, errors.chain(costs).chain(distances).chain(off_axis))
    }

    /// Computes the Jacobian by central differences; a step of 1e-3 is far above the rounding of single-precision
    /// vertices.
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
    fn fit_recovers_a_posed_scaled_hand() {
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
        // Keypoints do not determine girth and twist.
        assert!(mean < 0.004, "{mean} m");
    }
}
