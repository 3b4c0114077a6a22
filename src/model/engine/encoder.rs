//! The compiled vision encoder: one frame at a time, through one set of buffers.

use std::ops::Range;

use egotac_kernels::activations::Activations;
use egotac_kernels::attention::Attention;
use egotac_kernels::norm::Norm;
use egotac_kernels::packed::{Format, Packed, Then};
use egotac_kernels::rows::Rows;

use crate::error::{Error, Result};
use crate::model::config::Config;
use crate::model::dinov2::{self, Dinov2};
use crate::model::finite::check_finite;
use crate::model::precision::Precision;

/// Patches of a frame that all layers compute anew; the others leave after the first layers, and their tokens stay those of an
/// earlier frame.
#[derive(Debug, Clone, Copy)]
pub struct ChangedPatches<'a> {
    /// Number of layers that all patches pass.
    pub after: usize,
    /// Indices of the patches, ascending, at least one.
    pub patches: &'a [usize],
}

/// Weights of the encoder.
#[derive(Debug, Clone)]
pub struct Encoder {
    image: usize,
    patch: usize,
    registers: usize,
    projection: Packed,
    /// Tokens before the image is added: CLS, registers, position embedding of each patch, `(1 + registers + patches, dv)`.
    start: Vec<f32>,
    layers: Vec<Layer>,
    norm: Norm,
}

/// One layer. The scales of its residuals are multiplied into `out` and `fc2`.
#[derive(Debug, Clone)]
struct Layer {
    norm1: Norm,
    qkv: Packed,
    out: Packed,
    norm2: Norm,
    fc1: Packed,
    fc2: Packed,
}

/// Intermediate results of one frame.
#[derive(Debug, Clone)]
pub struct Buffers {
    patches: Vec<f32>,   // (patches, 3 · patch²)
    h: Vec<f32>,         // (tokens, dv)
    qkv: Activations,    // (tokens, 3 dv)
    hidden: Activations, // (tokens, 4 dv)
    attention: Attention,
    /// Attention of the last part, and its number of tokens.
    part: Option<(usize, Attention)>,
    heads: usize,
    format: Format,
}

impl Encoder {
    /// Packs the layers; each is freed once it is packed.
    pub fn new(config: &Config, from: Dinov2, precision: Precision) -> Result<Self> {
        let (start, projection) = from.embeddings.parts()?;
        let layers = from.layers.into_iter().map(|layer| Layer::new(layer, precision)).collect::<Result<_>>()?;
        Ok(Self {
            image: config.image,
            patch: config.patch,
            registers: config.registers,
            // In f32 also for int8: a hundredth of the work, and its input has no layer norm before it.
            projection: projection.pack(precision.of_small_layers())?,
            start,
            layers,
            norm: from.layernorm.pack()?,
        })
    }

    /// Bytes of the weights.
    pub fn bytes(&self) -> usize {
        let layers = self.layers.iter().map(|l| l.qkv.bytes() + l.out.bytes() + l.fc1.bytes() + l.fc2.bytes());
        self.projection.bytes() + 4 * self.start.len() + layers.sum::<usize>()
    }

    fn dv(&self) -> usize {
        self.norm.d()
    }

    fn tokens(&self) -> usize {
        self.start.len() / self.dv()
    }

    /// Creates the buffers of one frame.
    pub fn buffers(&self, heads: usize, precision: Precision) -> Buffers {
        let (tokens, dv) = (self.tokens(), self.dv());
        let patches = tokens - 1 - self.registers;
        Buffers {
            patches: vec![0.0; patches * 3 * self.patch * self.patch],
            h: vec![0.0; tokens * dv],
            qkv: Activations::default(),
            hidden: Activations::default(),
            attention: Attention::new(tokens, dv, heads, precision.format()),
            part: None,
            heads,
            format: precision.format(),
        }
    }

