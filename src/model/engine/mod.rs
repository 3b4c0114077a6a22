//! The network compiled for inference on the CPU: weights packed once in the wanted precision, each step fused with the one
//! that follows it, buffers kept from frame to frame. The kernels are those of `egotac_kernels`.
//!
//! Frames pass one by one, so that the activations of a frame stay in the cache. Each product is split into many small
//! tasks, so that a thread that the system suspends delays little work. Results do not depend on the number of threads.

mod decoder;
mod encoder;
mod temporal;

use std::sync::{Mutex, PoisonError};

pub use encoder::ChangedPatches;

use egotac_kernels::activations::Activations;
use egotac_kernels::norm::Norm;
use egotac_kernels::packed::Packed;
use egotac_kernels::rows::Rows;
use egotac_kernels::team;

use super::Layers;
use super::attention::{EPS, LayerNorm, Linear};
use super::config::Config;
use super::finite::check_finite;
use super::precision::Precision;
use crate::error::Result;
use crate::tactile::N_FIELD;

/// The compiled network.
pub struct Engine {
    config: Config,
    precision: Precision,
    encoder: encoder::Encoder,
    temporal: temporal::Temporal,
    decoder: decoder::Decoder,
    /// Buffers that no call uses. Each call takes one set, so that several threads may call at once.
    spare: Mutex<Vec<Buffers>>,
}

/// Intermediate results of one call.
struct Buffers {
    encoder: encoder::Buffers,
    temporal: temporal::Buffers,
    decoder: decoder::Buffers,
    buffer: Activations,
}

impl Engine {
    /// Compiles the layers; each is freed once it is packed.
    ///
    /// # Errors
    /// If a tensor is not f32 on the CPU.
    pub fn new(config: &Config, layers: Layers, precision: Precision) -> Result<Self> {
        Ok(Self {
            config: config.clone(),
            precision,
            encoder: encoder::Encoder::new(config, layers.encoder, precision)?,
            temporal: temporal::Temporal::new(layers.temporal, precision)?,
            decoder: decoder::Decoder::new(layers.decoder, precision)?,
            spare: Mutex::default(),
        })
    }

    /// Number format of the weights.
    pub fn precision(&self) -> Precision {
        self.precision
    }

    /// Bytes of the weights.
    pub fn bytes(&self) -> usize {
        self.encoder.bytes() + self.temporal.bytes() + self.decoder.bytes()
    }

    /// Encodes frames: N times `(3, H, W)`. Returns N times `(P, dv)`.
    ///
    /// # Errors
    /// If a result is not finite; names the step.
    pub fn encode(&self, frames: &[f32]) -> Result<Vec<f32>> {
        let (size, wide) = (3 * self.config.image.pow(2), self.config.tokens() * self.config.vision_width);
        let mut out = vec![0.0; frames.len() / size * wide];
        self.with_buffers(|Buffers { encoder, buffer, .. }| -> Result<()> {
            for (frame, out) in frames.chunks_exact(size).zip(out.chunks_exact_mut(wide)) {
                self.encoder.forward(frame, None, out, encoder, buffer, false)?;
                if !all_finite(out) {
                    // A second pass with checks after each step names the first one that fails.
                    self.encoder.forward(frame, None, out, encoder, buffer, true)?;
                }
            }
            Ok(())
        })?;
        Ok(out)
    }

    /// Encodes a part of one frame, `(3, H, W)`. `earlier`: tokens of an earlier frame, `(P, dv)`, which stay where the part has no
    /// patch. Returns `(P, dv)`.
    ///
    /// # Errors
    /// If a result is not finite; names the step.
    pub fn encode_part(&self, frame: &[f32], part: ChangedPatches, earlier: &[f32]) -> Result<Vec<f32>> {
        let mut out = earlier.to_vec();
        self.with_buffers(|Buffers { encoder, buffer, .. }| {
            self.encoder.forward(frame, Some(part), &mut out, encoder, buffer, false)?;
            match all_finite(&out) {
                true => Ok(()),
                false => self.encoder.forward(frame, Some(part), &mut out, encoder, buffer, true),
            }
        })?;
        Ok(out)
    }

