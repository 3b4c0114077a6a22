//! The compiled tactile decoder. It has few rows, so reading the weights takes most of its time.

use egotac_kernels::activations::Activations;
use egotac_kernels::attention::Attention;
use egotac_kernels::norm::{Norm, modulated};
use egotac_kernels::packed::{Packed, Then};
use egotac_kernels::rows::Rows;

use crate::error::Result;
use crate::model::attention::EPS;
use crate::model::decoder as layers;
use crate::model::finite::check_finite;
use crate::model::precision::Precision;

/// Weights of the decoder.
#[derive(Debug, Clone)]
pub struct Decoder {
    queries: Vec<f32>, // (K, d)
    layers: Vec<Layer>,
    norm: Norm,
    force_head: Packed,
    contact_head: Packed,
}

#[derive(Debug, Clone)]
struct Layer {
    ada_attn: Packed,
    ada_mlp: Packed,
    /// Queries, keys and values side by side; the values alone if K = 1, where the softmax over the single key is 1.
    qkv: Packed,
    out: Packed,
    fc1: Packed,
    fc2: Packed,
}

/// Intermediate results of a batch.
#[derive(Debug, Clone)]
pub struct Buffers {
    condition: Vec<f32>,  // (B, d)
    modulation: Vec<f32>, // (B, 2 d)
    h: Vec<f32>,          // (B K, d)
    x: Vec<f32>,          // (B K, d)
    qkv: Vec<f32>,        // (B K, d) or (B K, 3 d)
    hidden: Vec<f32>,     // (B K, 4 d)
    attention: Attention,
}

impl Decoder {
    /// Packs the layers.
    pub fn new(from: layers::Decoder, precision: Precision) -> Result<Self> {
        let steps = from.queries.dim(0)?;
        let layer = |layer| Layer::new(layer, steps, precision);
        // In f32 also for int8: the heads are small, and no layer behind them averages their rounding.
        let heads = precision.of_small_layers();
        Ok(Self {
            queries: from.queries.flatten_all()?.to_vec1()?,
            layers: from.layers.into_iter().map(layer).collect::<Result<_>>()?,
            norm: from.norm.pack()?,
            force_head: from.force_head.pack(heads)?,
            contact_head: from.contact_head.pack(heads)?,
        })
    }

    /// Bytes of the weights.
    pub fn bytes(&self) -> usize {
        let layers = self.layers.iter().flat_map(|l| [&l.ada_attn, &l.ada_mlp, &l.qkv, &l.out, &l.fc1, &l.fc2]);
        let all = layers.chain([&self.force_head, &self.contact_head]);
        all.map(|layer| layer.bytes()).sum::<usize>() + 4 * self.queries.len()
    }

    /// K: tactile steps.
    pub fn steps(&self) -> usize {
        self.queries.len() / self.norm.d()
    }

    /// Creates empty buffers; they grow with the batch.
    pub fn buffers(&self, heads: usize, precision: Precision) -> Buffers {
        let empty = Vec::new;
        Buffers {
            condition: empty(),
            modulation: empty(),
            h: empty(),
            x: empty(),
            qkv: empty(),
            hidden: empty(),
            attention: Attention::new(self.steps(), self.norm.d(), heads, precision.format()),
        }
    }

    /// Decodes scene vectors `z`, `(B, d)`, into `force` and `contact` logits, `(B, K, 1556)` each.
    ///
    /// # Errors
    /// With `checked`: if the result of a step is not finite; names the first one.
    pub fn forward(
        &self,
        z: &[f32],
        force: &mut [f32],
        contact: &mut [f32],
        buffers: &mut Buffers,
        buffer: &mut Activations,
        checked: bool,
    ) -> Result<()> {
        let (d, steps) = (self.norm.d(), self.steps());
        let batch = z.len() / d;
        buffers.size(batch, steps, d);
        let Buffers { condition, modulation, h, x, qkv, hidden, attention } = buffers;
        for (condition, z) in condition.iter_mut().zip(z) {
            *condition = z / (1.0 + (-z).exp());
        }
        for h in h.chunks_exact_mut(self.queries.len()) {
            h.copy_from_slice(&self.queries);
        }
        for (i, layer) in self.layers.iter().enumerate() {
            layer.ada_attn.forward(Rows::new(condition, d), modulation, 2 * d, Then::Store, buffer);
            modulate(h, modulation, steps, d, x);
            let wide = layer.qkv.n();
            layer.qkv.forward(Rows::new(x, d), qkv, wide, Then::Store, buffer);
            let attended = match steps {
                1 => Rows::new(qkv, d),
                _ => {
                    for (qkv, x) in qkv.chunks_exact(steps * wide).zip(x.chunks_exact_mut(steps * d)) {
                        attention.forward(qkv, x, buffer);
                    }
                    Rows::new(x, d)
                }
            };
            layer.out.forward(attended, h, d, Then::Add, buffer);
            if checked {
                check_finite(&format!("decoder.{i}.attn"), h)?;
            }
            layer.ada_mlp.forward(Rows::new(condition, d), modulation, 2 * d, Then::Store, buffer);
            modulate(h, modulation, steps, d, x);
            layer.fc1.forward(Rows::new(x, d), hidden, 4 * d, Then::Gelu, buffer);
            layer.fc2.forward(Rows::new(hidden, 4 * d), h, d, Then::Add, buffer);
            if checked {
                check_finite(&format!("decoder.{i}.mlp"), h)?;
            }
        }
        self.norm.forward(Rows::new(h, d), x);
        self.force_head.forward(Rows::new(x, d), force, self.force_head.n(), Then::Store, buffer);
        self.contact_head.forward(Rows::new(x, d), contact, self.contact_head.n(), Then::Store, buffer);
        if checked {
            check_finite("force_head", force)?;
            check_finite("contact_head", contact)?;
        }
        Ok(())
    }
}

/// Applies AdaLN to each row, with γ and β of the row's clip.
fn modulate(h: &[f32], modulation: &[f32], steps: usize, d: usize, out: &mut [f32]) {
    for (row, (h, out)) in h.chunks_exact(d).zip(out.chunks_exact_mut(d)).enumerate() {
        let (gamma, beta) = modulation[row / steps * 2 * d..][..2 * d].split_at(d);
        modulated(h, gamma, beta, EPS as f32, out);
    }
}

impl Layer {
    fn new(from: layers::DecoderLayer, steps: usize, precision: Precision) -> Result<Self> {
        let layers::DecoderLayer { ada_attn, ada_mlp, attn, mlp } = from;
        let (qkv, out) = match steps {
            1 => attn.value_and_out()?,
            _ => attn.parts()?,
        };
        let (fc1, fc2) = mlp.parts();
        Ok(Self {
            ada_attn: ada_attn.linear.pack(precision)?,
            ada_mlp: ada_mlp.linear.pack(precision)?,
            qkv: qkv.pack(precision)?,
            out: out.pack(precision)?,
            fc1: fc1.pack(precision)?,
            fc2: fc2.pack(precision)?,
        })
    }
}

impl Buffers {
    fn size(&mut self, batch: usize, steps: usize, d: usize) {
        let wide = if steps == 1 { d } else { 3 * d };
        self.condition.resize(batch * d, 0.0);
        self.modulation.resize(batch * 2 * d, 0.0);
        self.h.resize(batch * steps * d, 0.0);
        self.x.resize(batch * steps * d, 0.0);
        self.qkv.resize(batch * steps * wide, 0.0);
        self.hidden.resize(batch * steps * 4 * d, 0.0);
    }
}
