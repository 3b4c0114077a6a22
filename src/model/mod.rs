//! The EgoTac network: images to force and contact on both hands.
//!
//! Shapes: B batch, T observation horizon, K tactile steps, P vision tokens per frame (CLS first), dv width of the
//! vision encoder, d width of the rest, 1556 = 2 x 778 vertices, left hand first.
//!
//! [`EgoTac::new`] on an [`init::var_builder`] creates a network to train; [`Checkpoint::load`] loads one to run, and
//! [`predictor::Predictor`] runs it on a stream of images. Two rules hold for streams and batches alike: [`window`]
//! chooses the frames of an observation window, `heads` converts the outputs of the network to newtons and probabilities:
//! force = max(0, `force_scale` · f), contact = 1 / (1 + e^(-l/T)) with the temperature T of the checkpoint.
//! A third one, [`unknown`], says which touch a network does not know, by the [`familiarity`] of the image
//! and the [`presence`] of each hand.

mod attention;
#[doc(hidden)]
pub mod budget;
pub mod checkpoint;
pub mod config;
mod config_check;
mod decoder;
mod dinov2;
mod engine;
pub mod familiarity;
mod finite;
#[doc(hidden)]
pub mod grow;
mod heads;
#[doc(hidden)]
pub mod import;
#[doc(hidden)]
pub mod init;
pub mod metadata;
pub mod precision;
pub mod predictor;
pub mod presence;
#[doc(hidden)]
pub mod pretrained;
#[doc(hidden)]
pub mod published;
mod pytorch;
#[cfg(feature = "cuda")]
mod recorded;
mod shapes;
pub mod shipped;
pub mod spread;
mod stages;
mod temporal;
pub mod unknown;
mod view;
mod weights;
#[doc(hidden)]
pub mod window;

use std::sync::Arc;

use candle_core::{DType, Tensor};
use candle_nn::VarBuilder;

use crate::error::{Error, Result};

pub use checkpoint::Checkpoint;
pub use config::Config;
pub use familiarity::Familiarity;
pub use metadata::Metadata;
pub use precision::Precision;
pub use predictor::{Prediction, Predictor};
pub use presence::{HandEstimate, Keypoint, Presence};
pub use spread::Spread;
pub use stages::Stages;
pub use unknown::{DoubtThresholds, Unknown};
pub use view::View;

/// The whole network (EgoTac): vision encoder, temporal fusion, tactile decoder.
#[derive(Debug, Clone)]
pub struct EgoTac {
    config: Config,
    form: Form,
    /// The stages of a stream, recorded on a GPU.
    #[cfg(feature = "cuda")]
    recorded: Option<Arc<recorded::Recorded>>,
}

/// Form of the network: trainable, as candle layers on any device, or compiled for inference on the CPU.
#[derive(Debug, Clone)]
enum Form {
    Trainable(Box<Layers>),
    Compiled(Arc<engine::Engine>),
}

/// The three parts of the network as candle layers.
#[derive(Debug, Clone)]
struct Layers {
    encoder: dinov2::Dinov2,
    temporal: temporal::TemporalFusion,
    decoder: decoder::Decoder,
    dtype: DType,
}

impl EgoTac {
    /// Builds the network from the tensors of `vb`, under the names of a checkpoint.
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
        Ok(Self::of(config.clone(), Form::Trainable(Box::new(layers))))
    }

    /// Geometry of the network.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Prepares for inference in f32, or in the type of tensors on another device than the CPU.
    ///
    /// # Errors
    /// As [`EgoTac::compile`].
    pub fn freeze(self) -> Result<Self> {
        let precision = match &self.form {
            Form::Trainable(layers) => layers.precision(),
            Form::Compiled(_) => Precision::F32,
        };
        self.compile(precision)
    }

    /// Prepares for inference: computes once the values that depend on parameters alone. On the CPU, the weights are laid
    /// out in `precision`. Later changes of the parameters have no effect, so a network in training must not be compiled.
    ///
    /// # Errors
    /// If memory runs out, or the device has no such precision: a device other than the CPU uses the type of its tensors.
    pub fn compile(self, precision: Precision) -> Result<Self> {
        let Form::Trainable(mut layers) = self.form else { return Ok(self) };
        let config = self.config;
        if layers.fit_the_engine() {
            let engine = engine::Engine::new(&config, *layers, precision)?;
            return Ok(Self::of(config, Form::Compiled(Arc::new(engine))));
        }
        let available = layers.precision();
        if precision != available {
            return Err(Error::value(
                "precision",
                format!("{available}, the type of this device's tensors"),
                precision,
            ));
        }
        layers.encoder.freeze()?;
        layers.decoder.freeze()?;
        Ok(Self::of(config, Form::Trainable(layers)))
    }

    fn of(config: Config, form: Form) -> Self {
        Self {
            config,
            form,
            #[cfg(feature = "cuda")]
            recorded: None,
        }
    }

    /// On a GPU, records the work on one image of a stream, so that it is started as a whole. Nothing else may use the device meanwhile, and
    /// later changes of the parameters have no effect that can be relied on. Where recording fails, each kernel is started by itself, which takes
    /// longer.
    pub(crate) fn record(self) -> Self {
        #[cfg(feature = "cuda")]
        if let Form::Trainable(layers) = &self.form
            && layers.temporal.token.device().is_cuda()
        {
            // Another network's device may be closed at the same time, which ends a recording.
            let recorded = (0..3).find_map(|_| recorded::Recorded::new(&self.config, layers).ok());
            return Self { recorded: recorded.map(Arc::new), ..self };
        }
        self
    }

    /// Bytes of the compiled weights; `None` before [`EgoTac::compile`] and on other devices than the CPU.
    pub fn compiled_bytes(&self) -> Option<usize> {
        match &self.form {
            Form::Trainable(_) => None,
            Form::Compiled(engine) => Some(engine.bytes()),
        }
    }

    /// Number format of the weights.
    pub fn precision(&self) -> Precision {
        match &self.form {
            Form::Trainable(layers) => layers.precision(),
            Form::Compiled(engine) => engine.precision(),
        }
    }
}

impl Layers {
    /// Computes the vision tokens of frames, `(N, 3, H, W)`, in the type of the weights. Returns `(N, P, dv)`.
    fn encode(&self, frames: &Tensor) -> candle_core::Result<Tensor> {
        self.encoder.forward(&frames.to_dtype(self.dtype)?)
    }

    /// Computes force in normalised units and contact logits of scene vectors `(B, d)`. Returns `(B, K, 1556)` twice, f32.
    fn heads(&self, z: &Tensor) -> candle_core::Result<(Tensor, Tensor)> {
        let (force, contact) = self.decoder.forward(z)?;
        Ok((force.to_dtype(DType::F32)?, contact.to_dtype(DType::F32)?))
    }

    /// True if the engine accepts these tensors: f32 on the CPU.
    fn fit_the_engine(&self) -> bool {
        self.dtype == DType::F32 && self.temporal.token.device().is_cpu()
    }

    fn precision(&self) -> Precision {
        if self.dtype == DType::BF16 { Precision::Bf16 } else { Precision::F32 }
    }
}
