//! Linear layers, layer norms and attention blocks, shared by encoder, temporal fusion and decoder.

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
    /// Takes the tensors `weight` `(n, k)` and `bias` `(n)` of `vb`.
    pub fn new(k: usize, n: usize, scheme: Scheme, vb: VarBuilder) -> Result<Self> {
        let weight = vb.get_with_hints((n, k), "weight", scheme.weight(k))?;
        let bias = vb.get_with_hints(n, "bias", scheme.bias(k))?;
        Ok(Self { weight, bias })
    }

    /// Takes a convolution over RGB patches, stride = kernel = `patch`, as a linear layer over their 3 · patch² values:
    /// tensors `weight` `(n, 3, patch, patch)` and `bias` `(n)` of `vb`.
    pub fn patches(n: usize, patch: usize, vb: VarBuilder) -> Result<Self> {
        let k = 3 * patch * patch;
        let weight = vb.get_with_hints((n, 3, patch, patch), "weight", Scheme::Dinov2.weight(k))?.reshape((n, k))?;
        let bias = vb.get_with_hints(n, "bias", Scheme::Dinov2.bias(k))?;
        Ok(Self { weight, bias })
    }

    /// Applies the layer. `x`: `(.., k)`. Returns `(.., n)`.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        ops::linear(x, &self.weight, &self.bias)
    }

    /// Computes self-attention over the layer's outputs: queries, keys and values side by side. `x`: `(B, N, k)`.
    fn attend(&self, x: &Tensor, heads: usize) -> Result<Tensor> {
        ops::self_attention(x, &self.weight, &self.bias, heads)
    }

    /// Returns weight `(n, k)`, row-major, and bias `(n)`.
    pub fn values(&self) -> Result<(Vec<f32>, Vec<f32>)> {
        Ok((self.weight.flatten_all()?.to_vec1()?, self.bias.to_vec1()?))
    }

    /// Returns the layer with its outputs scaled by `scale`, `(n)`.
    pub fn scaled(&self, scale: &Tensor) -> Result<Self> {
        let weight = self.weight.broadcast_mul(&scale.unsqueeze(1)?)?;
        Ok(Self { weight, bias: (&self.bias * scale)? })
    }

    /// Joins three layers into one whose output is theirs side by side.
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
    /// Takes the tensors `weight` and `bias` `(d)` of `vb`.
    pub fn new(d: usize, vb: VarBuilder) -> Result<Self> {
        let weight = vb.get_with_hints(d, "weight", candle_nn::Init::Const(1.0))?;
        let bias = vb.get_with_hints(d, "bias", candle_nn::Init::Const(0.0))?;
        Ok(Self { weight, bias })
    }

    /// Returns weight and bias, `(d)` each.
    pub fn values(&self) -> Result<(Vec<f32>, Vec<f32>)> {
        Ok((self.weight.to_vec1()?, self.bias.to_vec1()?))
    }

    /// Normalises the last dimension of `x`, `(.., d)`.
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
    /// Hidden channels per channel of the residual stream.
    pub const EXPANSION: usize = 4;

    /// Takes the tensors of `fc1` and `fc2` of `vb`.
    pub fn new(d: usize, scheme: Scheme, vb: VarBuilder) -> Result<Self> {
        let fc1 = Linear::new(d, Self::EXPANSION * d, scheme, vb.pp("fc1"))?;
        let fc2 = Linear::new(Self::EXPANSION * d, d, scheme, vb.pp("fc2"))?;
        Ok(Self { fc1, fc2 })
    }

    /// Returns both layers.
    pub fn parts(self) -> (Linear, Linear) {
        (self.fc1, self.fc2)
    }

    /// Applies both layers to `x`, `(.., d)`.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        ops::gelu_linear(&self.fc1.forward(x)?, &self.fc2.weight, &self.fc2.bias)
    }
}

/// Multi-head self-attention.
///
/// Queries, keys and values come from one matrix product over the three weights side by side: it reads the input once, and
/// the backward pass computes the gradient of the input in one product too.
#[derive(Debug, Clone)]
pub struct SelfAttention {
    qkv: Qkv,
    out: Linear,
    heads: usize,
}

