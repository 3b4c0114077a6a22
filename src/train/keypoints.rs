//! Auxiliary task: predicting the hands' keypoints in the image, so that a small encoder learns faster.
//!
//! Touch alone is a weak signal for an encoder: 1556 numbers that are mostly zero. With random initial weights, a network
//! learns to see the hands sooner if it must also locate their keypoints. The patch tokens predict which patch contains each
//! keypoint (one softmax over the patches per keypoint, with cross-entropy); the CLS token and the scene vector predict the
//! keypoints' coordinates (mean absolute error). The three linear heads are not part of the network. At the end of a run the
//! patch head is the start of the estimate of presence and keypoints that the checkpoint gets ([`super::presence`]).

use std::ops::Range;

use candle_core::{D, Device, Tensor};
use candle_nn::{Init, VarBuilder};
use egotac_kernels::ops;
use glam::{DQuat, DVec3};
use rayon::prelude::*;

use crate::camera::Intrinsics;
use crate::dataset::EpisodeReader;
use crate::dataset::zarr::{CAMERA_POSE, LEFT_HAND_POSE, OBJECT_POSE, RIGHT_HAND_POSE, ZarrReader};
use crate::error::{Error, Result};
use crate::hand::{HandModel, HandParams, N_KEYPOINTS, Side, Topology};
use crate::image::Preparation;
use crate::model::Config;
use crate::model::init::STD;

use super::augment::Augmentation;
use super::loss::{SupervisedCounts, masked_mean};

/// Points per frame: the keypoints of the left hand, of the right hand, and the first object's origin.
pub const N_POINTS: usize = 2 * N_KEYPOINTS + 1;

/// Weight of the coordinate errors (shares of the image's side) relative to the cross-entropy of the patches (nats).
const COORDINATE_WEIGHT: f64 = 10.0;

/// Positions of the points of one frame, as shares of the input's sides, x to the right, y down; NaN = unknown, infinite = known
/// not to be in the image.
pub type Points = [[f32; 2]; N_POINTS];

/// Arrays that the points are computed from.
const NEEDED: [&str; 3] = [CAMERA_POSE, LEFT_HAND_POSE, RIGHT_HAND_POSE];

/// True if a store says where the keypoints of the hands are, or that a hand is absent: it is of the built-in hand, and has
/// poses of camera and hands.
pub fn has_poses(reader: &ZarrReader) -> bool {
    reader.attributes().topology == Topology::EgotacHand1 && NEEDED.iter().all(|name| reader.has(name))
}

/// Projects the points of a range of frames. All are NaN in a store without camera and hand poses, or of another hand than
/// the built-in one.
///
/// # Errors
/// If an array can't be read.
pub fn read(reader: &ZarrReader, frames: Range<usize>, preparation: &Preparation) -> Result<Vec<Points>> {
    let unknown = [[f32::NAN; 2]; N_POINTS];
    if !has_poses(reader) {
        return Ok(vec![unknown; frames.len()]);
    }
    for array in reader.arrays().iter().filter(|array| array.name == CAMERA_POSE) {
        if !matches!(array.shape[..], [_, 7]) {
            return Err(Error::file(reader.path(), Error::shape(CAMERA_POSE, "(T, 7)", &array.shape)));
        }
    }
    let [cameras, left, right] = NEEDED.map(|name| reader.read_f32(name, frames.clone()));
    let (cameras, hands) = (cameras?, [left?, right?]);
    let objects = if reader.has(OBJECT_POSE) { reader.read_f32(OBJECT_POSE, frames.clone())? } else { Vec::new() };
    let models = Side::BOTH.map(HandModel::builtin);
    let (height, width) = reader.image_size();
    let of = |(row, frame): (usize, usize)| {
        let mut points = unknown;
        let episode = reader.episode_ends().partition_point(|end| *end <= frame);
        let Some(camera) = Camera::read(reader, episode, &cameras[7 * row..7 * row + 7]) else { return points };
        let place = |world: DVec3| match camera.project(world) {
            Some(pixel) => preparation.place(pixel, width, height).map(|share| share as f32),
            None if world.is_nan() || camera.position.is_nan() => [f32::NAN; 2],
            None => [f32::INFINITY; 2],
        };
        for (hand, (poses, model)) in hands.iter().zip(&models).enumerate() {
            let pose: [f32; 61] = std::array::from_fn(|i| poses[61 * row + i]);
            if pose.iter().any(|x| *x != 0.0) {
                let posed = model.forward(&HandParams::from_array(&pose));
                for (k, point) in model.keypoints(&posed).iter().enumerate() {
                    points[hand * N_KEYPOINTS + k] = place(point.as_dvec3());
                }
            } else {
                points[hand * N_KEYPOINTS..(hand + 1) * N_KEYPOINTS].fill([f32::INFINITY; 2]);
            }
        }
        if let Some([x, y, z, ..]) = objects.get(row * objects.len() / frames.len()..) {
            points[2 * N_KEYPOINTS] = place(DVec3::new(f64::from(*x), f64::from(*y), f64::from(*z)));
        }
        points
    };
    Ok(frames.clone().enumerate().collect::<Vec<_>>().into_par_iter().map(of).collect())
}

