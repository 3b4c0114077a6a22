//! The tactile decoder: learned queries, conditioned on the scene vector, are decoded to force and contact.

use candle_core::{Result, Tensor};
use candle_nn::{Init, VarBuilder};
use egotac_kernels::ops;

use super::attention::{DECODER_NAMES, EPS, LayerNorm, Linear, Mlp, SelfAttention};
use super::config::Config;
use super::init::{STD, Scheme};
use crate::tactile::N_FIELD;

/// K learned queries, layers conditioned by AdaLN, and two heads.
#[derive(Debug, Clone)]
pub struct Decoder {
    pub(super) queries: Tensor, // (K, d)
    pub(super) layers: Vec<DecoderLayer>,
    pub(super) norm: LayerNorm,
    pub(super) force_head: Linear,
    pub(super) contact_head: Linear,
}

impl Decoder {
    /// Takes the tensors `queries`, `decoder.*`, `norm`, `force_head`, `contact_head` of `vb`, the network's root.
    pub fn new(config: &Config, vb: VarBuilder) -> Result<Self> {
        let d = config.width;
        let normal = Init::Randn { mean: 0.0, stdev: STD };
        let layers = (0..config.depth)
            .map(|i| DecoderLayer::new(config, vb.pp(format!("decoder.{i}"))))
            .collect::<Result<_>>()?;
        Ok(Self {
            queries: vb.get_with_hints((config.predict, d), "queries", normal)?,
            layers,
            norm: LayerNorm::new(d, vb.pp("norm"))?,
            force_head: Linear::new(d, N_FIELD, Scheme::Torch, vb.pp("force_head"))?,
            contact_head: Linear::new(d, N_FIELD, Scheme::Torch, vb.pp("contact_head"))?,
        })
    }

    /// Prepares for inference: packs projections.
    pub fn freeze(&mut self) -> Result<()> {
        self.layers.iter_mut().try_for_each(|layer| layer.attn.freeze())
    }

    /// Decodes scene vectors `z`, `(B, d)`. Returns normalised force and contact logits, `(B, K, 1556)` each.
    pub fn forward(&self, z: &Tensor) -> Result<(Tensor, Tensor)> {
        let (b, d) = z.dims2()?;
        let condition = z.silu()?;
        let mut h = self.queries.broadcast_as((b, self.queries.dim(0)?, d))?.contiguous()?;
        for layer in &self.layers {
            h = layer.forward(&h, &condition)?;
        }
        let h = self.norm.forward(&h)?;
        Ok((self.force_head.forward(&h)?, self.contact_head.forward(&h)?))
    }
}

/// Self-attention over the tactile steps, then an MLP, each after an AdaLN.
#[derive(Debug, Clone)]
pub struct DecoderLayer {
    pub(super) ada_attn: AdaLn,
    pub(super) ada_mlp: AdaLn,
    pub(super) attn: SelfAttention,
    pub(super) mlp: Mlp,
}

impl DecoderLayer {
    fn new(config: &Config, vb: VarBuilder) -> Result<Self> {
        let d = config.width;
        Ok(Self {
            ada_attn: AdaLn::new(d, vb.pp("ada_attn"))?,
            ada_mlp: AdaLn::new(d, vb.pp("ada_mlp"))?,
            attn: SelfAttention::new(d, config.heads, &DECODER_NAMES, Scheme::Torch, vb.pp("attn"))?,
            mlp: Mlp::new(d, Scheme::Torch, vb.pp("mlp"))?,
        })
    }

    /// Applies the layer. `h`: `(B, K, d)`, `condition`: SiLU(z), `(B, d)`.
    fn forward(&self, h: &Tensor, condition: &Tensor) -> Result<Tensor> {
        let h = (h + self.attn.forward(&self.ada_attn.forward(h, condition)?)?)?;
        &h + self.mlp.forward(&self.ada_mlp.forward(&h, condition)?)?
    }
}

/// Adaptive layer norm, `(1 + γ(z)) LN(h) + β(z)`. LN has no parameters of its own; the linear layer gives `[γ, β]`.
#[derive(Debug, Clone)]
pub struct AdaLn {
    pub(super) linear: Linear,
}

impl AdaLn {
    fn new(d: usize, vb: VarBuilder) -> Result<Self> {
        Ok(Self { linear: Linear::new(d, 2 * d, Scheme::Zero, vb.pp("linear"))? })
    }

    /// Normalises and modulates. `h`: `(B, K, d)`, `condition`: SiLU(z), `(B, d)`.
    fn forward(&self, h: &Tensor, condition: &Tensor) -> Result<Tensor> {
        ops::modulated_norm(h, &self.linear.forward(condition)?, EPS)
    }
}
