//! The EgoTac network: images to force and contact on both hands.
//!
//! Shapes: B batch, T observation horizon, K tactile steps, P vision tokens per frame (CLS first), dv width of the
//! vision encoder, d width of the rest, 1556 = 2 x 778 vertices, left hand first.
//!
//! [`EgoTac::new`] on a [`init::var_builder`] gives a network to train; [`Checkpoint::load`] gives one to run, and
//! [`predictor::Predictor`] runs it on a stream of images.

mod attention;
pub mod budget;
pub mod checkpoint;
pub mod config;
mod decoder;
mod dinov2;
mod engine;
pub mod grow;
pub mod import;
pub mod init;
mod loader;
pub mod metadata;
pub mod ops;
pub mod precision;
pub mod predictor;
pub mod pretrained;
pub mod shipped;
mod temporal;

use std::sync::Arc;

use candle_core::{DType, Tensor};
use candle_nn::VarBuilder;

use crate::error::{Error, Result};
use crate::tactile::N_FIELD;

pub use checkpoint::Checkpoint;
pub use config::Config;
pub use metadata::Metadata;
pub use precision::Precision;
pub use predictor::{Prediction, Predictor};

/// The whole network (EgoTac): vision encoder, temporal fusion, tactile decoder.
#[derive(Debug, Clone)]
pub struct EgoTac {
    config: Config,
    form: Form,
}

/// The network as candle's layers, which can be trained and run on any device, or compiled for inference on the CPU.
#[derive(Debug, Clone)]
enum Form {
    Layers(Box<Layers>),
    Engine(Arc<engine::Engine>),
}

/// The network's three parts.
#[derive(Debug, Clone)]
struct Layers {
    encoder: dinov2::Dinov2,
    temporal: temporal::TemporalFusion,
    decoder: decoder::Decoder,
    dtype: DType,
}

impl EgoTac {
    /// Builds the network from the tensors of `vb`; the names are those of the checkpoint.
    ///
    /// # Errors
    /// If the configuration does not pass its check, or `vb` lacks a tensor or has one of another shape.
    pub fn new(config: &Config, vb: VarBuilder) -> Result<Self> {
        config.check()?;
        let layers = Layers {
            dtype: vb.dtype(),
            encoder: dinov2::Dinov2::new(config, vb.pp("encoder"))?,
            temporal: temporal::TemporalFusion::new(config, vb.pp("temporal"))?,
            decoder: decoder::Decoder::new(config, vb)?,
        };
        Ok(Self { config: config.clone(), form: Form::Layers(Box::new(layers)) })
    }

    /// Its geometry.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Prepares for inference in f32, or in the type of tensors on another device than the CPU.
    ///
    /// # Errors
    /// As [`EgoTac::compile`].
    pub fn freeze(self) -> Result<Self> {
        let precision = match &self.form {
            Form::Layers(layers) if layers.dtype == DType::BF16 => Precision::Bf16,
            _ => Precision::F32,
        };
        self.compile(precision)
    }

    /// Prepares for inference: computes once what depends on parameters alone. Later changes of the parameters are not
    /// seen, so a network in training stays as it is. On the CPU the weights are laid out anew in the wanted precision.
    ///
    /// # Errors
    /// If memory runs out, or the device has no such precision: another than the CPU runs in the type of its tensors.
    pub fn compile(self, precision: Precision) -> Result<Self> {
        let Form::Layers(mut layers) = self.form else { return Ok(self) };
        let config = self.config;
        if layers.is_plain_cpu() {
            let engine = engine::Engine::new(&config, *layers, precision)?;
            return Ok(Self { config, form: Form::Engine(Arc::new(engine)) });
        }
        let there = if layers.dtype == DType::BF16 { Precision::Bf16 } else { Precision::F32 };
        if precision != there {
            return Err(Error::value("precision", format!("{there}, as the tensors on this device are"), precision));
        }
        layers.encoder.freeze()?;
        layers.decoder.freeze()?;
        Ok(Self { config, form: Form::Layers(layers) })
    }

