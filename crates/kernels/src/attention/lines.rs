//! Attention by vector instructions, in f32.

use super::{Scratch, Shape, exponentials, panels};
use crate::activations::Target;
use crate::aligned::{Aligned, grow};
use crate::rows::Rows;
use crate::simd;
use crate::team;
use crate::tile::{self, LANES, MOST_ROWS, Next, TILES_PER_TASK, Tile};

/// Packed keys and values.
#[derive(Debug, Clone)]
pub(super) struct Lines {
    /// Per head, panels of keys, `size` lines each.
    keys: Aligned<f32>,
    /// Per head, panels of the head's columns, n lines each.
    values: Aligned<f32>,
}

/// Number of tasks per head.
pub(super) fn tasks(shape: Shape) -> usize {
    tile::count(shape.n).div_ceil(TILES_PER_TASK)
}

impl Lines {
    /// Creates buffers.
    pub fn new(shape: Shape) -> Self {
        let Shape { n, heads, size } = shape;
        Self {
            keys: Aligned::zeros(heads * size * shape.wide_n()),
            values: Aligned::zeros(heads * n * shape.wide_size()),
        }
    }

    /// Packs keys and values of `qkv`, `(n, 3 d)`.
    pub fn pack(&mut self, shape: Shape, qkv: Rows) {
        let Shape { n, heads, size } = shape;
        let of = |head: usize, token: usize, part: usize| {
            &qkv.data[qkv.stride * token + part * shape.d() + head * size..][..size]
        };
        let Self { keys, values } = self;
        let sizes = [keys.len() / heads, values.len() / heads];
        team::chunks2((keys, sizes[0]), (values, sizes[1]), |head, keys, values| {
            pack_keys(n, size, |token| of(head, token, 1), keys);
            pack_values(n, size, |token| of(head, token, 2), values);
        });
    }

    /// Attends with the queries of one task of a head.
    pub fn attend(
        &self,
        shape: Shape,
        qkv: Rows,
        (head, task): (usize, usize),
        scratch: &mut Scratch,
        out: (Target, usize),
    ) {
        for rows in tile::of_task(task, shape.n) {
            self.rows(shape, qkv, head, rows, &mut scratch.scores, out);
        }
    }

    /// Attends with up to [`MOST_ROWS`] queries of a head. Writes their rows of the head's columns of `out`, and no other
    /// value.
    fn rows(
        &self,
        shape: Shape,
        qkv: Rows,
        head: usize,
        (row, rows): (usize, usize),
        scores: &mut Aligned<f32>,
        (out, stride): (Target, usize),
    ) {
        let Target::Floats(out) = out else { unreachable!("`apply_into` asks vector instructions for f32") };
        let Shape { n, size, .. } = shape;
        let (lda, wide_n, wide_size) = (qkv.stride, shape.wide_n(), shape.wide_size());
        let keys = &self.keys[head * size * wide_n..(head + 1) * size * wide_n];
        let values = &self.values[head * n * wide_size..(head + 1) * n * wide_size];
        let queries = &qkv.data[row * lda + head * size..(row + rows - 1) * lda + head * size + size];
        grow(scores, MOST_ROWS * wide_n);
        for (first, vectors) in panels(n, tile::widest()) {
            let tile = Tile {
                a: queries.as_ptr(),
                lda,
                b: keys[first * size..].as_ptr(),
                k: size,
                bias: std::ptr::null(),
                out: scores[first..].as_mut_ptr(),
                ldc: wide_n,
                cols: vectors * LANES,
                add: false,
                next: Next::NONE,
            };
            // SAFETY: the slice `queries` ends with the last query; the panel has `size` lines of `vectors` vectors, since
            // `keys` is padded to whole vectors; `scores` has MOST_ROWS rows of `wide_n` values and belongs to this thread.
            unsafe { tile::compute(&tile, rows, vectors) };
        }
        let mut weights = [0.0; MOST_ROWS];
        let scale = shape.scale();
        simd::dispatch(
            #[inline(always)]
            || {
                for (scores, weight) in scores.chunks_exact_mut(wide_n).zip(&mut weights).take(rows) {
                    *weight = exponentials(&mut scores[..n], scale);
                }
            },
        );
        for (first, vectors) in panels(size, tile::widest()) {
            let cols = (vectors * LANES).min(size - first);
            let at = out.wrapping_add(row * stride + head * size + first);
            let tile = Tile {
                a: scores.as_ptr(),
                lda: wide_n,
                b: values[first * n..].as_ptr(),
                k: n,
                bias: std::ptr::null(),
                out: at,
                ldc: stride,
                cols,
                add: false,
                next: Next::NONE,
            };
            // SAFETY: `scores` has `rows` rows of n values, the panel n lines of `vectors` vectors. `out` has n rows of d columns;
            // each (head, rows) pair, and with it this tile, occurs in one task only.
            unsafe { tile::compute(&tile, rows, vectors) };
            for (r, weight) in weights.iter().enumerate().take(rows) {
                // SAFETY: row r of the tile just written; no other slice of it exists.
                let out = unsafe { std::slice::from_raw_parts_mut(at.wrapping_add(r * stride), cols) };
                out.iter_mut().for_each(|value| *value *= weight);
            }
        }
    }
}

/// Packs keys: panels of as many keys as a tile is wide, one column per key, one line per channel. Padding stays zero.
fn pack_keys<'a>(n: usize, size: usize, key: impl Fn(usize) -> &'a [f32], out: &mut [f32]) {
    for (first, vectors) in panels(n, tile::widest()) {
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

/// Packs values: panels of as many channels of a head as a tile is wide, one line per token. Padding stays zero.
fn pack_values<'a>(n: usize, size: usize, value: impl Fn(usize) -> &'a [f32], out: &mut [f32]) {
    for (first, vectors) in panels(size, tile::widest()) {
        let width = vectors * LANES;
        let there = width.min(size - first);
        for (token, out) in out[first * n..(first + width) * n].chunks_exact_mut(width).enumerate() {
            out[..there].copy_from_slice(&value(token)[first..first + there]);
        }
    }
}
