//! Hand models that pose recorded hands: the user's MANO files, or the built-in hand as an approximation.

use std::borrow::Cow;
use std::path::Path;

use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};

use super::recording::{Convention, ManoParams, PoseParams, RecordedHand, Recording, Translation};
use crate::error::{Error, Result};
use crate::file::{self, input, limits};
use crate::hand::{
    Fit, FitCosts, HandModel, HandParams, N_BETAS, N_KEYPOINTS, N_VERTICES, PoseBasis, Side, Topology, refine,
};

/// Position of MANO's wrist at rest, m, of the right hand; x is negated for the left hand. The built-in hand has its wrist
/// elsewhere, and translations of data sets refer to MANO's.
const MANO_WRIST: Vec3 = Vec3::new(0.096, 0.006, 0.006);
/// Sum of the differences in x between the `shapedirs` of both hands, m, below which the left hand has the published sign.
const SAME_SIGN: f32 = 1.0;
/// Largest number of optimiser runs for one hand: each run has a limited number of steps.
const MAX_FITS: usize = 4;
/// Ratio of residuals above which another run of the optimiser is not worth its time.
const CONVERGED: f64 = 0.95;

/// Models of both hands.
#[derive(Debug, Clone)]
pub struct HandModels {
    /// Left and right hand as filed.
    models: [HandModel; 2],
    /// The left hand with the other sign of x in its `shapedirs`.
    left_fixed: HandModel,
    /// Bases of both hands' poses; `None` for the built-in hand.
    bases: Option<[PoseBasis; 2]>,
    /// SHA-256 of the files, left first; empty for the built-in hand.
    sha256: Vec<String>,
}

/// A hand posed in the reference frame of its recording.
#[derive(Debug, Clone)]
pub struct PosedRecord {
    /// (778) vertices, m.
    pub vertices: Vec<Vec3>,
    /// MANO parameters, flat mean; of a hand fitted to keypoints, without the fit's scale.
    pub params: HandParams,
}

impl HandModels {
    /// Loads MANO files, or takes the built-in hand if there are none.
    ///
    /// # Errors
    /// If only one file is given, or one can't be read.
    pub fn load(left: Option<&Path>, right: Option<&Path>) -> Result<Self> {
        let (Some(left), Some(right)) = (left, right) else {
            if left.is_some() || right.is_some() {
                return Err(Error::value("MANO files", "--mano-left and --mano-right, or neither", "one of them"));
            }
            let models = Side::BOTH.map(HandModel::builtin);
            let left_fixed = models[0].clone();
            return Ok(Self { models, left_fixed, bases: None, sha256: Vec::new() });
        };
        let models = [HandModel::load(left, Side::Left)?, HandModel::load(right, Side::Right)?];
        let mut left_fixed = models[0].clone();
        let x = |model: &HandModel| -> Vec<f32> {
            model.shapedirs.chunks_exact(30).flat_map(|rows| rows[..10].iter().copied()).collect()
        };
        let difference: f32 = x(&models[0]).iter().zip(x(&models[1])).map(|(left, right)| (left - right).abs()).sum();
        if difference < SAME_SIGN {
            left_fixed.fix_left_shapedirs();
        }
        let bases = Some([PoseBasis::load(left)?, PoseBasis::load(right)?]);
        let sha256 = [left, right].map(|path| Ok(file::sha256(&input::read(path, limits::FILE)?)));
        Ok(Self { models, left_fixed, bases, sha256: sha256.into_iter().collect::<Result<_>>()? })
    }

    /// True if these are MANO files.
    pub fn are_mano(&self) -> bool {
        self.bases.is_some()
    }

    /// Returns the vertex numbering.
    pub fn topology(&self) -> Topology {
        self.models[0].topology
    }

    /// Returns the SHA-256 of both MANO files, left first; empty for the built-in hand.
    pub fn sha256(&self) -> &[String] {
        &self.sha256
    }

