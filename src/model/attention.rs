//! Linear layers, layer norms and attention blocks that encoder, temporal fusion and decoder share.

use candle_core::{D, Result, Tensor};
use candle_nn::VarBuilder;
use egotac_kernels::ops;

use super::init::Scheme;

/// Epsilon of every layer norm.
pub const EPS: f64 = 1e-6;

/// `x Wᵀ + b`.
#[derive(Debug, Clone)]
pub struct Linear {
    weight: Tensor, // (n, k)
    bias: Tensor,   // (n)
}

impl Linear {
    /// Tensors `weight` `(n, k)` and `bias` `(n)` of `vb`.
    pub fn new(k: usize, n: usize, scheme: Scheme, vb: VarBuilder) -> Result<Self> {
        let weight = vb.get_with_hints((n, k), "weight", scheme.weight(k))?;
        let bias = vb.get_with_hints(n, "bias", scheme.bias(k))?;
        Ok(Self { weight, bias })
    }

    /// A convolution over RGB patches, stride = kernel = `patch`, as a linear layer over their 3 · patch² values:
    /// tensors `weight` `(n, 3, patch, patch)` and `bias` `(n)` of `vb`.
    pub fn patches(n: usize, patch: usize, vb: VarBuilder) -> Result<Self> {
        let k = 3 * patch * patch;
        let weight = vb.get_with_hints((n, 3, patch, patch), "weight", Scheme::Dinov2.weight(k))?.reshape((n, k))?;
        let bias = vb.get_with_hints(n, "bias", Scheme::Dinov2.bias(k))?;
        Ok(Self { weight, bias })
    }

    /// `x`: `(.., k)`. Returns `(.., n)`.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        ops::linear(x, &self.weight, &self.bias)
    }

    /// Self-attention of the layer's outputs: queries, keys and values side by side. `x`: `(B, N, k)`.
    fn attend(&self, x: &Tensor, heads: usize) -> Result<Tensor> {
        ops::self_attention(x, &self.weight, &self.bias, heads)
    }

    /// Weight `(n, k)` and bias `(n)`, in rows.
    pub fn values(&self) -> Result<(Vec<f32>, Vec<f32>)> {
        Ok((self.weight.flatten_all()?.to_vec1()?, self.bias.to_vec1()?))
    }

    /// The layer whose outputs are scaled by `scale`, `(n)`.
    pub fn scaled(&self, scale: &Tensor) -> Result<Self> {
        let weight = self.weight.broadcast_mul(&scale.unsqueeze(1)?)?;
        Ok(Self { weight, bias: (&self.bias * scale)? })
    }

    /// One layer whose output is the layers' outputs side by side.
    fn packed(layers: &[Linear; 3]) -> Result<Self> {
        let weight = Tensor::cat(&layers.each_ref().map(|layer| &layer.weight), 0)?;
        let bias = Tensor::cat(&layers.each_ref().map(|layer| &layer.bias), 0)?;
        Ok(Self { weight, bias })
    }
}

/// Layer norm over the last dimension with weight and bias.
#[derive(Debug, Clone)]
pub struct LayerNorm {
    weight: Tensor, // (d)
    bias: Tensor,   // (d)
}

impl LayerNorm {
    /// Tensors `weight` and `bias` `(d)` of `vb`.
    pub fn new(d: usize, vb: VarBuilder) -> Result<Self> {
        let weight = vb.get_with_hints(d, "weight", candle_nn::Init::Const(1.0))?;
        let bias = vb.get_with_hints(d, "bias", candle_nn::Init::Const(0.0))?;
        Ok(Self { weight, bias })
    }

    /// Weight and bias, `(d)` each.
    pub fn values(&self) -> Result<(Vec<f32>, Vec<f32>)> {
        Ok((self.weight.to_vec1()?, self.bias.to_vec1()?))
    }

    /// `x`: `(.., d)`.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        ops::layer_norm(x, Some((&self.weight, &self.bias)), EPS)
    }
}

/// Two linear layers with an exact GELU between, four times as wide inside.
#[derive(Debug, Clone)]
pub struct Mlp {
    fc1: Linear,
    fc2: Linear,
}

