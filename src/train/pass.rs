//! One batch through the network and back.

use candle_core::backprop::GradStore;
use candle_core::{DType, Device, Tensor};

use super::batch::Batch;
use super::config::Loss;
use super::keypoints::{Heads, Points};
use super::loss::objective;
use crate::error::Result;
use crate::model::{self, EgoTac};

/// What batches are passed through.
#[derive(Debug, Clone, Copy)]
pub struct Pass<'a> {
    /// The network.
    pub network: &'a EgoTac,
    /// What is asked of it beside touch.
    pub keypoint_heads: Option<&'a Heads>,
    /// Its geometry.
    pub geometry: &'a model::Config,
    /// N per normalised unit.
    pub force_scale: f32,
    /// Weights of the objective.
    pub weights: &'a Loss,
    /// Where it is computed.
    pub device: &'a Device,
}

/// What a batch gave.
#[derive(Debug)]
pub struct Passed {
    /// The objective and its parts.
    pub losses: Losses,
    /// Gradients of the objective, scaled.
    pub gradients: GradStore,
}

/// The objective and its parts.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Losses {
    /// Weighted objective.
    pub total: f32,
    /// L_F, normalised units squared.
    pub force: f32,
    /// L_C.
    pub contact: f32,
    /// L_A, normalised units.
    pub active: f32,
    /// L_cons.
    pub consistency: f32,
    /// Cross-entropy of the keypoints' patches; 0 if its weight is.
    pub keypoint_patch: f32,
    /// Error of the keypoints' coordinates by the CLS token, shares of the picture's side; 0 as above.
    pub keypoint_cls: f32,
    /// Error of the keypoints' coordinates by the scene vector; 0 as above.
    pub keypoint_scene: f32,
}

impl Losses {
    /// Names of the parts, as columns of a log.
    pub const NAMES: [&'static str; 8] =
        ["loss", "force", "contact", "active", "consistency", "keypoint_patch", "keypoint_cls", "keypoint_scene"];

    /// The parts in the order of [`Self::NAMES`].
    pub fn values(&self) -> [f32; 8] {
        let Self { total, force, contact, active, consistency, keypoint_patch, keypoint_cls, keypoint_scene } = *self;
        [total, force, contact, active, consistency, keypoint_patch, keypoint_cls, keypoint_scene]
    }

    /// Adds `share` of each part of another.
    pub fn add(&mut self, other: &Self, share: f32) {
        let Self { total, force, contact, active, consistency, keypoint_patch, keypoint_cls, keypoint_scene } = self;
        let mine = [total, force, contact, active, consistency, keypoint_patch, keypoint_cls, keypoint_scene];
        mine.into_iter().zip(other.values()).for_each(|(sum, value)| *sum += share * value);
    }
}

impl Pass<'_> {
    /// Forward and backward; gradients are those of `share` times the objective.
    ///
    /// Each frame is encoded once; the windows share its tokens, and its gradient gathers from all of them.
    ///
    /// # Errors
    /// If the device is out of memory.
    pub fn run(&self, batch: Batch, share: f64) -> Result<Passed> {
        // On a thread of the pool: from outside each of some thousand operations would have to wake it.
        rayon::scope(|_| self.run_here(batch, share))
    }

    fn run_here(&self, mut batch: Batch, share: f64) -> Result<Passed> {
        let Self { network, geometry, .. } = self;
        let points = std::mem::take(&mut batch.points);
        let newest = newest_points(&batch, &points, geometry.horizon);
        let (images, windows, truth) = batch.to_device(geometry.image, geometry.predict, self.device)?;
        let tokens = network.encode(&images)?; // (F, P, dv)
        let projected = network.project(&tokens)?; // (F, P, d)
        let (_, p, d) = projected.dims3()?;
        let clips = projected.index_select(&windows, 0)?.reshape(((), geometry.horizon, p, d))?;
        let z = network.fuse(&clips)?;
        let (force, contact_logits) = network.heads(&z)?;
        let objective = objective(&force, &contact_logits, &truth, self.force_scale, self.weights)?;
        let keypoints = match self.keypoint_heads {
            // The heads that ask are f32 whatever the network is.
            Some(heads) => {
                Some(heads.loss(&tokens.to_dtype(DType::F32)?, &points, &z.to_dtype(DType::F32)?, &newest)?)
            }
            None => None,
        };
        let total = match &keypoints {
            Some(keypoints) => (&objective.total + (&keypoints.total * self.weights.keypoints)?)?,
            None => objective.total.clone(),
        };
        let gradients = if share == 1.0 { total.backward()? } else { (&total * share)?.backward()? };
        let scalar = |tensor: &Tensor| tensor.to_scalar::<f32>();
        let losses = Losses {
            total: scalar(&total)?,
            force: scalar(&objective.force)?,
            contact: scalar(&objective.contact)?,
            active: scalar(&objective.active)?,
            consistency: scalar(&objective.consistency)?,
            keypoint_patch: keypoints.as_ref().map_or(Ok(0.0), |loss| scalar(&loss.patch))?,
            keypoint_cls: keypoints.as_ref().map_or(Ok(0.0), |loss| scalar(&loss.cls))?,
            keypoint_scene: keypoints.as_ref().map_or(Ok(0.0), |loss| scalar(&loss.scene))?,
        };
        Ok(Passed { losses, gradients })
    }
}

/// Keypoints in the newest frame of each window.
fn newest_points(batch: &Batch, points: &[Points], horizon: usize) -> Vec<Points> {
    let newest = batch.windows.chunks_exact(horizon).map(|window| window[horizon - 1] as usize);
    newest.filter_map(|frame| points.get(frame).copied()).collect()
}
