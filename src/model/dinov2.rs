//! The DINOv2 vision encoder, with the tensor names of published checkpoints.

use candle_core::{Result, Tensor, bail};
use candle_nn::{Init, VarBuilder};
use egotac_kernels::ops;

use super::attention::{AttentionNames, LayerNorm, Linear, Mlp, SelfAttention};
use super::config::Config;
use super::init::{STD, Scheme};

const NAMES: AttentionNames =
    AttentionNames { q: "attention.query", k: "attention.key", v: "attention.value", out: "output.dense" };

/// Vision encoder: images to the last hidden state after the final layer norm, CLS token first.
#[derive(Debug, Clone)]
pub struct Dinov2 {
    pub(super) embeddings: Embeddings,
    pub(super) layers: Vec<Layer>,
    pub(super) layernorm: LayerNorm,
}

impl Dinov2 {
    /// Takes the tensors of `vb` under the names of published checkpoints.
    pub fn new(config: &Config, vb: VarBuilder) -> Result<Self> {
        let embeddings = Embeddings::new(config, vb.pp("embeddings"))?;
        let layers = (0..config.vision_depth)
            .map(|i| Layer::new(config, vb.pp(format!("encoder.layer.{i}"))))
            .collect::<Result<_>>()?;
        let layernorm = LayerNorm::new(config.vision_width, vb.pp("layernorm"))?;
        Ok(Self { embeddings, layers, layernorm })
    }

    /// Prepares for inference: packs projections and resamples position embeddings once.
    pub fn freeze(&mut self) -> Result<()> {
        self.embeddings.freeze()?;
        self.layers.iter_mut().try_for_each(|layer| layer.attention.freeze())
    }

    /// Computes the attention weights of the CLS token on the patches in one layer: `(N, heads, patches)`.
    pub fn attention(&self, frames: &Tensor, layer: usize) -> Result<Tensor> {
        let mut h = self.embeddings.forward(frames)?;
        for before in self.layers.iter().take(layer) {
            h = before.forward(&h)?;
        }
        let Some(layer) = self.layers.get(layer) else {
            bail!("layer {layer}: expected 0 to {}", self.layers.len().saturating_sub(1))
        };
        let weights = layer.attention.first_weights(&layer.norm1.forward(&h)?)?;
        let patches = self.embeddings.grid() * self.embeddings.grid();
        weights.narrow(2, h.dim(1)? - patches, patches)
    }

    /// Encodes frames, `(N, 3, H, W)`, ImageNet-normalised, H = W = `config.image`. Returns `(N, P, dv)`, CLS included.
    pub fn forward(&self, frames: &Tensor) -> Result<Tensor> {
        let mut h = self.embeddings.forward(frames)?;
        for layer in &self.layers {
            h = layer.forward(&h)?;
        }
        if let Some(registers) = &self.embeddings.register_tokens {
            let (first, count) = (1 + registers.dim(1)?, h.dim(1)?);
            h = Tensor::cat(&[&h.narrow(1, 0, 1)?, &h.narrow(1, first, count - first)?], 1)?;
        }
        self.layernorm.forward(&h)
    }
}

/// Patch projection, CLS token and position embeddings.
#[derive(Debug, Clone)]
pub struct Embeddings {
    cls_token: Tensor,               // (1, 1, dv)
    register_tokens: Option<Tensor>, // (1, registers, dv)
    projection: Linear,
    positions: Positions,
    image: usize,
    patch: usize,
}

/// Position embeddings: as learned, with the resampling to the input's grid, or already resampled.
#[derive(Debug, Clone)]
enum Positions {
    /// Embeddings `(1, 1 + g², dv)` of a grid of g² patches, and the matrix `(P - 1, g²)` unless both grids are the same.
    Learned(Tensor, Option<Tensor>),
    /// Embeddings of the input's grid, `(1, P, dv)`.
    Resampled(Tensor),
}