impl Mlp {
    /// Hidden channels per channel of the stream.
    pub const EXPANSION: usize = 4;

    /// Tensors `fc1`, `fc2` of `vb`.
    pub fn new(d: usize, scheme: Scheme, vb: VarBuilder) -> Result<Self> {
        let fc1 = Linear::new(d, Self::EXPANSION * d, scheme, vb.pp("fc1"))?;
        let fc2 = Linear::new(Self::EXPANSION * d, d, scheme, vb.pp("fc2"))?;
        Ok(Self { fc1, fc2 })
    }

    /// Both layers.
    pub fn parts(self) -> (Linear, Linear) {
        (self.fc1, self.fc2)
    }

    /// `x`: `(.., d)`.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        ops::gelu_linear(&self.fc1.forward(x)?, &self.fc2.weight, &self.fc2.bias)
    }
}

/// Multi-head self-attention.
///
/// Queries, keys and values come from one matrix product over the three weights side by side, so that the input is
/// read once and the backward pass gives its gradient in one product too.
#[derive(Debug, Clone)]
pub struct SelfAttention {
    qkv: Qkv,
    out: Linear,
    heads: usize,
}

/// The three projections as the checkpoint has them (they may be trained), or packed once for inference.
#[derive(Debug, Clone)]
enum Qkv {
    Parts(Box<[Linear; 3]>),
    Packed(Linear),
}

/// Where the four linear layers of a self-attention lie below its `vb`.
pub struct AttentionNames {
    /// Query projection.
    pub q: &'static str,
    /// Key projection.
    pub k: &'static str,
    /// Value projection.
    pub v: &'static str,
    /// Output projection.
    pub out: &'static str,
}

/// Names in temporal fusion and decoder.
pub const OWN_NAMES: AttentionNames = AttentionNames { q: "q", k: "k", v: "v", out: "out" };

impl SelfAttention {
    /// Four `(d, d)` linear layers under `names` of `vb`.
    pub fn new(d: usize, heads: usize, names: &AttentionNames, scheme: Scheme, vb: VarBuilder) -> Result<Self> {
        let linear = |name| Linear::new(d, d, scheme, vb.pp(name));
        let parts = [linear(names.q)?, linear(names.k)?, linear(names.v)?];
        Ok(Self { qkv: Qkv::Parts(Box::new(parts)), out: linear(names.out)?, heads })
    }

    /// Packs the projections once; later changes of the parameters are not seen.
    pub fn freeze(&mut self) -> Result<()> {
        if let Qkv::Parts(parts) = &self.qkv {
            self.qkv = Qkv::Packed(Linear::packed(parts)?);
        }
        Ok(())
    }

    /// Attention weights of the first token: `x` `(B, N, d)`, returns `(B, heads, N)`.
    pub fn first_weights(&self, x: &Tensor) -> Result<Tensor> {
        let (b, n, d) = x.dims3()?;
        let qkv = match &self.qkv {
            Qkv::Parts(parts) => Linear::packed(parts)?.forward(x)?,
            Qkv::Packed(packed) => packed.forward(x)?,
        };
        let (heads, size) = (self.heads, d / self.heads);
        let part = |i: usize, count: usize| -> Result<Tensor> {
            let part = qkv.narrow(2, i * d, d)?.narrow(1, 0, count)?;
            part.reshape((b, count, heads, size))?.transpose(1, 2)?.contiguous()
        };
        let scores = (part(0, 1)?.matmul(&part(1, n)?.t()?)? / (size as f64).sqrt())?; // (B, heads, 1, N)
        candle_nn::ops::softmax(&scores, D::Minus1)?.reshape((b, heads, n))
    }

    /// The three projections as one layer, and the output projection.
    pub fn parts(self) -> Result<(Linear, Linear)> {
        match self.qkv {
            Qkv::Parts(parts) => Ok((Linear::packed(&parts)?, self.out)),
            Qkv::Packed(packed) => Ok((packed, self.out)),
        }
    }

