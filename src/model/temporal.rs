//! Temporal fusion of the tokens of an observation window into one scene vector.

use candle_core::{Result, Tensor, bail};
use candle_nn::{Init, VarBuilder};

use super::attention::{LayerNorm, Linear, Mlp, PooledAttention};
use super::config::Config;
use super::init::{STD, Scheme};

/// One pre-norm block: a learned token attends to all tokens of the window, then an MLP.
#[derive(Debug, Clone)]
pub struct TemporalFusion {
    pub(super) proj: Linear,
    pub(super) step_embedding: Tensor, // (T, d)
    pub(super) token: Tensor,          // (1, 1, d)
    norm_q: LayerNorm,
    pub(super) norm_kv: LayerNorm,
    pub(super) norm_mlp: LayerNorm,
    pub(super) norm_out: LayerNorm,
    pub(super) attn: PooledAttention,
    pub(super) mlp: Mlp,
}

impl TemporalFusion {
    /// Takes the tensors of `vb` under the names of the fields.
    pub fn new(config: &Config, vb: VarBuilder) -> Result<Self> {
        let d = config.width;
        let normal = Init::Randn { mean: 0.0, stdev: STD };
        let norm = |name: &str| LayerNorm::new(d, vb.pp(name));
        Ok(Self {
            proj: Linear::new(config.vision_width, d, Scheme::Torch, vb.pp("proj"))?,
            step_embedding: vb.get_with_hints((config.horizon, d), "step_embedding", normal)?,
            token: vb.get_with_hints((1, 1, d), "token", normal)?,
            norm_q: norm("norm_q")?,
            norm_kv: norm("norm_kv")?,
            norm_mlp: norm("norm_mlp")?,
            norm_out: norm("norm_out")?,
            attn: PooledAttention::new(d, config.heads, vb.pp("attn"))?,
            mlp: Mlp::new(d, Scheme::Torch, vb.pp("mlp"))?,
        })
    }

    /// Projects tokens to the width of the fusion. Depends on one frame alone, so a stream does it once per frame.
    ///
    /// `tokens`: `(.., P, dv)`. Returns `(.., P, d)`.
    pub fn project(&self, tokens: &Tensor) -> Result<Tensor> {
        self.proj.forward(tokens)
    }

    /// Returns the query of each head multiplied by the key weights, `(heads, d)`, row-major.
    pub fn folded_query(&self) -> Result<Vec<f32>> {
        let token = self.token.reshape((1, ()))?;
        self.attn.folded_query(&self.norm_q.forward(&token)?)?.flatten_all()?.to_vec1()
    }

    /// Computes the attention weights of the temporal token. `projected`: `(B, T, P, d)`. Returns `(B, heads, T, P)`.
    pub fn attention(&self, projected: &Tensor) -> Result<Tensor> {
        let (b, t, p, _) = projected.dims4()?;
        let token = self.token.reshape((1, ()))?;
        let weights = self.attn.weights(&self.norm_q.forward(&token)?, &self.keys(projected)?)?;
        weights.reshape((b, self.attn.heads, t, p))
    }

    /// Adds the embedding of its step to each token, and normalises. Returns `(B, T P, d)`.
    fn keys(&self, projected: &Tensor) -> Result<Tensor> {
        let (b, t, p, d) = projected.dims4()?;
        if t != self.step_embedding.dim(0)? {
            bail!("observation window: expected {} frames, got {t}", self.step_embedding.dim(0)?);
        }
        let steps = self.step_embedding.reshape((1, t, 1, d))?;
        self.norm_kv.forward(&projected.broadcast_add(&steps)?.reshape((b, t * p, d))?)
    }

    /// Fuses windows. `projected`: `(B, T, P, d)`, oldest frame first. Returns z, `(B, d)`.
    pub fn fuse(&self, projected: &Tensor) -> Result<Tensor> {
        let kv = self.keys(projected)?;
        let token = self.token.reshape((1, ()))?;
        let h = self.attn.forward(&self.norm_q.forward(&token)?, &kv)?.broadcast_add(&token)?; // (B, d)
        let h = (&h + self.mlp.forward(&self.norm_mlp.forward(&h)?)?)?;
        self.norm_out.forward(&h)
    }
}
