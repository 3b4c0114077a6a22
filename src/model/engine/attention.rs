//! Self-attention of one sequence, from packed projections.

use std::cell::RefCell;

use super::aligned::Aligned;
use super::packed::Shared;
use super::team;
use super::tile::{self, LANES, MOST_ROWS, TILES_PER_TASK, Tile, VECTORS};
use crate::model::ops::simd;

thread_local! {
    /// Scores of the rows that a thread works on.
    static SCORES: RefCell<Aligned<f32>> = RefCell::new(Aligned::zeros(0));
}

/// Keys and values of one sequence, laid out for the tiles, and the sizes.
#[derive(Debug, Clone)]
pub struct Attention {
    n: usize,
    heads: usize,
    size: usize,
    keys: Aligned<f32>,   // per head: panels of keys, `size` lines each
    values: Aligned<f32>, // per head: panels of the head's columns, n lines each
}

impl Attention {
    /// Room for `n` tokens.
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

    /// softmax(q kᵀ / √size) v for each head.
    ///
    /// `qkv`: `(n, 3 d)`, `out`: `(n, d)`.
    ///
    /// # Panics
    /// If the slices are shorter.
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

    /// Up to [`MOST_ROWS`] queries of a head; writes their places of `out` and nothing else.
    #[allow(unsafe_code)]
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
            // SAFETY: queries, panel and scores (MOST_ROWS x wide_n) hold what the tile reads and writes.
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
            let at = out.0.wrapping_add(row * d + head * size + first);
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
            // SAFETY: scores and panel hold what the tile reads; `forward` asserted that `out` has these rows and
            // columns, and no other task has them.
            unsafe { tile::compute(&tile, rows, vectors) };
            for (r, weight) in weights.iter().enumerate().take(rows) {
                // SAFETY: as above.
                let out = unsafe { std::slice::from_raw_parts_mut(at.wrapping_add(r * d), cols) };
                out.iter_mut().for_each(|value| *value *= weight);
            }
        }
    }
}

/// First column and number of vectors of each panel.
fn panels(columns: usize) -> impl Iterator<Item = (usize, usize)> {
    let vectors = columns.div_ceil(LANES);
    let count = vectors.div_ceil(VECTORS);
    (0..count).map(move |i| {
        let (first, next) = (i * vectors / count, (i + 1) * vectors / count);
        (first * LANES, next - first)
    })
}

/// Panels of keys, one column each; padding stays zero.
fn pack_keys<'a>(n: usize, size: usize, key: impl Fn(usize) -> &'a [f32], out: &mut [f32]) {
    for (first, vectors) in panels(n) {
        let width = vectors * LANES;
        let panel = &mut out[first * size..(first + width) * size];
        for vector in (0..width).step_by(LANES) {
            let there = LANES.min(n.saturating_sub(first + vector));
            // Lanes without a key take the last one's place below, and are not written.
            let keys: [&[f32]; LANES] = std::array::from_fn(|lane| key((first + vector + lane).min(n - 1)));
            for (line, out) in panel.chunks_exact_mut(width).enumerate() {
                for (out, key) in out[vector..vector + there].iter_mut().zip(&keys) {
                    *out = key[line];
                }
            }
        }
    }
}

/// Panels of a head's columns, one line per token; padding stays zero.
fn pack_values<'a>(n: usize, size: usize, value: impl Fn(usize) -> &'a [f32], out: &mut [f32]) {
    for (first, vectors) in panels(size) {
        let width = vectors * LANES;
        let there = width.min(size - first);
        for (token, out) in out[first * n..(first + width) * n].chunks_exact_mut(width).enumerate() {
            out[..there].copy_from_slice(&value(token)[first..first + there]);
        }
    }
}

/// e^(scale (x - largest)) in place. Returns one over their sum; NaN if a value is.
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
