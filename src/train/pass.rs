//! Forward and backward pass of one batch, and the mean gradient of a step's batches, on one rank.

use std::time::Instant;

use candle_core::backprop::GradStore;
use candle_core::{DType, Device, Tensor};
use candle_nn::VarMap;
use egotac_kernels::ops;

use super::batch::Batch;
use super::config::{Config, LossWeights};
use super::fixed_encoder::FixedEncoder;
use super::keypoints::{self, Heads, Points};
use super::loader::Loader;
use super::loss::{SupervisedCounts, objective_of_share};
use super::optimizer::AdamW;
use super::ranks::Communicator;
use crate::error::Result;
use crate::model::{self, EgoTac, Precision};

/// Network and objective that batches are passed through.
#[derive(Clone, Copy)]
pub struct Pass<'a> {
    /// The network.
    pub network: &'a EgoTac,
    /// Its weights and those of the keypoint heads, which a pass in bf16 rounds on a GPU.
    pub variables: &'a VarMap,
    /// Encodes the frames if the encoder does not learn; without it, the encoder of `network` learns.
    pub fixed_encoder: Option<&'a FixedEncoder>,
    /// Heads of the auxiliary keypoint task.
    pub keypoint_heads: Option<&'a Heads>,
    /// Geometry of the network.
    pub geometry: &'a model::Config,
    /// N per normalised unit.
    pub force_scale: f32,
    /// Weights of the objective.
    pub weights: &'a LossWeights,
    /// Device that the pass runs on.
    pub device: &'a Device,
}

/// Result of a forward and backward pass.
#[derive(Debug)]
pub struct PassOutput {
    /// The objective and its terms.
    pub losses: Losses,
    /// Gradients of the scaled objective.
    pub gradients: GradStore,
}

/// This rank's share of the mean over the batches of one step; the shares of all ranks add up to the mean.
#[derive(Debug, Default)]
pub struct Accumulated {
    /// Mean gradient; None if the rank has no clip in any of the batches.
    pub gradients: Option<GradStore>,
    /// Mean of the objective and its terms.
    pub losses: Losses,
    /// Observation windows of all batches.
    pub windows: usize,
    /// Frames of all batches.
    pub frames: usize,
    /// Time spent waiting for batches, s.
    pub wait_secs: f64,
    /// Time spent in messages to the other ranks, or waiting for them, s.
    pub exchange_secs: f64,
}

/// The objective and its terms.
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
    /// Cross-entropy of the keypoints' patches; 0 if the weight of the keypoint task is 0.
    pub keypoint_patch: f32,
    /// Error of the keypoints' coordinates predicted from the CLS token, as a share of the image's side; 0 likewise.
    pub keypoint_cls: f32,
    /// Error of the keypoints' coordinates predicted from the scene vector, as a share of the image's side; 0 likewise.
    pub keypoint_scene: f32,
}

impl Losses {
    /// Names of the terms, as columns of the log.
    pub const NAMES: [&'static str; 8] =
        ["loss", "force", "contact", "active", "consistency", "keypoint_patch", "keypoint_cls", "keypoint_scene"];

    /// Returns the terms in the order of [`Self::NAMES`].
    pub fn values(&self) -> [f32; 8] {
        let Self { total, force, contact, active, consistency, keypoint_patch, keypoint_cls, keypoint_scene } = *self;
        [total, force, contact, active, consistency, keypoint_patch, keypoint_cls, keypoint_scene]
    }

    /// Creates losses from the terms in the order of [`Self::NAMES`].
    pub fn from_values(values: [f32; 8]) -> Self {
        let [total, force, contact, active, consistency, keypoint_patch, keypoint_cls, keypoint_scene] = values;
        Self { total, force, contact, active, consistency, keypoint_patch, keypoint_cls, keypoint_scene }
    }

    /// Adds `share` times each term of `other`.
    pub fn add(&mut self, other: &Self, share: f32) {
        let Self { total, force, contact, active, consistency, keypoint_patch, keypoint_cls, keypoint_scene } = self;
        let mine = [total, force, contact, active, consistency, keypoint_patch, keypoint_cls, keypoint_scene];
        mine.into_iter().zip(other.values()).for_each(|(sum, value)| *sum += share * value);
    }
}

impl Accumulated {
    /// Replaces this rank's shares by the sums over all ranks; times stay its own. Returns the bytes that this rank sends.
    ///
    /// `sum` replaces its argument, and the gradients, by the sums over all ranks, and returns the bytes that this rank sends.
    ///
    /// # Errors
    /// If `sum` fails.
    pub fn add_over(&mut self, sum: impl FnOnce(&mut [f64]) -> Result<usize>) -> Result<usize> {
        let exchanging = Instant::now();
        let mut scalars: Vec<f64> = self.losses.values().iter().map(|loss| f64::from(*loss)).collect();
        scalars.extend([self.windows as f64, self.frames as f64]);
        let bytes = sum(&mut scalars)?;
        self.losses = Losses::from_values(std::array::from_fn(|i| scalars[i] as f32));
        [self.windows, self.frames] = [8, 9].map(|i| scalars[i] as usize);
        self.exchange_secs += exchanging.elapsed().as_secs_f64();
        Ok(bytes)
    }
}

impl Pass<'_> {
    /// Takes the batches of one step from `loader` and returns this rank's share of their mean gradient.
    ///
    /// # Errors
    /// If a batch can't be made, the device is out of memory, or another rank has failed.
    pub fn accumulate(
        &self,
        ranks: &dyn Communicator,
        loader: &mut Loader,
        optimizer: &AdamW,
        config: &Config,
    ) -> Result<Accumulated> {
        let mut sum = Accumulated::default();
        let share = 1.0 / config.batch.accumulate as f64;
        for _ in 0..config.batch.accumulate {
            let waiting = Instant::now();
            let batch = loader.next()?;
            sum.wait_secs += waiting.elapsed().as_secs_f64();
            sum.frames += batch.n_frames(self.geometry.image);
            sum.windows += batch.windows.len() / self.geometry.horizon;
            let exchanging = Instant::now();
            let mut counts = self.counts(&batch).values();
            ranks.sum_f64(&mut counts)?;
            let counts = SupervisedCounts::from_values(counts);
            sum.exchange_secs += exchanging.elapsed().as_secs_f64();
            if batch.windows.is_empty() {
                continue;
            }
            let PassOutput { losses, gradients } = self.run_share(batch, &counts, share, config.precision)?;
            sum.losses.add(&losses, share as f32);
            optimizer.gather(&mut sum.gradients, gradients)?;
        }
        Ok(sum)
    }