    /// Encodes one frame, `(3, H, W)`, into `out`, `(P, dv)`. With `part`, `out` must hold the tokens of an earlier frame, and only
    /// those of CLS and of its patches are replaced.
    ///
    /// # Errors
    /// With `checked`: if the result of a step is not finite; names the first one.
    pub fn forward(
        &self,
        frame: &[f32],
        part: Option<ChangedPatches>,
        out: &mut [f32],
        buffers: &mut Buffers,
        buffer: &mut Activations,
        checked: bool,
    ) -> Result<()> {
        let (dv, lead) = (self.dv(), 1 + self.registers);
        let Buffers { patches, h, qkv, hidden, attention, part: smaller, heads, format } = buffers;
        if checked {
            check_finite("images", frame)?;
        }
        self.gather(frame, patches);
        h.copy_from_slice(&self.start);
        let size = 3 * self.patch * self.patch;
        let place = &mut h[lead * dv..];
        self.projection.forward(Rows::new(patches, size), place, dv, Then::Add, buffer);
        if checked {
            check_finite("encoder.embeddings", h)?;
        }
        let after = part.map_or(self.layers.len(), |part| part.after.min(self.layers.len()));
        let mut run = |layers: Range<usize>, h: &mut [f32], attention: &mut Attention| {
            for i in layers {
                let layer = &self.layers[i];
                layer.norm1.apply_into(Rows::new(h, dv), buffer, layer.qkv.form());
                layer.qkv.apply_into(buffer, qkv, attention.form(), Then::Store);
                attention.apply_into(qkv, buffer, layer.out.form());
                layer.out.apply(buffer, h, dv, Then::Add);
                if checked {
                    check_finite(&format!("encoder.encoder.layer.{i}.attention"), h)?;
                }
                layer.norm2.apply_into(Rows::new(h, dv), buffer, layer.fc1.form());
                layer.fc1.apply_into(buffer, hidden, layer.fc2.form(), Then::Gelu);
                layer.fc2.apply(hidden, h, dv, Then::Add);
                if checked {
                    check_finite(&format!("encoder.encoder.layer.{i}.mlp"), h)?;
                }
            }
            Ok::<(), Error>(())
        };
        run(0..after, h, attention)?;
        if let Some(ChangedPatches { patches, .. }) = part {
            // The rows of the part move up behind CLS and registers.
            for (to, from) in patches.iter().enumerate() {
                h.copy_within((lead + from) * dv..(lead + from + 1) * dv, (lead + to) * dv);
            }
            let count = lead + patches.len();
            if smaller.as_ref().is_none_or(|(tokens, _)| *tokens != count) {
                *smaller = Some((count, Attention::new(count, dv, *heads, *format)));
            }
            if let Some((_, attention)) = smaller {
                run(after..self.layers.len(), &mut h[..count * dv], attention)?;
            }
        }
        // CLS, then the patches; the registers between them have served their purpose.
        self.norm.forward(Rows::new(&h[..dv], dv), &mut out[..dv]);
        match part {
            None => self.norm.forward(Rows::new(&h[lead * dv..], dv), &mut out[dv..]),
            Some(ChangedPatches { patches, .. }) => {
                for (from, to) in patches.iter().enumerate() {
                    let row = &h[(lead + from) * dv..(lead + from + 1) * dv];
                    self.norm.forward(Rows::new(row, dv), &mut out[(1 + to) * dv..(2 + to) * dv]);
                }
            }
        }
        if checked {
            check_finite("encoder.layernorm", out)?;
        }
        Ok(())
    }

    /// Copies the pixels of each patch into one row, in the order channel, row, column.
    fn gather(&self, frame: &[f32], patches: &mut [f32]) {
        let (side, patch) = (self.image, self.patch);
        let grid = side / patch;
        for (at, out) in patches.chunks_exact_mut(3 * patch * patch).enumerate() {
            let (top, left) = (at / grid * patch, at % grid * patch);
            for (line, out) in out.chunks_exact_mut(patch).enumerate() {
                let (channel, y) = (line / patch, line % patch);
                let first = (channel * side + top + y) * side + left;
                out.copy_from_slice(&frame[first..first + patch]);
            }
        }
    }
}

impl Layer {
    fn new(from: dinov2::Layer, precision: Precision) -> Result<Self> {
        let dinov2::Layer { norm1, attention, layer_scale1, norm2, mlp, layer_scale2 } = from;
        let (qkv, out) = attention.parts()?;
        let (fc1, fc2) = mlp.parts();
        Ok(Self {
            norm1: norm1.pack()?,
            qkv: qkv.pack(precision)?,
            out: out.scaled(&layer_scale1)?.pack(precision)?,
            norm2: norm2.pack()?,
            fc1: fc1.pack(precision)?,
            fc2: fc2.scaled(&layer_scale2)?.pack(precision)?,
        })
    }
}
