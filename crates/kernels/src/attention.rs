//! Self-attention of one sequence, for inference.
//!
//! Keys and values are packed into panels per head, as the weights of a layer are; queries are read where they lie. A task
//! computes the scores of a few queries, their exponentials and the weighted sum of the values while the scores are in its
//! own cache. The division by the sum of exponentials comes last, on the few outputs instead of the many weights.

use std::cell::RefCell;

use crate::aligned::Aligned;
use crate::packed::Shared;
use crate::simd;
use crate::team;
use crate::tile::{self, LANES, MOST_ROWS, TILES_PER_TASK, Tile, VECTORS};

thread_local! {
    /// Scores of the queries that this thread works on, kept so that a task allocates nothing.
    static SCORES: RefCell<Aligned<f32>> = RefCell::new(Aligned::zeros(0));
}

/// Multi-head self-attention with buffers for the keys and values of one sequence.
#[derive(Debug, Clone)]
pub struct Attention {
    n: usize,
    heads: usize,
    size: usize,
    keys: Aligned<f32>,   // per head: panels of keys, `size` lines each
    values: Aligned<f32>, // per head: panels of the head's columns, n lines each
}

impl Attention {
    /// Creates buffers for sequences of `n` tokens of width `d`.
    pub fn new(n: usize, d: usize, heads: usize) -> Self {
        let size = d / heads;
        let (wide_n, wide_size) = (n.next_multiple_of(LANES), size.next_multiple_of(LANES));
        Self {
            n,
            heads,
            size,
            keys: Aligned::zeros(heads * size * wide_n),
            values: Aligned::zeros(heads * n * wide_size),
        }
    }

    /// Computes softmax(q kᵀ / √size) v for each head.
    ///
    /// `qkv`: `(n, 3 d)`, queries, keys and values side by side. `out`: `(n, d)`.
    ///
    /// # Panics
    /// If a slice is shorter.
    pub fn forward(&mut self, qkv: &[f32], out: &mut [f32]) {
        let (n, heads, size) = (self.n, self.heads, self.size);
        let d = heads * size;
        assert!(qkv.len() >= 3 * d * n && out.len() >= d * n, "attention of {n} tokens leaves its slices");
        let (wide_n, wide_size) = (n.next_multiple_of(LANES), size.next_multiple_of(LANES));
        let keys = (&mut self.keys[..], size * wide_n);
        team::chunks2(keys, (&mut self.values[..], n * wide_size), |head, keys, values| {
            let part = |token: usize, part: usize| &qkv[3 * d * token + part * d + head * size..][..size];
            pack_keys(n, size, |token| part(token, 1), keys);
            pack_values(n, size, |token| part(token, 2), values);
        });
        let blocks = tile::count(n).div_ceil(TILES_PER_TASK);
        let this = &*self;
        let out = Shared(out.as_mut_ptr());
        team::run(heads * blocks, |index| {
            let (head, block) = (index / blocks, index % blocks);
            SCORES.with_borrow_mut(|scores| {
                if scores.len() < MOST_ROWS * wide_n {
                    *scores = Aligned::zeros(MOST_ROWS * wide_n);
                }
                for (row, count) in tile::of_task(block, n) {
                    this.rows(qkv, head, row, count, scores, out);
                }
            });
        });
    }

    /// Attends with up to [`MOST_ROWS`] queries of a head. Writes their rows of the head's columns of `out`, and no other
    /// value.
    fn rows(&self, qkv: &[f32], head: usize, row: usize, rows: usize, scores: &mut [f32], out: Shared) {
        let (n, size) = (self.n, self.size);
        let d = self.heads * size;
        let (wide_n, wide_size) = (n.next_multiple_of(LANES), size.next_multiple_of(LANES));
        let keys = &self.keys[head * size * wide_n..(head + 1) * size * wide_n];
        let values = &self.values[head * n * wide_size..(head + 1) * n * wide_size];
        let queries = &qkv[row * 3 * d + head * size..(row + rows - 1) * 3 * d + head * size + size];
        for (first, vectors) in panels(n) {
            let tile = Tile {
                a: queries.as_ptr(),
                lda: 3 * d,
                b: keys[first * size..].as_ptr(),
                k: size,
                bias: std::ptr::null(),
                out: scores[first..].as_mut_ptr(),
                ldc: wide_n,
                cols: vectors * LANES,
                add: false,
            };
            // SAFETY: the slice `queries` ends with the last query; the panel has `size` lines of `vectors` vectors, since
            // `keys` is padded to whole vectors; `scores` has MOST_ROWS rows of `wide_n` values and belongs to this thread.
            unsafe { tile::compute(&tile, rows, vectors) };
        }
        let mut weights = [0.0; MOST_ROWS];
        let scale = 1.0 / (size as f32).sqrt();
        simd::dispatch(
            #[inline(always)]
            || {
                for (scores, weight) in scores.chunks_exact_mut(wide_n).zip(&mut weights).take(rows) {
                    *weight = exponentials(&mut scores[..n], scale);
                }
            },
        );
        for (first, vectors) in panels(size) {
            let cols = (vectors * LANES).min(size - first);
            let at = out.at(row * d + head * size + first);
            let tile = Tile {
                a: scores.as_ptr(),
                lda: wide_n,
                b: values[first * n..].as_ptr(),
                k: n,
                bias: std::ptr::null(),
                out: at,
                ldc: d,
                cols,
                add: false,
            };
            // SAFETY: `scores` has `rows` rows of n values, the panel n lines of `vectors` vectors. `forward` asserted that
            // `out` has n rows of d columns; each (head, rows) pair, and with it this tile, occurs in one task only.
            unsafe { tile::compute(&tile, rows, vectors) };
            for (r, weight) in weights.iter().enumerate().take(rows) {
                // SAFETY: row r of the tile just written; no other slice of it exists.
                let out = unsafe { std::slice::from_raw_parts_mut(at.wrapping_add(r * d), cols) };
                out.iter_mut().for_each(|value| *value *= weight);
            }
        }
    }
}