    /// Runs forward and backward in `precision`; the gradients are those of `share` times the objective.
    ///
    /// Each frame is encoded once: the windows share its tokens, and its gradient is the sum over them.
    ///
    /// # Errors
    /// If the device is out of memory.
    pub fn run(&self, batch: Batch, share: f64, precision: Precision) -> Result<PassOutput> {
        let counts = self.counts(&batch);
        self.run_share(batch, &counts, share, precision)
    }

    /// Counts the supervised entries of a batch.
    fn counts(&self, batch: &Batch) -> SupervisedCounts {
        let Batch { force, mask_force, mask_contact, points, .. } = batch;
        let newest = newest_points(batch, points, self.geometry.horizon);
        let [points, newest_points] = [points, &newest].map(|points| keypoints::in_image(points) as f64);
        SupervisedCounts {
            points,
            newest_points,
            ..SupervisedCounts::of(force, mask_force, mask_contact, self.force_scale)
        }
    }

    /// As [`Pass::run`], on a part of a batch that has `counts` in all.
    fn run_share(
        &self,
        batch: Batch,
        counts: &SupervisedCounts,
        share: f64,
        precision: Precision,
    ) -> Result<PassOutput> {
        // On a thread of the rayon pool: from another thread, each of some thousand operations would wake the pool.
        rayon::scope(|_| match precision {
            // On a CPU only products gain from bf16.
            Precision::Bf16 if self.device.is_cpu() => ops::in_bf16(|| self.run_here(batch, counts, share)),
            Precision::Bf16 => {
                // A new cast for each batch, because a step changes the f32 weights.
                let vb = model::init::cast_builder(self.variables, DType::BF16, self.device);
                let network = EgoTac::new(self.geometry, vb)?;
                Pass { network: &network, ..*self }.run_here(batch, counts, share)
            }
            _ => self.run_here(batch, counts, share),
        })
    }

    fn run_here(&self, mut batch: Batch, counts: &SupervisedCounts, share: f64) -> Result<PassOutput> {
        let Self { network, geometry, .. } = self;
        let (points, keys) = (std::mem::take(&mut batch.points), std::mem::take(&mut batch.keys));
        let newest = newest_points(&batch, &points, geometry.horizon);
        let (images, windows, truth) = batch.to_device(geometry.image, geometry.predict, self.device)?;
        let tokens = match self.fixed_encoder {
            Some(fixed) => fixed.encode(&images, &keys)?,
            None => network.encode(&images)?,
        }; // (F, P, dv)
        let projected = network.project(&tokens)?; // (F, P, d)
        let (_, p, d) = projected.dims3()?;
        let clips = projected.index_select(&windows, 0)?.reshape(((), geometry.horizon, p, d))?;
        let z = network.fuse(&clips)?;
        let (force, contact_logits) = network.heads(&z)?;
        let objective = objective_of_share(&force, &contact_logits, &truth, self.force_scale, self.weights, counts)?;
        let keypoints = match self.keypoint_heads {
            // The keypoint heads are f32 even where the network is bf16.
            Some(heads) => {
                let (tokens, z) = (tokens.to_dtype(DType::F32)?, z.to_dtype(DType::F32)?);
                Some(heads.loss(&tokens, &points, &z, &newest, counts)?)
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
        Ok(PassOutput { losses, gradients })
    }
}

/// Returns the keypoints in the newest frame of each window.
fn newest_points(batch: &Batch, points: &[Points], horizon: usize) -> Vec<Points> {
    let newest = batch.windows.chunks_exact(horizon).map(|window| window[horizon - 1] as usize);
    newest.filter_map(|frame| points.get(frame).copied()).collect()
}
