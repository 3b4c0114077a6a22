//! Multi-head self-attention and the projection before it, as one operation.

use std::sync::OnceLock;

use candle_core::{Result, Shape, Tensor, bail};
use rayon::prelude::*;

use super::cpu::{self, Operand, Operation};
use super::linear;
use super::matrix::{Factors, Mat, MatMut, Onto, Threads, multiply};
use crate::simd;

/// Most queries of one task: 64 rows of 257 scores are 66 KB, which stay in the cache of a core.
const TILE: usize = 64;

/// softmax(q kᵀ / √size) v per head, of q, k and v side by side, `x Wᵀ + b`.
struct SelfAttention {
    heads: usize,
    /// Format of the projections' products.
    factors: Factors,
    /// The projections, kept for the backward pass.
    qkv: OnceLock<Vec<f32>>,
}

/// See [`super::self_attention`].
pub fn self_attention(x: &Tensor, weight: &Tensor, bias: &Tensor, heads: usize) -> Result<Tensor> {
    cpu::apply(SelfAttention { heads, factors: Factors::current(), qkv: OnceLock::new() }, [x, weight, bias])
}

/// Sizes of one call: tokens, width, heads, width of a head, and 1/√(width of a head).
#[derive(Clone, Copy)]
struct Sizes {
    n: usize,
    d: usize,
    heads: usize,
    size: usize,
    scale: f32,
}

impl SelfAttention {
    fn sizes(&self, dims: &[usize]) -> Result<Sizes> {
        let heads = self.heads;
        match *dims {
            [_, n, d3] if heads > 0 && n > 0 && d3 > 0 && d3 % (3 * heads) == 0 => {
                let (d, size) = (d3 / 3, d3 / 3 / heads);
                Ok(Sizes { n, d, heads, size, scale: 1.0 / (size as f32).sqrt() })
            }
            _ => bail!("self-attention: {heads} heads, expected (B, N, 3 x a multiple of them), got {dims:?}"),
        }
    }
}

impl Operation for SelfAttention {
    const NAME: &'static str = "self-attention";

    fn forward(&self, operands: [Operand; 3]) -> Result<(Vec<f32>, Shape)> {
        let projected = linear::shape(operands.map(|operand| operand.dims()))?;
        let sizes = self.sizes(projected.dims())?;
        let Sizes { n, d, .. } = sizes;
        let [x, weight, bias] = operands;
        let qkv = linear::forward(x.values, weight, bias, self.factors);
        let mut out = cpu::filled(qkv.len() / 3, cpu::CHUNK, |_, _| {});
        let tile = tile_rows(n);
        let images = out.par_chunks_mut(n * d).zip(qkv.par_chunks(3 * n * d));
        images.for_each(|(out, qkv)| {
            out.par_chunks_mut(tile * d).enumerate().for_each_init(
                || vec![0.0; tile * n],
                |scores, (i, out)| sizes.forward_tile(qkv, i * tile, out, scores),
            );
        });
        // Fails only if the forward pass runs twice, with the same input and so the same values.
        let _ = self.qkv.set(qkv);
        Ok((out, Shape::from((projected.dims()[0], n, d))))
    }

    fn backward(&self, [x, weight, bias]: [&Tensor; 3], out: &Tensor, grad: &Tensor) -> Result<[Option<Tensor>; 3]> {
        let Some(qkv) = self.qkv.get() else { bail!("self-attention: backward without forward") };
        let (images, n, d) = out.dims3()?;
        let sizes = self.sizes(&[images, n, 3 * d])?;
        let dqkv = cpu::with_slice(out, |out| {
            cpu::with_slice(grad, |grad| {
                Ok(cpu::filled(qkv.len(), 3 * n * d, |image, dqkv| {
                    let (out, grad) = (cpu::block(out, image, n * d), cpu::block(grad, image, n * d));
                    sizes.backward_image(cpu::block(qkv, image, 3 * n * d), out, grad, dqkv);
                }))
            })
        })?;
        let dx = match x.track_op() {
            true => Some(cpu::tensor_like(linear::input_gradient(&dqkv, weight, x, self.factors)?, x)?),
            false => None,
        };
        let [dweight, dbias] =
            cpu::with_slice(x, |x| linear::parameter_gradients(x, weight, bias, &dqkv, self.factors))?;
        Ok([dx, dweight, dbias])
    }
}

