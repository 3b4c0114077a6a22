//! The stages of the network: encode, project, fuse, heads.
//!
//! Training and tests call them one by one on tensors. Stream and batch call [`EgoTac::frame_tokens`] once per frame and
//! [`EgoTac::head_outputs`] once per window, which pass plain slices from stage to stage in a compiled network.

use candle_core::{DType, Device, Tensor};
use egotac_kernels::ops::with_slices;

use super::engine::ChangedPatches;
use super::heads::HeadOutputs;
use super::{EgoTac, Form, Layers};
use crate::error::{Error, Result};
use crate::tactile::N_FIELD;

/// Tokens of single frames: those that a stream keeps, and those before their projection, which familiarity and presence
/// are computed from.
#[derive(Debug, Clone)]
pub(crate) struct FrameTokens {
    /// `(N, P, d)`.
    pub projected: Tensor,
    /// `(N, P, dv)` after the encoder's last norm, CLS first.
    pub encoded: Vec<f32>,
}

/// Outputs of every stage for whole clips, as `egotac model forward` writes them.
#[derive(Debug, Clone)]
pub struct Stages {
    /// Vision tokens, `(B T, P, dv)`.
    pub tokens: Tensor,
    /// Scene vectors, `(B, d)`.
    pub z: Tensor,
    /// Force in normalised units, `(B, K, 1556)`.
    pub force: Tensor,
    /// Contact logits, `(B, K, 1556)`.
    pub contact_logits: Tensor,
}

impl EgoTac {
    /// Computes the vision tokens of single frames.
    ///
    /// `frames`: `(N, 3, H, W)`, ImageNet-normalised. Returns `(N, P, dv)`.
    ///
    /// # Errors
    /// If H or W is not `config.image`; in a compiled network also if a step's result is not finite, with its name.
    pub fn encode(&self, frames: &Tensor) -> Result<Tensor> {
        match &self.form {
            Form::Trainable(layers) => {
                #[cfg(feature = "cuda")]
                if let Some(recorded) = &self.recorded
                    && let Some(tokens) = recorded.encode(frames)?
                {
                    return Ok(tokens);
                }
                Ok(layers.encode(frames)?)
            }
            Form::Compiled(engine) => {
                let n = self.check_frames(frames)?;
                let tokens = with_slices(&[frames], |values| engine.encode(values[0]))?;
                Ok(Tensor::from_vec(tokens, (n, self.config.tokens(), self.config.vision_width), frames.device())?)
            }
        }
    }

    /// Projects tokens to the width of the decoder: the first, frame-wise step of [`EgoTac::decode`].
    ///
    /// `tokens`: `(.., P, dv)`. Returns `(.., P, d)`.
    ///
    /// # Errors
    /// If the last dimension is not dv.
    pub fn project(&self, tokens: &Tensor) -> Result<Tensor> {
        match &self.form {
            Form::Trainable(layers) => Ok(layers.temporal.project(&tokens.to_dtype(layers.dtype)?)?),
            Form::Compiled(engine) => {
                let mut dims = tokens.dims().to_vec();
                match dims.last_mut() {
                    Some(last) if *last == self.config.vision_width => *last = self.config.width,
                    _ => return Err(Error::shape("tokens", format!("[.., {}]", self.config.vision_width), dims)),
                }
                let projected = with_slices::<_, Error>(&[tokens], |values| Ok(engine.project(values[0])))?;
                Ok(Tensor::from_vec(projected, dims, tokens.device())?)
            }
        }
    }

    /// Encodes and projects single frames.
    ///
    /// `frames`: `(N, 3, H, W)`, ImageNet-normalised.
    ///
    /// # Errors
    /// As [`EgoTac::encode`].
    pub(crate) fn frame_tokens(&self, frames: &Tensor) -> Result<FrameTokens> {
        match &self.form {
            Form::Trainable(_) => {
                let tokens = self.encode(frames)?;
                let encoded = tokens.to_device(&Device::Cpu)?.to_dtype(DType::F32)?.flatten_all()?.to_vec1()?;
                Ok(FrameTokens { projected: self.project(&tokens)?, encoded })
            }
            Form::Compiled(engine) => {
                let n = self.check_frames(frames)?;
                let encoded = with_slices(&[frames], |values| engine.encode(values[0]))?;
                let projected = engine.project(&encoded);
                let shape = (n, self.config.tokens(), self.config.width);
                Ok(FrameTokens { projected: Tensor::from_vec(projected, shape, frames.device())?, encoded })
            }
        }
    }