    /// Bytes that the compiled weights take; none before [`EgoTac::compile`] and on other devices than the CPU.
    pub fn compiled_bytes(&self) -> Option<usize> {
        match &self.form {
            Form::Layers(_) => None,
            Form::Engine(engine) => Some(engine.bytes()),
        }
    }

    /// Number format of the weights.
    pub fn precision(&self) -> Precision {
        match &self.form {
            Form::Layers(layers) if layers.dtype == DType::BF16 => Precision::Bf16,
            Form::Layers(_) => Precision::F32,
            Form::Engine(engine) => engine.precision(),
        }
    }

    /// Vision tokens of single frames, what a stream keeps of each.
    ///
    /// `frames`: `(N, 3, H, W)`, ImageNet-normalised. Returns `(N, P, dv)`.
    ///
    /// # Errors
    /// If H or W is not `config.image`; in a compiled network also if a step's result is not finite, with its name.
    pub fn encode(&self, frames: &Tensor) -> Result<Tensor> {
        match &self.form {
            Form::Layers(layers) => Ok(layers.encoder.forward(&frames.to_dtype(layers.dtype)?)?),
            Form::Engine(engine) => {
                let side = self.config.image;
                let n = match *frames.dims() {
                    [n, 3, height, width] if (height, width) == (side, side) => n,
                    _ => return Err(Error::shape("frames", format!("[N, 3, {side}, {side}]"), frames.dims())),
                };
                let tokens = engine::with_values(frames, |frames| engine.encode(frames))?;
                Ok(Tensor::from_vec(tokens, (n, self.config.tokens(), self.config.vision_width), frames.device())?)
            }
        }
    }

    /// The first, frame-wise step of [`EgoTac::decode`]: tokens to the width of the decoder.
    ///
    /// `tokens`: `(.., P, dv)`. Returns `(.., P, d)`.
    ///
    /// # Errors
    /// If the last dimension is not dv.
    pub fn project(&self, tokens: &Tensor) -> Result<Tensor> {
        match &self.form {
            Form::Layers(layers) => Ok(layers.temporal.project(tokens)?),
            Form::Engine(engine) => {
                let mut dims = tokens.dims().to_vec();
                match dims.last_mut() {
                    Some(last) if *last == self.config.vision_width => *last = self.config.width,
                    _ => return Err(Error::shape("tokens", format!("[.., {}]", self.config.vision_width), dims)),
                }
                let projected = engine::with_values(tokens, |tokens| Ok(engine.project(tokens)))?;
                Ok(Tensor::from_vec(projected, dims, tokens.device())?)
            }
        }
    }

    /// The scene vector z of a window of projected frames.
    ///
    /// `projected`: `(B, T, P, d)`, oldest frame first. Returns `(B, d)`.
    ///
    /// # Errors
    /// If T is not the horizon; in a compiled network also if a step's result is not finite, with its name.
    pub fn fuse(&self, projected: &Tensor) -> Result<Tensor> {
        match &self.form {
            Form::Layers(layers) => Ok(layers.temporal.fuse(projected)?),
            Form::Engine(engine) => {
                let (t, p, d) = (self.config.horizon, self.config.tokens(), self.config.width);
                let b = match *projected.dims() {
                    [b, frames, tokens, width] if (frames, tokens, width) == (t, p, d) => b,
                    _ => {
                        return Err(Error::shape(
                            "observation window",
                            [0, t, p, d].map(dim).join(", "),
                            projected.dims(),
                        ));
                    }
                };
                let z = engine::with_values(projected, |values| {
                    engine.fuse(&values.chunks_exact(p * d).collect::<Vec<_>>())
                })?;
                Ok(Tensor::from_vec(z, (b, d), projected.device())?)
            }
        }
    }