/// The three projections: separate as in the checkpoint, to be trained, or packed once for inference.
#[derive(Debug, Clone)]
enum Qkv {
    Parts(Box<[Linear; 3]>),
    Packed(Linear),
}

/// Names of the four linear layers of a self-attention below its `vb`.
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

/// Names in the decoder.
pub const DECODER_NAMES: AttentionNames = AttentionNames { q: "q", k: "k", v: "v", out: "out" };

impl SelfAttention {
    /// Takes four `(d, d)` linear layers under `names` of `vb`.
    pub fn new(d: usize, heads: usize, names: &AttentionNames, scheme: Scheme, vb: VarBuilder) -> Result<Self> {
        let linear = |name| Linear::new(d, d, scheme, vb.pp(name));
        let parts = [linear(names.q)?, linear(names.k)?, linear(names.v)?];
        Ok(Self { qkv: Qkv::Parts(Box::new(parts)), out: linear(names.out)?, heads })
    }

    /// Packs the projections once; later changes of the parameters have no effect.
    pub fn freeze(&mut self) -> Result<()> {
        if let Qkv::Parts(parts) = &self.qkv {
            self.qkv = Qkv::Packed(Linear::packed(parts)?);
        }
        Ok(())
    }

    /// Computes the attention weights of the first token. `x`: `(B, N, d)`. Returns `(B, heads, N)`.
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

    /// Returns the three projections as one layer, and the output projection.
    pub fn parts(self) -> Result<(Linear, Linear)> {
        match self.qkv {
            Qkv::Parts(parts) => Ok((Linear::packed(&parts)?, self.out)),
            Qkv::Packed(packed) => Ok((packed, self.out)),
        }
    }

    /// Returns value and output projection, the only ones that matter for sequences of a single token.
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

    /// Attends. `x`: `(B, N, d)`. Returns `(B, N, d)`.
    ///
    /// The softmax over a single key is 1: for N = 1 the result is the projected value, and the gradients of query and key,
    /// which are zero, are not computed.
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

/// Multi-head attention of one learned query, which the whole batch shares, over many tokens.
///
/// With one query per head, the key projection can be applied to the query instead, `qₕ·(Wₖ x) = (Wₖᵀ qₕ)·x`, and the
/// value projection to the weighted sum, `Σ a (Wᵥ x) = Wᵥ (Σ a x)`: two products with `heads` columns instead of two
/// with `d`. The bias of the key adds the same number to every score, which the softmax cancels.
#[derive(Debug, Clone)]
pub struct PooledAttention {
    q: Linear,
    k: Linear,
    /// Value projection.
    pub v: Linear,
    /// Output projection.
    pub out: Linear,
    /// Number of heads.
    pub heads: usize,
}

impl PooledAttention {
    /// Takes the linear layers `q`, `k`, `v`, `out` of `vb`.
    pub fn new(d: usize, heads: usize, vb: VarBuilder) -> Result<Self> {
        let linear = |name| Linear::new(d, d, Scheme::Torch, vb.pp(name));
        Ok(Self { q: linear("q")?, k: linear("k")?, v: linear("v")?, out: linear("out")?, heads })
    }

    /// Multiplies the query of each head by the key weights, and divides by √size. `query`: `(1, d)`. Returns `(heads, d)`.
    pub fn folded_query(&self, query: &Tensor) -> Result<Tensor> {
        let d = query.dim(D::Minus1)?;
        let (heads, size) = (self.heads, d / self.heads);
        let q = (self.q.forward(query)?.reshape((heads, 1, size))? / (size as f64).sqrt())?;
        q.matmul(&self.k.weight.reshape((heads, size, d))?)?.reshape((heads, d))
    }

    /// Computes attention weights. `query`: `(1, d)`, `tokens`: `(B, N, d)`. Returns `(B, heads, N)`.
    pub fn weights(&self, query: &Tensor, tokens: &Tensor) -> Result<Tensor> {
        let (b, n, d) = tokens.dims3()?;
        let scores =
            tokens.reshape((b * n, d))?.matmul(&self.folded_query(query)?.t()?)?.reshape((b, n, self.heads))?;
        candle_nn::ops::softmax(&scores.transpose(1, 2)?.contiguous()?, D::Minus1)
    }

    /// Attends. `query`: `(1, d)`, `tokens`: `(B, N, d)`. Returns `(B, d)`.
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