    /// The value projection and the output projection: all there is for a single token.
    pub fn value_and_out(self) -> Result<(Linear, Linear)> {
        match self.qkv {
            Qkv::Parts(parts) => {
                let [_, _, value] = *parts;
                Ok((value, self.out))
            }
            Qkv::Packed(Linear { weight, bias }) => {
                let d = weight.dim(1)?;
                Ok((Linear { weight: weight.narrow(0, 2 * d, d)?, bias: bias.narrow(0, 2 * d, d)? }, self.out))
            }
        }
    }

    /// `x`: `(B, N, d)`. Returns `(B, N, d)`.
    ///
    /// The softmax over a single key is 1, so for N = 1 the result is the value, and query and key get no gradient
    /// (it is zero).
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let y = match &self.qkv {
            Qkv::Parts(parts) if x.dim(1)? == 1 => parts[2].forward(x)?,
            Qkv::Parts(parts) => Linear::packed(parts)?.attend(x, self.heads)?,
            Qkv::Packed(packed) if x.dim(1)? == 1 => {
                let d = x.dim(D::Minus1)?;
                ops::linear(x, &packed.weight.narrow(0, 2 * d, d)?, &packed.bias.narrow(0, 2 * d, d)?)?
            }
            Qkv::Packed(packed) => packed.attend(x, self.heads)?,
        };
        self.out.forward(&y)
    }
}

/// Multi-head attention of one learned query, the same for the whole batch, over many tokens.
///
/// With one query per head the key projection can be moved over to it, `qₕ·(Wₖ x) = (Wₖᵀ qₕ)·x`, and the value
/// projection behind the weighted sum, `Σ a (Wᵥ x) = Wᵥ (Σ a x)`: two products with `heads` columns instead of two
/// with `d`. The bias of the key adds the same to every score, so the softmax drops it.
#[derive(Debug, Clone)]
pub struct PooledAttention {
    q: Linear,
    k: Linear,
    /// Value projection.
    pub v: Linear,
    /// Output projection.
    pub out: Linear,
    /// Heads.
    pub heads: usize,
}

impl PooledAttention {
    /// Tensors `q`, `k`, `v`, `out` of `vb`.
    pub fn new(d: usize, heads: usize, vb: VarBuilder) -> Result<Self> {
        let linear = |name| Linear::new(d, d, Scheme::Torch, vb.pp(name));
        Ok(Self { q: linear("q")?, k: linear("k")?, v: linear("v")?, out: linear("out")?, heads })
    }

    /// The query of each head through the key weights, over √size: `(heads, d)`. `query`: `(1, d)`.
    pub fn folded(&self, query: &Tensor) -> Result<Tensor> {
        let d = query.dim(D::Minus1)?;
        let (heads, size) = (self.heads, d / self.heads);
        let q = (self.q.forward(query)?.reshape((heads, 1, size))? / (size as f64).sqrt())?;
        q.matmul(&self.k.weight.reshape((heads, size, d))?)?.reshape((heads, d))
    }

    /// Attention weights. `query`: `(1, d)`, `tokens`: `(B, N, d)`. Returns `(B, heads, N)`.
    pub fn weights(&self, query: &Tensor, tokens: &Tensor) -> Result<Tensor> {
        let (b, n, d) = tokens.dims3()?;
        let scores = tokens.reshape((b * n, d))?.matmul(&self.folded(query)?.t()?)?.reshape((b, n, self.heads))?;
        candle_nn::ops::softmax(&scores.transpose(1, 2)?.contiguous()?, D::Minus1)
    }

    /// `query`: `(1, d)`, `tokens`: `(B, N, d)`. Returns `(B, d)`.
    pub fn forward(&self, query: &Tensor, tokens: &Tensor) -> Result<Tensor> {
        let (b, _, d) = tokens.dims3()?;
        let (heads, size) = (self.heads, d / self.heads);
        let weights = self.weights(query, tokens)?; // (B, heads, N)
        let pooled = weights.matmul(tokens)?; // (B, heads, d)
        let values = pooled
            .transpose(0, 1)?
            .contiguous()? // (heads, B, d)
            .matmul(&self.v.weight.reshape((heads, size, d))?.transpose(1, 2)?)? // (heads, B, size)
            .transpose(0, 1)?
            .reshape((b, d))?
            .broadcast_add(&self.v.bias)?;
        self.out.forward(&values)
    }
}
