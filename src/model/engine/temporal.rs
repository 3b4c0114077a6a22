//! The compiled temporal fusion. Its query is a learned constant, so the products with the key weights are computed once.
//!
//! Tasks take blocks of 64 tokens. Each computes scores against the block's own largest score; the last step rescales the
//! blocks to the largest of all (as in flash attention), so that no task waits for another.

use std::cell::RefCell;

use egotac_kernels::activations::Activations;
use egotac_kernels::norm::Norm;
use egotac_kernels::packed::{Packed, Then};
use egotac_kernels::rows::Rows;
use egotac_kernels::{simd, team};

use crate::error::Result;
use crate::model::finite::check_finite;
use crate::model::precision::Precision;
use crate::model::temporal::TemporalFusion;

/// Tokens of one task. Fixed, so that sums do not depend on the number of threads.
const TOKENS_PER_TASK: usize = 64;

thread_local! {
    /// Normalised tokens of a block and their scores for each head, kept so that a task allocates nothing.
    static SCRATCH: RefCell<(Vec<f32>, Vec<f32>)> = const { RefCell::new((Vec::new(), Vec::new())) };
}

/// Weights of the fusion.
#[derive(Debug, Clone)]
pub struct Temporal {
    heads: usize,
    proj: Packed,
    steps: Vec<f32>,  // (T, d)
    token: Vec<f32>,  // (d)
    folded: Vec<f32>, // (heads, d): the query through the key weights, over √size
    norm_kv: Norm,
    value: Vec<f32>,      // (d, d)
    value_bias: Vec<f32>, // (d)
    out: Packed,
    norm_mlp: Norm,
    fc1: Packed,
    fc2: Packed,
    norm_out: Norm,
}

/// Intermediate results of one window.
#[derive(Debug, Clone, Default)]
pub struct Buffers {
    partial: Vec<f32>, // per task and head: largest score, sum of exponentials, weighted sum (d)
    pooled: Vec<f32>,  // (heads, d)
    values: Vec<f32>,  // (d)
    h: Vec<f32>,       // (d)
    x: Vec<f32>,       // (d)
    hidden: Vec<f32>,  // (4 d)
}

impl Temporal {
    /// Packs the layers.
    pub fn new(from: TemporalFusion, precision: Precision) -> Result<Self> {
        let heads = from.attn.heads;
        let folded = from.folded_query()?;
        let (fc1, fc2) = from.mlp.parts();
        let (value, value_bias) = from.attn.v.values()?;
        Ok(Self {
            heads,
            proj: from.proj.pack(precision)?,
            steps: from.step_embedding.flatten_all()?.to_vec1()?,
            token: from.token.flatten_all()?.to_vec1()?,
            folded,
            norm_kv: from.norm_kv.pack()?,
            value,
            value_bias,
            out: from.attn.out.pack(precision)?,
            norm_mlp: from.norm_mlp.pack()?,
            fc1: fc1.pack(precision)?,
            fc2: fc2.pack(precision)?,
            norm_out: from.norm_out.pack()?,
        })
    }

    /// Bytes of the weights.
    pub fn bytes(&self) -> usize {
        let layers = [&self.proj, &self.out, &self.fc1, &self.fc2];
        let plain = self.steps.len() + self.token.len() + self.folded.len() + self.value.len() + self.value_bias.len();
        layers.iter().map(|layer| layer.bytes()).sum::<usize>() + 4 * plain
    }

    /// Projects tokens, `(rows, dv)`, into `out`, `(rows, d)`.
    pub fn project(&self, tokens: Rows, out: &mut [f32], buffer: &mut Activations) {
        self.proj.forward(tokens, out, self.token.len(), Then::Store, buffer);
    }