    /// Poses a recorded hand. `before` is the fit of the same hand at the previous instant, from which a fit to keypoints
    /// starts; the fit of this instant replaces it.
    ///
    /// # Errors
    /// If the parameters need MANO's pose basis and there is none, or the pose is not finite.
    pub fn pose(
        &self,
        side: Side,
        hand: &RecordedHand,
        convention: Convention,
        before: &mut Option<Fit>,
    ) -> Result<PosedRecord> {
        let model = self.model(side, convention);
        let posed = match hand {
            RecordedHand::Either(params, _) if self.are_mano() => {
                let params = self.params(side, params, convention)?;
                PosedRecord { vertices: model.forward(&params).vertices, params }
            }
            RecordedHand::Mano(params) => {
                let params = self.params(side, params, convention)?;
                PosedRecord { vertices: model.forward(&params).vertices, params }
            }
            RecordedHand::Placed(params, motion) => {
                let params = self.params(side, params, convention)?;
                let params = self.moved(side, &params, convention, *motion);
                PosedRecord { vertices: model.forward(&params).vertices, params }
            }
            RecordedHand::Vertices(params, vertices) => {
                PosedRecord { params: self.params(side, params, convention)?, vertices: vertices.clone() }
            }
            RecordedHand::Keypoints(keypoints)
            | RecordedHand::Either(_, keypoints)
            | RecordedHand::Mesh(_, keypoints) => {
                let fit = fitted(model, keypoints, before.take());
                // Without MANO files, vertices have the built-in hand's order.
                let vertices = match hand {
                    RecordedHand::Mesh(vertices, _) if self.are_mano() => vertices.clone(),
                    _ => fit.posed(model).vertices,
                };
                let record = PosedRecord { vertices, params: fit.params.clone() };
                *before = Some(fit);
                record
            }
        };
        match posed.vertices.iter().all(|vertex| vertex.is_finite()) {
            true => Ok(posed),
            false => {
                Err(Error::value(format!("pose of the {} hand", side.name()), "finite numbers", "NaN or infinity"))
            }
        }
    }

    /// Moves parameters from one frame into another: `to_from` maps the frame of `params` to the new one.
    pub fn moved(&self, side: Side, params: &HandParams, convention: Convention, to_from: DAffine3) -> HandParams {
        let model = self.model(side, convention);
        let rotation = DQuat::from_mat3(&to_from.matrix3);
        let orient = rotation * DQuat::from_scaled_axis(params.global_orient.as_dvec3());
        let wrist = model.joints(params)[0].as_dvec3();
        let rest = wrist - params.transl.as_dvec3();
        let transl = to_from.transform_point3(wrist) - rest;
        HandParams { global_orient: orient.to_scaled_axis().as_vec3(), transl: transl.as_vec3(), ..params.clone() }
    }