    /// Encodes a part of one frame and projects it; its other tokens are those of `earlier`. None if the network is not compiled.
    ///
    /// `frame`: `(1, 3, H, W)`, ImageNet-normalised.
    ///
    /// # Errors
    /// As [`EgoTac::encode`].
    pub(crate) fn part_tokens(
        &self,
        frame: &Tensor,
        part: ChangedPatches,
        earlier: &FrameTokens,
    ) -> Result<Option<FrameTokens>> {
        let Form::Compiled(engine) = &self.form else { return Ok(None) };
        self.check_frames(frame)?;
        let encoded = with_slices(&[frame], |values| engine.encode_part(values[0], part, &earlier.encoded))?;
        let projected = engine.project(&encoded);
        let shape = (1, self.config.tokens(), self.config.width);
        Ok(Some(FrameTokens { projected: Tensor::from_vec(projected, shape, frame.device())?, encoded }))
    }

    /// Fuses a window of projected frames into the scene vector z.
    ///
    /// `projected`: `(B, T, P, d)`, oldest frame first. Returns `(B, d)`.
    ///
    /// # Errors
    /// If T is not the horizon; in a compiled network also if a step's result is not finite, with its name.
    pub fn fuse(&self, projected: &Tensor) -> Result<Tensor> {
        match &self.form {
            Form::Trainable(layers) => Ok(layers.temporal.fuse(projected)?),
            Form::Compiled(engine) => {
                let (t, p, d) = (self.config.horizon, self.config.tokens(), self.config.width);
                let b = match *projected.dims() {
                    [b, frames, tokens, width] if (frames, tokens, width) == (t, p, d) => b,
                    _ => {
                        let expected = format!("[B, {t}, {p}, {d}]");
                        return Err(Error::shape("observation window", expected, projected.dims()));
                    }
                };
                let z = with_slices(&[projected], |values| {
                    engine.fuse(&values[0].chunks_exact(p * d).collect::<Vec<_>>())
                })?;
                Ok(Tensor::from_vec(z, (b, d), projected.device())?)
            }
        }
    }

    /// As [`EgoTac::fuse`], on windows whose frames are separate tensors.
    ///
    /// `frames`: the T frames of each of B windows, oldest first, `(P, d)` or `(1, P, d)` each. Returns `(B, d)`.
    ///
    /// # Errors
    /// As [`EgoTac::fuse`].
    pub fn fuse_frames(&self, frames: &[&Tensor]) -> Result<Tensor> {
        let b = self.check_windows(frames)?;
        match &self.form {
            Form::Trainable(_) => self.fuse(&self.stack(frames, b)?),
            Form::Compiled(engine) => {
                let z = with_slices(frames, |frames| engine.fuse(frames))?;
                Ok(Tensor::from_vec(z, (b, self.config.width), frames[0].device())?)
            }
        }
    }

    /// Computes the outputs of both heads for windows of projected frames; frames as in [`EgoTac::fuse_frames`].
    ///
    /// # Errors
    /// As [`EgoTac::fuse`] and [`EgoTac::heads`].
    pub(crate) fn head_outputs(&self, frames: &[&Tensor]) -> Result<HeadOutputs> {
        self.check_windows(frames)?;
        let [force, contact_logits] = match &self.form {
            Form::Trainable(_) => {
                let (force, contact) = self.decode_frames(frames)?;
                [force.flatten_all()?.to_vec1()?, contact.flatten_all()?.to_vec1()?]
            }
            Form::Compiled(engine) => engine.heads(&with_slices(frames, |frames| engine.fuse(frames))?)?,
        };
        Ok(HeadOutputs { force, contact_logits, steps: self.config.predict })
    }

    /// Computes force in normalised units and contact logits of windows of projected frames; frames as in [`EgoTac::fuse_frames`].
    ///
    /// Returns `(B, K, 1556)` twice, f32.
    ///
    /// # Errors
    /// As [`EgoTac::fuse`] and [`EgoTac::heads`].
    pub fn decode_frames(&self, frames: &[&Tensor]) -> Result<(Tensor, Tensor)> {
        #[cfg(feature = "cuda")]
        if let (Some(recorded), 1) = (&self.recorded, self.check_windows(frames)?) {
            let [force, contact] = recorded.window(frames)?;
            return Ok((force, contact));
        }
        self.heads(&self.fuse_frames(frames)?)
    }

    /// Computes force in normalised units (newton = `force_scale` x output) and contact logits from the scene vector.
    ///
    /// `z`: `(B, d)`. Returns `(B, K, 1556)` twice, f32.
    ///
    /// # Errors
    /// If the last dimension is not d; in a compiled network also if a step's result is not finite, with its name.
    pub fn heads(&self, z: &Tensor) -> Result<(Tensor, Tensor)> {
        match &self.form {
            Form::Trainable(layers) => Ok(layers.heads(z)?),
            Form::Compiled(engine) => {
                let b = match *z.dims() {
                    [b, d] if d == self.config.width => b,
                    _ => return Err(Error::shape("z", format!("[B, {}]", self.config.width), z.dims())),
                };
                let [force, contact] = with_slices(&[z], |values| engine.heads(values[0]))?;
                let tensor = |values| Tensor::from_vec(values, (b, self.config.predict, N_FIELD), z.device());
                Ok((tensor(force)?, tensor(contact)?))
            }
        }
    }