/// Returns the points of an augmented image; in a mirrored image the two hands swap.
pub(super) fn augmented(points: Points, augmentation: &Augmentation) -> Points {
    let mut places = points.map(|place| augmentation.place(place));
    if augmentation.mirrored {
        let (left, rest) = places.split_at_mut(N_KEYPOINTS);
        left.swap_with_slice(&mut rest[..N_KEYPOINTS]);
    }
    places
}

/// Camera pose and intrinsics.
struct Camera {
    position: DVec3,
    /// Rotation from the optical frame (x right, y down, z forward) to the world.
    orientation: DQuat,
    intrinsics: Intrinsics,
}

impl Camera {
    /// Reads a pose (position, quaternion w x y z) and the intrinsics of an episode from the store's attributes.
    fn read(reader: &ZarrReader, episode: usize, pose: &[f32]) -> Option<Self> {
        let intrinsics = reader.raw_attributes().get("episodes")?.get(episode)?.get("intrinsics")?;
        let p: [f64; 7] = std::array::from_fn(|i| f64::from(pose[i]));
        Some(Self {
            position: DVec3::new(p[0], p[1], p[2]),
            orientation: DQuat::from_xyzw(p[4], p[5], p[6], p[3]),
            intrinsics: serde_json::from_value(intrinsics.clone()).ok()?,
        })
    }

    /// Returns the pixel of a point; None if the camera does not see it.
    fn project(&self, world: DVec3) -> Option<[f64; 2]> {
        self.intrinsics.project(self.orientation.inverse() * (world - self.position))
    }
}

/// Returns the row-major index of the patch that contains a position; None if it is unknown or outside of the image.
pub fn patch(place: [f32; 2], grid: usize) -> Option<usize> {
    let inside = |share: f32| (0.0..1.0).contains(&share).then(|| ((share * grid as f32) as usize).min(grid - 1));
    Some(inside(place[1])? * grid + inside(place[0])?)
}

/// Linear heads of the task: weight and bias of each.
#[derive(Debug, Clone)]
pub struct Heads {
    patch: (Tensor, Tensor), // (43, dv), (43)
    cls: (Tensor, Tensor),   // (86, dv), (86)
    scene: (Tensor, Tensor), // (86, d), (86)
}

/// Losses of the task, scalars.
#[derive(Debug, Clone)]
pub struct KeypointLoss {
    /// Weighted sum of the three terms.
    pub total: Tensor,
    /// Mean cross-entropy of the patches of all points in the image.
    pub patch: Tensor,
    /// Mean absolute error of the coordinates predicted from the CLS token, as a share of the image's side.
    pub cls: Tensor,
    /// Mean absolute error of the coordinates in the newest frame, predicted from the scene vector.
    pub scene: Tensor,
}

impl Heads {
    /// Creates the heads from the tensors `patch.weight`, `patch.bias`, and so on for `cls` and `scene`.
    ///
    /// # Errors
    /// If they have another shape.
    pub fn new(config: &Config, vb: VarBuilder) -> Result<Self> {
        let linear = |name: &str, n: usize, k: usize| -> Result<(Tensor, Tensor)> {
            let (vb, normal) = (vb.pp(name), Init::Randn { mean: 0.0, stdev: STD });
            // Initial coordinates 0.5: the centre of the image.
            Ok((vb.get_with_hints((n, k), "weight", normal)?, vb.get_with_hints(n, "bias", Init::Const(0.5))?))
        };
        Ok(Self {
            patch: linear("patch", N_POINTS, config.vision_width)?,
            cls: linear("cls", 2 * N_POINTS, config.vision_width)?,
            scene: linear("scene", 2 * N_POINTS, config.width)?,
        })
    }