impl Embeddings {
    fn new(config: &Config, vb: VarBuilder) -> Result<Self> {
        let (dv, patch) = (config.vision_width, config.patch);
        let normal = Init::Randn { mean: 0.0, stdev: STD };
        let cls_token = vb.get_with_hints((1, 1, dv), "cls_token", normal)?;
        let (grid, learned_grid) = (config.grid(), config.pretrain_grid());
        let learned = vb.get_with_hints((1, 1 + learned_grid * learned_grid, dv), "position_embeddings", normal)?;
        let resample = match grid == learned_grid {
            true => None,
            false => Some(bicubic_grid(learned_grid, grid, config.registers > 0, &learned)?),
        };
        let register_tokens = match config.registers {
            0 => None,
            count => Some(vb.get_with_hints((1, count, dv), "register_tokens", normal)?),
        };
        let projection = Linear::patches(dv, patch, vb.pp("patch_embeddings.projection"))?;
        let positions = Positions::Learned(learned, resample);
        Ok(Self { cls_token, register_tokens, projection, positions, image: config.image, patch })
    }

    /// Patches along a side.
    fn grid(&self) -> usize {
        self.image / self.patch
    }

    fn freeze(&mut self) -> Result<()> {
        self.positions = Positions::Resampled(self.positions()?);
        Ok(())
    }

    /// Computes the position embeddings of the input's grid, `(1, P, dv)`.
    fn positions(&self) -> Result<Tensor> {
        match &self.positions {
            Positions::Resampled(positions) => Ok(positions.clone()),
            Positions::Learned(learned, None) => Ok(learned.clone()),
            Positions::Learned(learned, Some(resample)) => {
                let patches = learned.narrow(1, 1, learned.dim(1)? - 1)?.squeeze(0)?;
                let patches = resample.matmul(&patches)?.unsqueeze(0)?;
                Tensor::cat(&[&learned.narrow(1, 0, 1)?, &patches], 1)
            }
        }
    }

    fn forward(&self, frames: &Tensor) -> Result<Tensor> {
        let (n, channels, height, width) = frames.dims4()?;
        if (channels, height, width) != (3, self.image, self.image) {
            bail!("frames: expected shape (N, 3, {0}, {0}), got {1:?}", self.image, frames.dims());
        }
        // A convolution whose stride is its kernel is one matrix product over the patches' pixels.
        let (p, grid) = (self.patch, self.image / self.patch);
        let patches = frames
            .reshape((n, 3, grid, p, grid, p))?
            .permute((0, 2, 4, 1, 3, 5))? // (N, row, column, channel, y, x)
            .reshape((n, grid * grid, 3 * p * p))?;
        let patches = self.projection.forward(&patches)?;
        let cls = self.cls_token.broadcast_as((n, 1, patches.dim(2)?))?;
        let h = Tensor::cat(&[&cls, &patches], 1)?.broadcast_add(&self.positions()?)?;
        match &self.register_tokens {
            None => Ok(h),
            // After CLS, without position embeddings.
            Some(registers) => {
                let (_, count, dv) = registers.dims3()?;
                let registers = registers.broadcast_as((n, count, dv))?;
                Tensor::cat(&[&h.narrow(1, 0, 1)?, &registers, &h.narrow(1, 1, grid * grid)?], 1)
            }
        }
    }

    /// Returns the tokens before the image is added, `(1 + registers + patches, dv)`, row-major, and the patch projection.
    pub fn parts(self) -> Result<(Vec<f32>, Linear)> {
        let positions = self.positions()?;
        let cls = (&self.cls_token + positions.narrow(1, 0, 1)?)?;
        let patches = positions.narrow(1, 1, positions.dim(1)? - 1)?;
        let start = match &self.register_tokens {
            None => Tensor::cat(&[&cls, &patches], 1)?,
            Some(registers) => Tensor::cat(&[&cls, registers, &patches], 1)?,
        };
        Ok((start.flatten_all()?.to_vec1()?, self.projection))
    }
}

/// Pre-norm transformer layer with scaled residuals.
#[derive(Debug, Clone)]
pub struct Layer {
    pub(super) norm1: LayerNorm,
    pub(super) attention: SelfAttention,
    pub(super) layer_scale1: Tensor, // (dv)
    pub(super) norm2: LayerNorm,
    pub(super) mlp: Mlp,
    pub(super) layer_scale2: Tensor, // (dv)
}

