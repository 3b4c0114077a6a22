//! The network laid out for inference on the CPU: weights packed once in the wanted precision, each step fused with
//! what follows it, buffers kept from frame to frame.
//!
//! A frame passes alone, so that its activations stay in the cache; a product is split into many small tasks, so that
//! a thread that is held up elsewhere costs little. Results don't depend on the number of threads.

mod aligned;
mod attention;
mod decoder;
mod encoder;
mod norm;
mod packed;
mod quantise;
mod team;
mod temporal;
mod tile;
mod tile8;

use std::sync::{Mutex, PoisonError};

use candle_core::Tensor;

use self::norm::Norm;
use self::packed::{Packed, Rows};
use self::quantise::Quantised;
use super::Layers;
use super::attention::{LayerNorm, Linear};
use super::config::Config;
use super::precision::Precision;
use crate::error::{Error, Result};

/// The compiled network.
pub struct Engine {
    config: Config,
    precision: Precision,
    encoder: encoder::Encoder,
    temporal: temporal::Temporal,
    decoder: decoder::Decoder,
    /// Buffers of callers that are done; each caller takes one, so that several threads may call.
    spare: Mutex<Vec<Buffers>>,
}

/// Everything a frame or a window needs on its way.
struct Buffers {
    encoder: encoder::Buffers,
    temporal: temporal::Buffers,
    decoder: decoder::Buffers,
    quantised: Quantised,
}

impl Engine {
    /// Takes the layers apart.
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

    /// Bytes of weights.
    pub fn bytes(&self) -> usize {
        self.encoder.bytes() + self.temporal.bytes() + self.decoder.bytes()
    }

    /// `frames`: N times `(3, H, W)`. Returns N times `(P, dv)`.
    ///
    /// # Errors
    /// If a result is not finite; names the step.
    pub fn encode(&self, frames: &[f32]) -> Result<Vec<f32>> {
        let (size, wide) = (3 * self.config.image.pow(2), self.config.tokens() * self.config.vision_width);
        let mut out = vec![0.0; frames.len() / size * wide];
        self.with_buffers(|Buffers { encoder, quantised, .. }| {
            for (frame, out) in frames.chunks_exact(size).zip(out.chunks_exact_mut(wide)) {
                self.encoder.forward(frame, out, encoder, quantised, false)?;
                if !all_finite(out) {
                    // Again, slowly, for the name of the step.
                    self.encoder.forward(frame, out, encoder, quantised, true)?;
                }
            }
            Ok(())
        })?;
        Ok(out)
    }

    /// `tokens`: `(rows, dv)`. Returns `(rows, d)`.
    pub fn project(&self, tokens: &[f32]) -> Vec<f32> {
        let dv = self.config.vision_width;
        let mut out = vec![0.0; tokens.len() / dv * self.config.width];
        let done = self.with_buffers(|Buffers { quantised, .. }| {
            self.temporal.project(rows(tokens, dv), &mut out, quantised);
            Ok(())
        });
        debug_assert!(done.is_ok());
        out
    }

    /// `windows`: B times T frames of `(P, d)`, oldest first. Returns `(B, d)`.
    ///
    /// # Errors
    /// If a result is not finite; names the step.
    pub fn fuse(&self, windows: &[&[f32]]) -> Result<Vec<f32>> {
        let (horizon, d) = (self.config.horizon, self.config.width);
        let mut z = vec![0.0; windows.len() / horizon * d];
        self.with_buffers(|Buffers { temporal, quantised, .. }| {
            for (frames, z) in windows.chunks_exact(horizon).zip(z.chunks_exact_mut(d)) {
                self.temporal.fuse(frames, z, temporal, quantised, false)?;
                if !all_finite(z) {
                    frames.iter().try_for_each(|frame| finite("temporal.proj", frame))?;
                    self.temporal.fuse(frames, z, temporal, quantised, true)?;
                }
            }
            Ok(())
        })?;
        Ok(z)
    }

    /// `z`: `(B, d)`. Returns force and contact logits, `(B, K, 1556)` each.
    ///
    /// # Errors
    /// If a result is not finite; names the step.
    pub fn heads(&self, z: &[f32]) -> Result<[Vec<f32>; 2]> {
        let outputs = z.len() / self.config.width * self.decoder.steps() * crate::tactile::N_FIELD;
        let (mut force, mut contact) = (vec![0.0; outputs], vec![0.0; outputs]);
        self.with_buffers(|Buffers { decoder, quantised, .. }| {
            self.decoder.forward(z, &mut force, &mut contact, decoder, quantised, false)?;
            if !all_finite(&force) || !all_finite(&contact) {
                finite("temporal.norm_out", z)?;
                self.decoder.forward(z, &mut force, &mut contact, decoder, quantised, true)?;
            }
            Ok(())
        })?;
        Ok([force, contact])
    }

    /// Leads the threads of the pool.
    fn with_buffers(&self, run: impl FnOnce(&mut Buffers) -> Result<()> + Send) -> Result<()> {
        let spare = self.spare.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut buffers = spare.unwrap_or_else(|| Buffers {
            encoder: self.encoder.buffers(self.config.vision_heads),
            temporal: temporal::Buffers::default(),
            decoder: self.decoder.buffers(self.config.heads),
            quantised: Quantised::default(),
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
    /// Lays the weights out.
    fn lay_out(&self, precision: Precision) -> Result<Packed> {
        let (weight, bias) = self.values()?;
        Ok(Packed::new(&weight, bias, precision))
    }
}

impl LayerNorm {
    fn lay_out(&self) -> Result<Norm> {
        let (weight, bias) = self.values()?;
        Ok(Norm::new(weight, bias))
    }
}

/// All rows of `data`, `d` values each, close to each other.
fn rows(data: &[f32], d: usize) -> Rows<'_> {
    Rows { data, stride: d, count: data.len() / d }
}

fn all_finite(values: &[f32]) -> bool {
    // Zero times what is not finite is NaN.
    let sum: f32 = values.chunks(4096).map(|chunk| chunk.iter().map(|value| 0.0 * value).sum::<f32>()).sum();
    sum == 0.0
}

/// # Errors
/// If a value is not finite; names the step it came from.
fn finite(step: &str, values: &[f32]) -> Result<()> {
    match values.iter().position(|value| !value.is_finite()) {
        Some(at) => Err(Error::value(format!("network, {step}"), "finite numbers", format!("{} at {at}", values[at]))),
        None => Ok(()),
    }
}

/// The values of a contiguous f32 tensor on the CPU.
///
/// # Errors
/// If it is no such tensor.
pub fn with_values<R>(tensor: &Tensor, run: impl FnOnce(&[f32]) -> Result<R>) -> Result<R> {
    let mut result = None;
    super::ops::cpu::with_slice(&tensor.contiguous()?, |values| {
        result = Some(run(values));
        Ok(())
    })?;
    result.unwrap_or_else(|| Err(Error::value("tensor", "one on the CPU", "another")))
}