    /// Fuses one window, T times `(P, d)`, oldest first, into `z`, `(d)`.
    ///
    /// # Errors
    /// With `checked`: if the result of a step is not finite; names the first one.
    pub fn fuse(
        &self,
        frames: &[&[f32]],
        z: &mut [f32],
        buffers: &mut Buffers,
        buffer: &mut Activations,
        checked: bool,
    ) -> Result<()> {
        let (d, heads) = (self.token.len(), self.heads);
        let size = d / heads;
        buffers.size(d, heads, frames);
        let Buffers { partial, pooled, values, h, x, hidden } = buffers;
        let blocks = frames.first().map_or(0, |frame| (frame.len() / d).div_ceil(TOKENS_PER_TASK));
        team::chunks(partial, heads * (2 + d), |i, out| {
            let (frame, first) = (i / blocks, i % blocks * TOKENS_PER_TASK * d);
            let data = &frames[frame][first..frames[frame].len().min(first + TOKENS_PER_TASK * d)];
            let step = &self.steps[frame * d..(frame + 1) * d];
            SCRATCH.with_borrow_mut(|(tokens, scores)| {
                tokens.resize(TOKENS_PER_TASK * d, 0.0);
                scores.resize(heads * TOKENS_PER_TASK, 0.0);
                self.block(data, step, tokens, scores, out);
            });
        });
        self.combine(partial, pooled);
        if checked {
            check_finite("temporal.attn", pooled)?;
        }
        for (i, (value, bias)) in values.iter_mut().zip(&self.value_bias).enumerate() {
            let (row, pooled) = (&self.value[i * d..(i + 1) * d], &pooled[i / size * d..(i / size + 1) * d]);
            *value = bias
                + simd::dispatch(
                    #[inline(always)]
                    || simd::dot(row, pooled),
                );
        }
        h.copy_from_slice(&self.token);
        self.out.forward(Rows::new(values, d), h, d, Then::Add, buffer);
        self.norm_mlp.row(h, x);
        self.fc1.forward(Rows::new(x, d), hidden, 4 * d, Then::Gelu, buffer);
        self.fc2.forward(Rows::new(hidden, 4 * d), h, d, Then::Add, buffer);
        self.norm_out.row(h, z);
        if checked {
            check_finite("temporal.norm_out", z)?;
        }
        Ok(())
    }

    /// Computes for up to [`TOKENS_PER_TASK`] tokens and each head: the largest score, the sum of the exponentials relative to
    /// it, and the sum of the tokens weighted by them.
    fn block(&self, data: &[f32], step: &[f32], tokens: &mut [f32], scores: &mut [f32], out: &mut [f32]) {
        let d = step.len();
        let count = data.len() / d;
        for (x, token) in data.chunks_exact(d).zip(tokens.chunks_exact_mut(d)) {
            self.norm_kv.shifted_row(x, step, token);
        }
        for (head, out) in out.chunks_exact_mut(2 + d).enumerate() {
            let query = &self.folded[head * d..(head + 1) * d];
            let scores = &mut scores[head * TOKENS_PER_TASK..head * TOKENS_PER_TASK + count];
            simd::dispatch(
                #[inline(always)]
                || {
                    for (score, token) in scores.iter_mut().zip(tokens.chunks_exact(d)) {
                        *score = simd::dot(query, token);
                    }
                    let largest = simd::max(scores);
                    let mut sum = 0.0;
                    let (statistics, weighted) = out.split_at_mut(2);
                    weighted.fill(0.0);
                    for (score, token) in scores.iter().zip(tokens.chunks_exact(d)) {
                        let weight = simd::exp(score - largest);
                        sum += weight;
                        for (total, value) in weighted.iter_mut().zip(token) {
                            *total = weight.mul_add(*value, *total);
                        }
                    }
                    statistics[0] = largest;
                    statistics[1] = sum;
                },
            );
        }
    }

    /// Adds the sums of all blocks, each rescaled from its own largest score to the largest of all.
    fn combine(&self, partial: &[f32], pooled: &mut [f32]) {
        let d = self.token.len();
        let wide = 2 + d;
        for (head, pooled) in pooled.chunks_exact_mut(d).enumerate() {
            let parts = || partial.chunks_exact(self.heads * wide).map(|task| &task[head * wide..(head + 1) * wide]);
            let largest = parts().fold(f32::NEG_INFINITY, |largest, part| largest.max(part[0]));
            let total: f32 = parts().map(|part| part[1] * simd::exp(part[0] - largest)).sum();
            pooled.fill(0.0);
            for part in parts() {
                let weight = simd::exp(part[0] - largest) / total;
                for (pooled, value) in pooled.iter_mut().zip(&part[2..]) {
                    *pooled += weight * value;
                }
            }
        }
    }
}

impl Buffers {
    fn size(&mut self, d: usize, heads: usize, frames: &[&[f32]]) {
        let blocks: usize = frames.iter().map(|frame| (frame.len() / d).div_ceil(TOKENS_PER_TASK)).sum();
        self.partial.resize(blocks * heads * (2 + d), 0.0);
        self.pooled.resize(heads * d, 0.0);
        for buffer in [&mut self.values, &mut self.h, &mut self.x] {
            buffer.resize(d, 0.0);
        }
        self.hidden.resize(4 * d, 0.0);
    }
}