impl Layer {
    fn new(config: &Config, vb: VarBuilder) -> Result<Self> {
        let dv = config.vision_width;
        let scale = |name: &str| vb.pp(name).get_with_hints(dv, "lambda1", Init::Const(1.0));
        Ok(Self {
            norm1: LayerNorm::new(dv, vb.pp("norm1"))?,
            attention: SelfAttention::new(dv, config.vision_heads, &NAMES, Scheme::Dinov2, vb.pp("attention"))?,
            layer_scale1: scale("layer_scale1")?,
            norm2: LayerNorm::new(dv, vb.pp("norm2"))?,
            mlp: Mlp::new(dv, Scheme::Dinov2, vb.pp("mlp"))?,
            layer_scale2: scale("layer_scale2")?,
        })
    }

    fn forward(&self, h: &Tensor) -> Result<Tensor> {
        let y = self.attention.forward(&self.norm1.forward(h)?)?;
        let h = ops::scaled_residual(h, &y, &self.layer_scale1)?;
        let y = self.mlp.forward(&self.norm2.forward(&h)?)?;
        ops::scaled_residual(&h, &y, &self.layer_scale2)
    }
}

/// Returns bicubic resampling of a square grid as a matrix, `(to², from²)`, equal to PyTorch's `interpolate`.
///
/// Half-pixel centres (`align_corners=False`). Without antialiasing: Keys' kernel with a = -0.75, borders repeated. With
/// antialiasing: a = -0.5, the kernel widened by the scale where the grid shrinks and cut off at borders. A matrix product
/// needs no backward pass of its own. The result has the type and device of `like`.
fn bicubic_grid(from: usize, to: usize, antialias: bool, like: &Tensor) -> Result<Tensor> {
    let line = if antialias { antialiased_line(from, to) } else { bicubic_line(from, to) }; // (to, from)
    let mut matrix = vec![0.0; to * to * from * from];
    for (row, weights) in matrix.chunks_exact_mut(from * from).enumerate() {
        let (y, x) = (row / to, row % to);
        for (column, weight) in weights.iter_mut().enumerate() {
            *weight = (line[y * from + column / from] * line[x * from + column % from]) as f32;
        }
    }
    Tensor::from_vec(matrix, (to * to, from * from), like.device())?.to_dtype(like.dtype())
}

/// Returns bicubic resampling of a line as a row-major matrix, `(to, from)`; rows sum to 1.
fn bicubic_line(from: usize, to: usize) -> Vec<f64> {
    let mut matrix = vec![0.0; to * from];
    for (i, weights) in matrix.chunks_exact_mut(from).enumerate() {
        let centre = (i as f64 + 0.5) * from as f64 / to as f64 - 0.5;
        for tap in -1..=2 {
            let at = centre.floor() + f64::from(tap);
            weights[(at.max(0.0) as usize).min(from - 1)] += keys(centre - at, -0.75);
        }
    }
    matrix
}

/// As [`bicubic_line`], with antialiasing.
fn antialiased_line(from: usize, to: usize) -> Vec<f64> {
    let scale = from as f64 / to as f64;
    let wider = scale.max(1.0);
    let mut matrix = vec![0.0; to * from];
    for (i, weights) in matrix.chunks_exact_mut(from).enumerate() {
        let centre = (i as f64 + 0.5) * scale;
        let first = (centre - 2.0 * wider + 0.5).max(0.0) as usize;
        let last = ((centre + 2.0 * wider + 0.5) as usize).min(from);
        for (at, weight) in weights.iter_mut().enumerate().take(last).skip(first) {
            *weight = keys((at as f64 + 0.5 - centre) / wider, -0.5);
        }
        let sum: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|weight| *weight /= sum);
    }
    matrix
}

/// Keys' cubic convolution kernel.
fn keys(x: f64, a: f64) -> f64 {
    let x = x.abs();
    match x {
        _ if x <= 1.0 => ((a + 2.0) * x - (a + 3.0)) * x * x + 1.0,
        _ if x < 2.0 => a * (((x - 5.0) * x + 8.0) * x - 4.0),
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bicubic_rows_sum_to_one_and_equal_grids_give_the_identity() {
        for (from, to) in [(5, 4), (4, 5), (37, 16), (2, 9), (1, 3)] {
            for matrix in [bicubic_line(from, to), antialiased_line(from, to)] {
                for row in matrix.chunks_exact(from) {
                    assert!((row.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{from} -> {to}: {row:?}");
                }
            }
        }
        let same = bicubic_line(3, 3);
        assert_eq!(same, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        assert_eq!(antialiased_line(3, 3), same);
    }
}