    /// As [`EgoTac::fuse`] on one window whose frames lie apart, `(1, P, d)` each, oldest first. Returns `(1, d)`.
    ///
    /// # Errors
    /// As [`EgoTac::fuse`].
    pub fn fuse_frames(&self, frames: &[&Tensor]) -> Result<Tensor> {
        let Form::Engine(engine) = &self.form else { return self.fuse(&Tensor::stack(frames, 1)?) };
        let (t, size) = (self.config.horizon, self.config.tokens() * self.config.width);
        if frames.len() != t || frames.iter().any(|frame| frame.elem_count() != size) {
            return Err(Error::shape("observation window", format!("{t} frames of {size}"), [frames.len()]));
        }
        /// Each frame stays borrowed while the others are.
        fn borrow(engine: &engine::Engine, frames: &[&Tensor], slices: &[&[f32]]) -> Result<Vec<f32>> {
            match frames.split_first() {
                None => engine.fuse(slices),
                Some((first, rest)) => {
                    engine::with_values(first, |values| borrow(engine, rest, &[slices, &[values]].concat()))
                }
            }
        }
        let z = borrow(engine, frames, &[])?;
        Ok(Tensor::from_vec(z, (1, self.config.width), frames[0].device())?)
    }

    /// Force in normalised units (newton = `force_scale` x output) and contact logits from the scene vector.
    ///
    /// `z`: `(B, d)`. Returns `(B, K, 1556)` twice, f32.
    ///
    /// # Errors
    /// If the last dimension is not d; in a compiled network also if a step's result is not finite, with its name.
    pub fn heads(&self, z: &Tensor) -> Result<(Tensor, Tensor)> {
        match &self.form {
            Form::Layers(layers) => {
                let (force, contact) = layers.decoder.forward(z)?;
                Ok((force.to_dtype(DType::F32)?, contact.to_dtype(DType::F32)?))
            }
            Form::Engine(engine) => {
                let b = match *z.dims() {
                    [b, d] if d == self.config.width => b,
                    _ => return Err(Error::shape("z", format!("[B, {}]", self.config.width), z.dims())),
                };
                let [force, contact] = engine::with_values(z, |z| engine.heads(z))?;
                let tensor = |values| Tensor::from_vec(values, (b, self.config.predict, N_FIELD), z.device());
                Ok((tensor(force)?, tensor(contact)?))
            }
        }
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

impl Layers {
    /// Whether the engine takes these tensors.
    fn is_plain_cpu(&self) -> bool {
        self.dtype == DType::F32 && self.temporal.token.device().is_cpu()
    }
}

/// A dimension in a message; 0 stands for a free one.
fn dim(size: usize) -> String {
    if size == 0 { "B".into() } else { size.to_string() }
}

impl EgoTac {
    /// What the CLS token attends to in a layer of the vision encoder.
    ///
    /// `frames`: `(N, 3, H, W)`. Returns `(N, heads, grid²)`: each patch's weight. CLS and registers have the rest to 1.
    ///
    /// # Errors
    /// If there is no such layer, H or W is not `config.image`, or the network is compiled: that one keeps no weights of
    /// attention.
    pub fn encoder_attention(&self, frames: &Tensor, layer: usize) -> Result<Tensor> {
        if layer >= self.config.vision_depth {
            return Err(Error::value("layer", format!("0 to {}", self.config.vision_depth - 1), layer));
        }
        Ok(self.layers()?.encoder.attention(frames, layer)?)
    }

    /// What the temporal token attends to.
    ///
    /// `images`: `(B, T, 3, H, W)`, oldest frame first. Returns `(B, heads, T, P)`, CLS first; each head's sum is 1.
    ///
    /// # Errors
    /// If T is not the horizon, H or W is not `config.image`, or the network is compiled.
    pub fn temporal_attention(&self, images: &Tensor) -> Result<Tensor> {
        let layers = self.layers()?;
        let (b, t) = self.check_clip(images)?;
        let tokens = self.encode(&images.flatten(0, 1)?)?;
        let (_, p, dv) = tokens.dims3()?;
        Ok(layers.temporal.attention(&self.project(&tokens.reshape((b, t, p, dv))?)?)?)
    }

    fn layers(&self) -> Result<&Layers> {
        match &self.form {
            Form::Layers(layers) => Ok(layers),
            Form::Engine(_) => Err(Error::value("network", "one that is not compiled", "a compiled one")),
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