    /// Returns weight and bias of the patch logits of the hands' keypoints, (42, dv) and (42), detached, on the CPU.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn hand_logits(&self) -> Result<(Tensor, Tensor)> {
        let of = |tensor: &Tensor| tensor.narrow(0, 0, 2 * N_KEYPOINTS)?.detach().to_device(&Device::Cpu)?.copy();
        Ok((of(&self.patch.0)?, of(&self.patch.1)?))
    }

    /// Computes the losses; 0 if no point is known.
    ///
    /// `tokens`: `(F, P, dv)`, CLS first, and `points` of the F frames. `z`: `(B, d)`, and `newest`: points of the newest
    /// frames of the B windows. `counts`: points in the image, of all ranks.
    ///
    /// # Errors
    /// If shapes don't fit.
    pub fn loss(
        &self,
        tokens: &Tensor,
        points: &[Points],
        z: &Tensor,
        newest: &[Points],
        counts: &SupervisedCounts,
    ) -> Result<KeypointLoss> {
        let cls_tokens = tokens.narrow(1, 0, 1)?.squeeze(1)?.contiguous()?;
        let patch = patch_loss(tokens, points, &self.patch, counts.points)?;
        let cls = coordinate_loss(&cls_tokens, points, &self.cls, counts.points)?;
        let scene = coordinate_loss(z, newest, &self.scene, counts.newest_points)?;
        let total = ((&patch + (&cls * COORDINATE_WEIGHT)?)? + (&scene * COORDINATE_WEIGHT)?)?;
        Ok(KeypointLoss { total, patch, cls, scene })
    }
}

/// Computes the cross-entropy of the patch that contains each point. `tokens`: `(F, P, dv)`.
fn patch_loss(tokens: &Tensor, points: &[Points], (weight, bias): &(Tensor, Tensor), count: f64) -> Result<Tensor> {
    let (frames, tokens_per_frame, _) = tokens.dims3()?;
    check_count(points, frames)?;
    let n_patches = tokens_per_frame - 1;
    let logits = ops::linear(&tokens.narrow(1, 1, n_patches)?.contiguous()?, weight, bias)?;
    let log_shares = candle_nn::ops::log_softmax(&logits.transpose(1, 2)?.contiguous()?, D::Minus1)?;
    let grid = n_patches.isqrt();
    let mut right = vec![0f32; frames * N_POINTS * n_patches];
    for (row, place) in right.chunks_exact_mut(n_patches).zip(points.iter().flatten()) {
        if let Some(patch) = patch(*place, grid) {
            row[patch] = -1.0;
        }
    }
    let right = Tensor::from_vec(right, (frames, N_POINTS, n_patches), tokens.device())?;
    Ok(((log_shares * right)?.sum_all()? / count.max(1.0))?)
}

/// Computes the mean absolute error of the coordinates of all points in the image. `x`: `(B, k)`.
fn coordinate_loss(x: &Tensor, points: &[Points], (weight, bias): &(Tensor, Tensor), count: f64) -> Result<Tensor> {
    let b = x.dim(0)?;
    check_count(points, b)?;
    let coordinates = ops::linear(x, weight, bias)?; // (B, 86)
    let known = |place: &[f32; 2]| patch(*place, 1).is_some();
    let places = || points.iter().flatten();
    let mask: Vec<f32> = places().flat_map(|place| [f32::from(u8::from(known(place))); 2]).collect();
    let truth: Vec<f32> = places().flat_map(|place| if known(place) { *place } else { [0.0; 2] }).collect();
    let [mask, truth] = [mask, truth].map(|values| Tensor::from_vec(values, (b, 2 * N_POINTS), x.device()));
    masked_mean(&(coordinates - truth?)?.abs()?, &mask?, 2.0 * count)
}

/// Returns the number of points that are in the image.
pub fn in_image(points: &[Points]) -> usize {
    points.iter().flatten().filter(|place| patch(**place, 1).is_some()).count()
}

fn check_count(points: &[Points], expected: usize) -> Result<()> {
    match points.len() == expected {
        true => Ok(()),
        false => Err(Error::shape("points", format!("({expected}, {N_POINTS}, 2)"), [points.len(), N_POINTS, 2])),
    }
}