    /// Projects tokens, `(rows, dv)`, to the width of the decoder. Returns `(rows, d)`.
    pub fn project(&self, tokens: &[f32]) -> Vec<f32> {
        let dv = self.config.vision_width;
        let mut out = vec![0.0; tokens.len() / dv * self.config.width];
        self.with_buffers(|Buffers { buffer, .. }| self.temporal.project(Rows::new(tokens, dv), &mut out, buffer));
        out
    }

    /// Fuses windows: B times T frames of `(P, d)`, oldest first. Returns `(B, d)`.
    ///
    /// # Errors
    /// If a result is not finite; names the step.
    pub fn fuse(&self, windows: &[&[f32]]) -> Result<Vec<f32>> {
        let (horizon, d) = (self.config.horizon, self.config.width);
        let mut z = vec![0.0; windows.len() / horizon * d];
        self.with_buffers(|Buffers { temporal, buffer, .. }| -> Result<()> {
            for (frames, z) in windows.chunks_exact(horizon).zip(z.chunks_exact_mut(d)) {
                self.temporal.fuse(frames, z, temporal, buffer, false)?;
                if !all_finite(z) {
                    frames.iter().try_for_each(|frame| check_finite("temporal.proj", frame))?;
                    self.temporal.fuse(frames, z, temporal, buffer, true)?;
                }
            }
            Ok(())
        })?;
        Ok(z)
    }

    /// Computes force and contact logits, `(B, K, 1556)` each, from scene vectors `z`, `(B, d)`.
    ///
    /// # Errors
    /// If a result is not finite; names the step.
    pub fn heads(&self, z: &[f32]) -> Result<[Vec<f32>; 2]> {
        let outputs = z.len() / self.config.width * self.decoder.steps() * N_FIELD;
        let (mut force, mut contact) = (vec![0.0; outputs], vec![0.0; outputs]);
        self.with_buffers(|Buffers { decoder, buffer, .. }| -> Result<()> {
            self.decoder.forward(z, &mut force, &mut contact, decoder, buffer, false)?;
            if !all_finite(&force) || !all_finite(&contact) {
                check_finite("temporal.norm_out", z)?;
                self.decoder.forward(z, &mut force, &mut contact, decoder, buffer, true)?;
            }
            Ok(())
        })?;
        Ok([force, contact])
    }

    /// Runs a call with a set of buffers, and with the threads of the pool as its team.
    fn with_buffers<R: Send>(&self, run: impl FnOnce(&mut Buffers) -> R + Send) -> R {
        let spare = self.spare.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut buffers = spare.unwrap_or_else(|| Buffers {
            encoder: self.encoder.buffers(self.config.vision_heads, self.precision),
            temporal: temporal::Buffers::default(),
            decoder: self.decoder.buffers(self.config.heads, self.precision),
            buffer: Activations::default(),
        });
        let result = team::lead(|| run(&mut buffers));
        self.spare.lock().unwrap_or_else(PoisonError::into_inner).push(buffers);
        result
    }
}

impl std::fmt::Debug for Engine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Engine")
            .field("config", &self.config)
            .field("precision", &self.precision)
            .finish_non_exhaustive()
    }
}

impl Linear {
    /// Packs the layer in the wanted precision.
    fn pack(&self, precision: Precision) -> Result<Packed> {
        let (weight, bias) = self.values()?;
        Ok(Packed::new(&weight, bias, precision.format()))
    }
}

impl LayerNorm {
    fn pack(&self) -> Result<Norm> {
        let (weight, bias) = self.values()?;
        Ok(Norm::new(weight, bias, EPS as f32))
    }
}

/// True if all values are finite. Much faster than [`check_finite`]: zero times a value that is not finite is NaN, so one sum
/// without branches shows it.
fn all_finite(values: &[f32]) -> bool {
    let sum: f32 = values.chunks(4096).map(|chunk| chunk.iter().map(|value| 0.0 * value).sum::<f32>()).sum();
    sum == 0.0
}
