//! The EgoTac network: images to force and contact on both hands.
//!
//! Shapes: B batch, T observation horizon, K tactile steps, P vision tokens per frame (CLS first), dv width of the
//! vision encoder, d width of the rest, 1556 = 2 x 778 vertices, left hand first.
//!
//! [`EgoTac::new`] on a [`init::var_builder`] gives a network to train; [`Checkpoint::load`] gives one to run, and
//! [`predictor::Predictor`] runs it on a stream of images.

mod attention;
pub mod checkpoint;
pub mod config;
mod decoder;
mod dinov2;
pub mod init;
pub mod ops;
pub mod predictor;
pub mod shipped;
mod temporal;

use candle_core::Tensor;
use candle_nn::VarBuilder;

use crate::error::{Error, Result};

pub use checkpoint::{Checkpoint, Metadata};
pub use config::Config;
pub use predictor::{Prediction, Predictor};

/// The whole network (EgoTac): vision encoder, temporal fusion, tactile decoder.
#[derive(Debug, Clone)]
pub struct EgoTac {
    config: Config,
    encoder: dinov2::Dinov2,
    temporal: temporal::TemporalFusion,
    decoder: decoder::Decoder,
}

impl EgoTac {
    /// Builds the network from the tensors of `vb`; the names are those of the checkpoint.
    ///
    /// # Errors
    /// If the configuration does not pass its check, or `vb` lacks a tensor or has one of another shape.
    pub fn new(config: &Config, vb: VarBuilder) -> Result<Self> {
        config.check()?;
        Ok(Self {
            config: config.clone(),
            encoder: dinov2::Dinov2::new(config, vb.pp("encoder"))?,
            temporal: temporal::TemporalFusion::new(config, vb.pp("temporal"))?,
            decoder: decoder::Decoder::new(config, vb)?,
        })
    }

    /// Its geometry.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Prepares for inference: computes once what depends on parameters alone. Later changes of the parameters are
    /// not seen, so a network in training stays as it is.
    ///
    /// # Errors
    /// If memory runs out on the device.
    pub fn freeze(mut self) -> Result<Self> {
        self.encoder.freeze()?;
        self.decoder.freeze()?;
        Ok(self)
    }

    /// Vision tokens of single frames, what a stream keeps of each.
    ///
    /// `frames`: `(N, 3, H, W)`, ImageNet-normalised. Returns `(N, P, dv)`.
    ///
    /// # Errors
    /// If H or W is not `config.image`.
    pub fn encode(&self, frames: &Tensor) -> Result<Tensor> {
        Ok(self.encoder.forward(frames)?)
    }

    /// The first, frame-wise step of [`EgoTac::decode`]: tokens to the width of the decoder.
    ///
    /// `tokens`: `(.., P, dv)`. Returns `(.., P, d)`.
    ///
    /// # Errors
    /// If the last dimension is not dv.
    pub fn project(&self, tokens: &Tensor) -> Result<Tensor> {
        Ok(self.temporal.project(tokens)?)
    }

    /// The scene vector z of a window of projected frames.
    ///
    /// `projected`: `(B, T, P, d)`, oldest frame first. Returns `(B, d)`.
    ///
    /// # Errors
    /// If T is not the horizon.
    pub fn fuse(&self, projected: &Tensor) -> Result<Tensor> {
        Ok(self.temporal.fuse(projected)?)
    }

    /// Force in normalised units (newton = `force_scale` x output) and contact logits from the scene vector.
    ///
    /// `z`: `(B, d)`. Returns `(B, K, 1556)` twice.
    ///
    /// # Errors
    /// If the last dimension is not d.
    pub fn heads(&self, z: &Tensor) -> Result<(Tensor, Tensor)> {
        Ok(self.decoder.forward(z)?)
    }

    /// Force in normalised units and contact logits from the tokens of a window.
    ///
    /// `tokens`: `(B, T, P, dv)`, oldest frame first. Returns `(B, K, 1556)` twice.
    ///
    /// # Errors
    /// If T is not the horizon.
    pub fn decode(&self, tokens: &Tensor) -> Result<(Tensor, Tensor)> {
        self.heads(&self.fuse(&self.project(tokens)?)?)
    }

    /// Whole clips: `images` `(B, T, 3, H, W)`, ImageNet-normalised, oldest frame first.
    ///
    /// Returns force in normalised units and contact logits, `(B, K, 1556)` each.
    ///
    /// # Errors
    /// If T is not the horizon, or H or W is not `config.image`.
    pub fn forward(&self, images: &Tensor) -> Result<(Tensor, Tensor)> {
        let (b, t) = self.check_clip(images)?;
        let tokens = self.encode(&images.flatten(0, 1)?)?;
        let (_, p, dv) = tokens.dims3()?;
        self.decode(&tokens.reshape((b, t, p, dv))?)
    }

    /// B and T of clips that fit the network.
    fn check_clip(&self, images: &Tensor) -> Result<(usize, usize)> {
        let (t, side) = (self.config.horizon, self.config.image);
        match *images.dims() {
            [b, came, 3, height, width] if (came, height, width) == (t, side, side) => Ok((b, t)),
            _ => Err(Error::shape("images", format!("[B, {t}, 3, {side}, {side}]"), images.dims())),
        }
    }
}

/// Every stage of a pass over whole clips, as `egotac model forward` writes them.
#[derive(Debug, Clone)]
pub struct Stages {
    /// `(B T, P, dv)`.
    pub tokens: Tensor,
    /// `(B, d)`.
    pub z: Tensor,
    /// `(B, K, 1556)`, normalised units.
    pub force: Tensor,
    /// `(B, K, 1556)`.
    pub contact_logits: Tensor,
}

impl EgoTac {
    /// As [`EgoTac::forward`], keeping what each stage gave.
    ///
    /// # Errors
    /// As [`EgoTac::forward`].
    pub fn stages(&self, images: &Tensor) -> Result<Stages> {
        let (b, t) = self.check_clip(images)?;
        let tokens = self.encode(&images.flatten(0, 1)?)?;
        let (_, p, dv) = tokens.dims3()?;
        let z = self.fuse(&self.project(&tokens.reshape((b, t, p, dv))?)?)?;
        let (force, contact_logits) = self.heads(&z)?;
        Ok(Stages { tokens, z, force, contact_logits })
    }
}