    /// Computes force in normalised units and contact logits from the tokens of a window.
    ///
    /// `tokens`: `(B, T, P, dv)`, oldest frame first. Returns `(B, K, 1556)` twice.
    ///
    /// # Errors
    /// If T is not the horizon.
    pub fn decode(&self, tokens: &Tensor) -> Result<(Tensor, Tensor)> {
        self.heads(&self.fuse(&self.project(tokens)?)?)
    }

    /// Runs the network on whole clips.
    ///
    /// `images`: `(B, T, 3, H, W)`, ImageNet-normalised, oldest frame first. Returns force in normalised units and contact
    /// logits, `(B, K, 1556)` each.
    ///
    /// # Errors
    /// If T is not the horizon, or H or W is not `config.image`.
    pub fn forward(&self, images: &Tensor) -> Result<(Tensor, Tensor)> {
        self.decode(&self.encode_clips(images)?)
    }

    /// As [`EgoTac::forward`], keeping the output of each stage.
    ///
    /// # Errors
    /// As [`EgoTac::forward`].
    pub fn stages(&self, images: &Tensor) -> Result<Stages> {
        let tokens = self.encode_clips(images)?; // (B, T, P, dv)
        let z = self.fuse(&self.project(&tokens)?)?;
        let (force, contact_logits) = self.heads(&z)?;
        Ok(Stages { tokens: tokens.flatten(0, 1)?, z, force, contact_logits })
    }

    /// Computes the attention of the CLS token to the patches in one layer of the vision encoder.
    ///
    /// `frames`: `(N, 3, H, W)`. Returns `(N, heads, grid²)`. The weights of CLS and registers are left out, so a row sums
    /// to less than 1.
    ///
    /// # Errors
    /// If there is no such layer, H or W is not `config.image`, or the network is compiled.
    pub fn encoder_attention(&self, frames: &Tensor, layer: usize) -> Result<Tensor> {
        if layer >= self.config.vision_depth {
            return Err(Error::value("layer", format!("0 to {}", self.config.vision_depth - 1), layer));
        }
        Ok(self.layers()?.encoder.attention(frames, layer)?)
    }

    /// Computes the attention of the temporal token to all tokens of a window.
    ///
    /// `images`: `(B, T, 3, H, W)`, oldest frame first. Returns `(B, heads, T, P)`, CLS first; each head's sum is 1.
    ///
    /// # Errors
    /// If T is not the horizon, H or W is not `config.image`, or the network is compiled.
    pub fn temporal_attention(&self, images: &Tensor) -> Result<Tensor> {
        let layers = self.layers()?;
        Ok(layers.temporal.attention(&self.project(&self.encode_clips(images)?)?)?)
    }

    /// Computes the tokens of clips, `(B, T, 3, H, W)`. Returns `(B, T, P, dv)`.
    fn encode_clips(&self, images: &Tensor) -> Result<Tensor> {
        let (t, side) = (self.config.horizon, self.config.image);
        let b = match *images.dims() {
            [b, frames, 3, height, width] if (frames, height, width) == (t, side, side) => b,
            _ => return Err(Error::shape("images", format!("[B, {t}, 3, {side}, {side}]"), images.dims())),
        };
        let tokens = self.encode(&images.flatten(0, 1)?)?;
        let (_, p, dv) = tokens.dims3()?;
        Ok(tokens.reshape((b, t, p, dv))?)
    }

    /// Returns N of frames that fit the network, `(N, 3, H, W)`.
    fn check_frames(&self, frames: &Tensor) -> Result<usize> {
        let side = self.config.image;
        match *frames.dims() {
            [n, 3, height, width] if (height, width) == (side, side) => Ok(n),
            _ => Err(Error::shape("frames", format!("[N, 3, {side}, {side}]"), frames.dims())),
        }
    }

    /// Returns the number of windows that separate frames make up.
    fn check_windows(&self, frames: &[&Tensor]) -> Result<usize> {
        let (t, size) = (self.config.horizon, self.config.tokens() * self.config.width);
        if frames.is_empty() || !frames.len().is_multiple_of(t) || frames.iter().any(|frame| frame.elem_count() != size)
        {
            let expected = format!("windows of {t} frames of {size} values");
            return Err(Error::shape("observation window", expected, [frames.len()]));
        }
        Ok(frames.len() / t)
    }

    /// Copies separate frames of `b` windows into one tensor, `(B, T, P, d)`.
    fn stack(&self, frames: &[&Tensor], b: usize) -> Result<Tensor> {
        let shape = (b, self.config.horizon, self.config.tokens(), self.config.width);
        Ok(Tensor::stack(frames, 0)?.reshape(shape)?)
    }

    fn layers(&self) -> Result<&Layers> {
        match &self.form {
            Form::Trainable(layers) => Ok(layers),
            Form::Compiled(_) => Err(Error::CompiledNetwork),
        }
    }
}
