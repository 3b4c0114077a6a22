//! The work on one image of a stream, recorded on a GPU.

use candle_core::{DType, Tensor};
use egotac_kernels::ops::cuda::Recording;

use super::{Config, Layers};
use crate::error::Result;

/// The two stages that a stream runs for each image.
#[derive(Debug)]
pub struct Recorded {
    /// A frame, `(1, 3, H, W)`, to its tokens, `(1, P, dv)`.
    frame: Recording,
    /// T projected frames, `(P, d)` each, to force and contact logits, `(1, K, 1556)`.
    window: Recording,
}

impl Recorded {
    /// Records both stages.
    ///
    /// # Errors
    /// If the device is out of memory.
    pub fn new(config: &Config, layers: &Layers) -> Result<Self> {
        let device = layers.temporal.token.device();
        let frame = Tensor::zeros((1, 3, config.image, config.image), DType::F32, device)?;
        let tokens = Tensor::zeros((config.tokens(), config.width), layers.dtype, device)?;
        let frame = Recording::new(&[&frame], |inputs| Ok(vec![layers.encode(&inputs[0])?]))?;
        let window = Recording::new(&vec![&tokens; config.horizon], |frames| {
            let (force, contact) = layers.heads(&layers.temporal.fuse(&Tensor::stack(frames, 0)?.unsqueeze(0)?)?)?;
            Ok(vec![force, contact])
        })?;
        Ok(Self { frame, window })
    }

    /// As [`Layers::encode`]; None if the frame is not a single one in f32.
    pub fn encode(&self, frames: &Tensor) -> Result<Option<Tensor>> {
        match frames.dims() {
            [1, ..] if frames.dtype() == DType::F32 => Ok(self.frame.run(&[&frames.contiguous()?])?.pop()),
            _ => Ok(None),
        }
    }

    /// Computes force and contact logits of one window, whose frames are `(P, d)` or `(1, P, d)`.
    pub fn window(&self, frames: &[&Tensor]) -> Result<[Tensor; 2]> {
        let frames = frames.iter().map(|frame| frame.flatten_to(frame.rank() - 2)?.contiguous());
        let frames = frames.collect::<candle_core::Result<Vec<_>>>()?;
        let outputs = self.window.run(&frames.iter().collect::<Vec<_>>())?;
        outputs.try_into().map_err(|_| candle_core::Error::Msg("a recorded window has two outputs".into()).into())
    }
}