/// Returns first column and number of vectors of each panel.
fn panels(columns: usize) -> impl Iterator<Item = (usize, usize)> {
    let vectors = columns.div_ceil(LANES);
    let count = vectors.div_ceil(VECTORS);
    (0..count).map(move |i| {
        let (first, next) = (i * vectors / count, (i + 1) * vectors / count);
        (first * LANES, next - first)
    })
}

/// Packs keys: panels of up to 48 keys, one column per key, one line per channel. Padding stays zero.
fn pack_keys<'a>(n: usize, size: usize, key: impl Fn(usize) -> &'a [f32], out: &mut [f32]) {
    for (first, vectors) in panels(n) {
        let width = vectors * LANES;
        let panel = &mut out[first * size..(first + width) * size];
        for vector in (0..width).step_by(LANES) {
            let there = LANES.min(n.saturating_sub(first + vector));
            // Lanes beyond the last key refer to that key, so that the array is full; they are not copied below.
            let keys: [&[f32]; LANES] = std::array::from_fn(|lane| key((first + vector + lane).min(n - 1)));
            for (line, out) in panel.chunks_exact_mut(width).enumerate() {
                for (out, key) in out[vector..vector + there].iter_mut().zip(&keys) {
                    *out = key[line];
                }
            }
        }
    }
}

/// Packs values: panels of up to 48 channels of a head, one line per token. Padding stays zero.
fn pack_values<'a>(n: usize, size: usize, value: impl Fn(usize) -> &'a [f32], out: &mut [f32]) {
    for (first, vectors) in panels(size) {
        let width = vectors * LANES;
        let there = width.min(size - first);
        for (token, out) in out[first * n..(first + width) * n].chunks_exact_mut(width).enumerate() {
            out[..there].copy_from_slice(&value(token)[first..first + there]);
        }
    }
}

/// Replaces each x by e^(scale (x - largest)). Returns one over the sum of the results; NaN if an x is NaN.
#[inline(always)]
fn exponentials(row: &mut [f32], scale: f32) -> f32 {
    let largest = simd::max(row);
    for x in row.iter_mut() {
        *x = simd::exp(scale * (*x - largest));
    }
    1.0 / simd::sum(
        row,
        #[inline(always)]
        |x| x,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attention_of_any_size_agrees_with_its_definition_in_f64() {
        let value = |i: usize| (i * 7919 % 1013) as f32 / 250.0 - 2.0;
        let sizes = [(1, 1, 8), (7, 2, 12), (20, 3, 16), (50, 2, 33)];
        for &(n, heads, size) in &sizes[..if cfg!(miri) { 2 } else { sizes.len() }] {
            let d = heads * size;
            let qkv: Vec<f32> = (0..n * 3 * d).map(value).collect();
            let mut out = vec![0.0; n * d + 1];
            Attention::new(n, d, heads).forward(&qkv, &mut out);
            assert_eq!(out.pop(), Some(0.0), "wrote beyond the rows");
            let part = |token: usize, part: usize, head: usize, i: usize| {
                f64::from(qkv[3 * d * token + part * d + head * size + i])
            };
            for (query, head) in (0..n).flat_map(|query| (0..heads).map(move |head| (query, head))) {
                let score = |key| (0..size).map(|i| part(query, 0, head, i) * part(key, 1, head, i)).sum::<f64>();
                let scores: Vec<f64> = (0..n).map(|key| score(key) / (size as f64).sqrt()).collect();
                let largest = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                let weights: Vec<f64> = scores.iter().map(|score| (score - largest).exp()).collect();
                let sum: f64 = weights.iter().sum();
                for i in 0..size {
                    let want = (0..n).map(|key| weights[key] * part(key, 2, head, i)).sum::<f64>() / sum;
                    let got = f64::from(out[query * d + head * size + i]);
                    assert!((got - want).abs() < 2e-5, "{n} tokens, {heads} heads of {size}: {got} for {want}");
                }
            }
        }
    }
}