    /// Returns the models of a recording: with its hands' scanned shapes, if it has some and these are MANO files.
    ///
    /// # Errors
    /// If a scanned hand has another number of vertices.
    pub fn of(&self, recording: &Recording) -> Result<Cow<'_, Self>> {
        if !self.are_mano() || recording.templates.iter().all(Option::is_none) {
            return Ok(Cow::Borrowed(self));
        }
        let mut models = self.clone();
        for (side, template) in Side::BOTH.into_iter().zip(&recording.templates) {
            let Some(template) = template else { continue };
            if template.len() != N_VERTICES {
                let name = format!("{}: scanned {} hand", recording.name, side.name());
                return Err(Error::value(name, format!("{N_VERTICES} vertices"), template.len()));
            }
            models.models[side as usize].v_template = template.to_vec();
            if side == Side::Left {
                models.left_fixed.v_template = template.to_vec();
            }
        }
        Ok(Cow::Owned(models))
    }

    /// Returns the model of a hand under a data set's convention.
    pub fn model(&self, side: Side, convention: Convention) -> &HandModel {
        match side {
            Side::Left if convention.fixes_left_shapedirs => &self.left_fixed,
            _ => &self.models[side as usize],
        }
    }

    /// Converts recorded parameters to full axis-angle with flat mean and translation after rotation.
    fn params(&self, side: Side, recorded: &ManoParams, convention: Convention) -> Result<HandParams> {
        let basis = || {
            let bases = self.bases.as_ref().ok_or_else(|| {
                let expected = "MANO's pose basis, which the files of --mano-left and --mano-right have";
                Error::value(format!("pose of the {} hand", side.name()), expected, "none")
            })?;
            Ok::<_, Error>(&bases[side as usize])
        };
        let hand_pose = match &recorded.hand_pose {
            PoseParams::Coefficients(coefficients) if convention.adds_mean => basis()?.pose(coefficients)?,
            PoseParams::Coefficients(coefficients) => {
                let (pose, mean) = (basis()?.pose(coefficients)?, basis()?.mean());
                std::array::from_fn(|joint| pose[joint] - mean[joint])
            }
            PoseParams::AxisAngle(rotations) if convention.adds_mean => {
                let mean = basis()?.mean();
                std::array::from_fn(|joint| rotations[joint] + mean[joint])
            }
            PoseParams::AxisAngle(rotations) => *rotations,
        };
        let ManoParams { betas, global_orient, transl, .. } = recorded.clone();
        let mut params = HandParams { betas, global_orient, hand_pose, transl };
        if !self.are_mano() {
            // The built-in hand's betas mean other shapes.
            params.betas = [0.0; N_BETAS];
        }
        let rest = self.model(side, convention).joints(&HandParams { betas: params.betas, ..HandParams::default() })[0];
        match (convention.translation, self.are_mano()) {
            (Translation::OfWrist, _) => params.transl -= rest,
            (Translation::AfterRotation, true) => {}
            (Translation::AfterRotation, false) => {
                let mirror = Vec3::new(if side == Side::Left { -1.0 } else { 1.0 }, 1.0, 1.0);
                params.transl += MANO_WRIST * mirror - rest;
            }
        }
        Ok(params)
    }
}

/// Fits a hand to keypoints, m. A fit starts upright at the keypoints' wrist, because the optimiser turns a hand by small
/// steps alone.
fn fitted(model: &HandModel, keypoints: &[Vec3; N_KEYPOINTS], before: Option<Fit>) -> Fit {
    let start = before.unwrap_or_else(|| {
        let rest = model.forward(&HandParams::default());
        let rotation = frame(keypoints) * frame(&model.keypoints(&rest)).transpose();
        let params = HandParams {
            global_orient: DQuat::from_mat3(&rotation).to_scaled_axis().as_vec3(),
            transl: keypoints[0] - rest.joints[0],
            ..HandParams::default()
        };
        Fit { params, scale: 1.0, residual: f64::INFINITY }
    });
    let mut fit = refine(model, &start, keypoints, &[], FitCosts::MEASURED);
    for _ in 1..MAX_FITS {
        let next = refine(model, &fit, keypoints, &[], FitCosts::MEASURED);
        let converged = next.residual > CONVERGED * fit.residual;
        fit = next;
        if converged {
            break;
        }
    }
    fit
}

/// Returns the axes of a palm: towards the middle finger, across towards the index finger, and their normal.
fn frame(keypoints: &[Vec3; N_KEYPOINTS]) -> DMat3 {
    const INDEX: usize = 5;
    const MIDDLE: usize = 9;
    const LITTLE: usize = 17;
    let at = |keypoint: usize| keypoints[keypoint].as_dvec3();
    let along = (at(MIDDLE) - at(0)).try_normalize().unwrap_or(DVec3::X);
    let across = at(INDEX) - at(LITTLE);
    let across = (across - along * across.dot(along)).try_normalize().unwrap_or_else(|| along.any_orthonormal_vector());
    DMat3::from_cols(along, across, along.cross(across))
}