impl Sizes {
    /// Returns queries, keys or values (`part` 0, 1, 2) of one head, from token `first` on: `(rows, size)`.
    fn part<'a>(&self, qkv: &'a [f32], part: usize, head: usize, first: usize, rows: usize) -> Mat<'a> {
        let start = 3 * self.d * first + part * self.d + head * self.size;
        Mat::new(&qkv[start..], rows, self.size, 3 * self.d)
    }

    /// Writes the attention weights of `rows` queries from `first` on into `scores`: `(rows, n)`.
    fn weights(&self, qkv: &[f32], head: usize, first: usize, rows: usize, scores: &mut [f32]) {
        let (q, k) = (self.part(qkv, 0, head, first, rows), self.part(qkv, 1, head, 0, self.n));
        multiply(MatMut::new(scores, rows, self.n, self.n), Onto::Nothing, self.scale, q, k.t(), Threads::One);
        simd::dispatch(
            #[inline(always)]
            || {
                for row in scores.chunks_exact_mut(self.n).take(rows) {
                    softmax(row);
                }
            },
        );
    }

    /// Attends with the queries from `first` on. `out`: `(rows, d)`.
    fn forward_tile(&self, qkv: &[f32], first: usize, out: &mut [f32], scores: &mut [f32]) {
        let Sizes { n, d, size, .. } = *self;
        let rows = out.len() / d;
        for head in 0..self.heads {
            self.weights(qkv, head, first, rows, scores);
            let (a, v) = (Mat::new(scores, rows, n, n), self.part(qkv, 2, head, 0, n));
            multiply(MatMut::new(&mut out[head * size..], rows, size, d), Onto::Nothing, 1.0, a, v, Threads::One);
        }
    }

    /// Computes the gradient of the projections of one image.
    ///
    /// With a the weights, o the output and g its gradient: dv = aᵀ g, s = a ∘ (g vᵀ - rowsum(g ∘ o)) / √size, dq = s k,
    /// dk = sᵀ q. The weights are computed again tile by tile: kept, they would be the largest tensors of the network.
    fn backward_image(&self, qkv: &[f32], out: &[f32], grad: &[f32], dqkv: &mut [f32]) {
        let Sizes { n, d, size, .. } = *self;
        let tile = tile_rows(n);
        let (mut weights, mut scores) = (vec![0.0; tile * n], vec![0.0; tile * n]);
        for head in 0..self.heads {
            let offset = head * size;
            let (k, v) = (self.part(qkv, 1, head, 0, n), self.part(qkv, 2, head, 0, n));
            for first in (0..n).step_by(tile) {
                let rows = tile.min(n - first);
                let q = self.part(qkv, 0, head, first, rows);
                let g = Mat::new(&grad[first * d + offset..], rows, size, d);
                self.weights(qkv, head, first, rows, &mut weights);
                let a = Mat::new(&weights, rows, n, n);
                let dv = MatMut::new(&mut dqkv[2 * d + offset..], n, size, 3 * d);
                multiply(dv, Onto::Existing, 1.0, a.t(), g, Threads::One);
                multiply(MatMut::new(&mut scores, rows, n, n), Onto::Nothing, 1.0, g, v.t(), Threads::One);
                simd::dispatch(
                    #[inline(always)]
                    || {
                        let lines = scores.chunks_exact_mut(n).zip(weights.chunks_exact(n));
                        for (row, (score, weight)) in lines.take(rows).enumerate() {
                            let at = (first + row) * d + offset;
                            let along = simd::dot(&grad[at..at + size], &out[at..at + size]);
                            for (score, weight) in score.iter_mut().zip(weight) {
                                *score = weight * (*score - along);
                            }
                        }
                    },
                );
                let s = Mat::new(&scores, rows, n, n);
                let dq = MatMut::new(&mut dqkv[first * 3 * d + offset..], rows, size, 3 * d);
                multiply(dq, Onto::Nothing, self.scale, s, k, Threads::One);
                let dk = MatMut::new(&mut dqkv[d + offset..], n, size, 3 * d);
                multiply(dk, Onto::Existing, self.scale, s.t(), q, Threads::One);
            }
        }
    }
}

/// Softmax of a row, in place. The largest value is subtracted first, so that nothing overflows.
#[inline(always)]
fn softmax(row: &mut [f32]) {
    let largest = simd::max(row);
    for x in row.iter_mut() {
        *x = simd::exp(*x - largest);
    }
    let scale = 1.0
        / simd::sum(
            row,
            #[inline(always)]
            |x| x,
        );
    for x in row.iter_mut() {
        *x *= scale;
    }
}

/// Returns the queries per task: at most [`TILE`], tasks of equal size, and an even number of them for an even number of
/// threads.
fn tile_rows(n: usize) -> usize {
    let tiles = n.div_ceil(TILE).next_multiple_of(2);
    n.div_ceil(tiles)
}
