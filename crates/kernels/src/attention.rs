//! Self-attention of one sequence, for inference.
//!
//! Keys and values are packed into panels per head, as the weights of a layer are; queries are read where they lie. A task
//! computes the scores of a few queries, their exponentials and the weighted sum of the values while the scores are in its
//! own cache. The division by the sum of exponentials comes last, on the few outputs instead of the many weights.
//!
//! Where fewer bits are wanted and the processor has a matrix unit, both products have operands in bf16 and sums in f32.

use std::cell::RefCell;

use crate::aligned::{Aligned, grow};
use crate::amx::{self, Block, Kind, STEP, Sums};
use crate::packed::{Format, PAIR, Shared, Unit};
use crate::quantise::{bf16, halve_row};
use crate::rows::part;
use crate::simd;
use crate::team;
use crate::tile::{self, LANES, MOST_ROWS, TILES_PER_TASK, Tile, VECTORS};

/// bf16 values to a multiple of which the operands of the matrix unit are padded with zeros.
const HALVES: usize = STEP / PAIR;

thread_local! {
    /// Buffers of the queries that this thread works on, kept so that a task allocates nothing.
    static SCRATCH: RefCell<Scratch> = RefCell::new(Scratch::default());
}

/// Multi-head self-attention with buffers for the keys and values of one sequence.
#[derive(Debug, Clone)]
pub struct Attention {
    n: usize,
    heads: usize,
    size: usize,
    operands: Operands,
}

/// Packed keys and values.
#[derive(Debug, Clone)]
enum Operands {
    /// For vector instructions. Keys: per head, panels of keys, `size` lines each. Values: per head, panels of the head's
    /// columns, n lines each.
    Lines { keys: Aligned<f32>, values: Aligned<f32> },
    /// For the matrix unit: as above, but a line has pairs of channels or of tokens in bf16, and their number is padded.
    Pairs { keys: Aligned<u32>, values: Aligned<u32> },
}

/// Intermediate results of a few queries.
#[derive(Debug, Default)]
struct Scratch {
    scores: Aligned<f32>,
    /// Queries, then weights of the values, in bf16.
    halves: Aligned<u16>,
}

impl Attention {
    /// Creates buffers for sequences of `n` tokens of width `d`. A format other than [`Format::F32`] permits operands in bf16.
    pub fn new(n: usize, d: usize, heads: usize, format: Format) -> Self {
        Self::for_unit(n, d, heads, Unit::of(format))
    }

    fn for_unit(n: usize, d: usize, heads: usize, unit: Unit) -> Self {
        let size = d / heads;
        let (wide_n, wide_size) = (n.next_multiple_of(LANES), size.next_multiple_of(LANES));
        let operands = match unit {
            Unit::Vectors => Operands::Lines {
                keys: Aligned::zeros(heads * size * wide_n),
                values: Aligned::zeros(heads * n * wide_size),
            },
            Unit::Matrix => Operands::Pairs {
                keys: Aligned::zeros(heads * size.next_multiple_of(HALVES) / PAIR * wide_n),
                values: Aligned::zeros(heads * n.next_multiple_of(HALVES) / PAIR * wide_size),
            },
        };
        Self { n, heads, size, operands }
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
        let of = |head: usize, token: usize, part: usize| &qkv[3 * d * token + part * d + head * size..][..size];
        let tasks = match &mut self.operands {
            Operands::Lines { keys, values } => {
                let sizes = [keys.len() / heads, values.len() / heads];
                team::chunks2((keys, sizes[0]), (values, sizes[1]), |head, keys, values| {
                    pack_keys(n, size, |token| of(head, token, 1), keys);
                    pack_values(n, size, |token| of(head, token, 2), values);
                });
                tile::count(n).div_ceil(TILES_PER_TASK)
            }
            Operands::Pairs { keys, values } => {
                let sizes = [keys.len() / heads, values.len() / heads];
                team::chunks2((keys, sizes[0]), (values, sizes[1]), |head, keys, values| {
                    pack_key_pairs(n, size, |token| of(head, token, 1), keys);
                    pack_value_pairs(n, size, |token| of(head, token, 2), values);
                });
                amx::count(n)
            }
        };
        let this = &*self;
        let out = Shared(out.as_mut_ptr());
        team::run(heads * tasks, |index| {
            let (head, task) = (index / tasks, index % tasks);
            SCRATCH.with_borrow_mut(|scratch| match &this.operands {
                Operands::Lines { keys, values } => {
                    for (row, count) in tile::of_task(task, n) {
                        this.rows(qkv, (keys, values), head, (row, count), &mut scratch.scores, out);
                    }
                }
                Operands::Pairs { keys, values } => {
                    this.block(qkv, (keys, values), head, part(task, tasks, n), scratch, out);
                }
            });
        });
    }

    /// Attends with up to [`MOST_ROWS`] queries of a head. Writes their rows of the head's columns of `out`, and no other
    /// value.
    fn rows(
        &self,
        qkv: &[f32],
        (keys, values): (&[f32], &[f32]),
        head: usize,
        (row, rows): (usize, usize),
        scores: &mut Aligned<f32>,
        out: Shared,
    ) {
        let (n, size) = (self.n, self.size);
        let d = self.heads * size;
        let (wide_n, wide_size) = (n.next_multiple_of(LANES), size.next_multiple_of(LANES));
        let keys = &keys[head * size * wide_n..(head + 1) * size * wide_n];
        let values = &values[head * n * wide_size..(head + 1) * n * wide_size];
        let queries = &qkv[row * 3 * d + head * size..(row + rows - 1) * 3 * d + head * size + size];
        grow(scores, MOST_ROWS * wide_n);
        for (first, vectors) in panels(n, VECTORS) {
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
        for (first, vectors) in panels(size, VECTORS) {
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

    /// As [`Self::rows`], with up to [`amx::ROWS`] queries in the matrix unit.
    fn block(
        &self,
        qkv: &[f32],
        (keys, values): (&[u32], &[u32]),
        head: usize,
        (row, rows): (usize, usize),
        scratch: &mut Scratch,
        out: Shared,
    ) {
        let (n, size) = (self.n, self.size);
        let d = self.heads * size;
        let (wide_n, wide_size) = (n.next_multiple_of(LANES), size.next_multiple_of(LANES));
        let (padded_n, padded_size) = (n.next_multiple_of(HALVES), size.next_multiple_of(HALVES));
        let (key_lines, value_lines) = (padded_size / PAIR, padded_n / PAIR);
        let keys = &keys[head * key_lines * wide_n..(head + 1) * key_lines * wide_n];
        let values = &values[head * value_lines * wide_size..(head + 1) * value_lines * wide_size];
        let Scratch { scores, halves } = scratch;
        grow(scores, amx::ROWS * wide_n);
        grow(halves, amx::ROWS * padded_n.max(padded_size));
        for (r, halves) in halves.chunks_exact_mut(padded_size).enumerate().take(rows) {
            halve_row(&qkv[(row + r) * 3 * d + head * size..][..size], &mut halves[..size]);
            halves[size..].fill(0);
        }
        for (first, vectors) in panels(n, amx::VECTORS) {
            let block = Block {
                a: halves.as_ptr().cast(),
                lda: padded_size * PAIR,
                b: keys[first * key_lines..].as_ptr().cast(),
                steps: padded_size / HALVES,
                out: scores[first..].as_mut_ptr(),
                ldc: wide_n,
            };
            // SAFETY: `halves` has `rows` rows of `padded_size` values, the panel `key_lines` lines of `vectors` vectors of
            // words, since `keys` is padded to whole vectors; `scores` has amx::ROWS rows of `wide_n` values and belongs
            // to this thread.
            unsafe { amx::multiply(Kind::Half, &block, rows, vectors) };
        }
        let mut weights = [0.0; amx::ROWS];
        let scale = 1.0 / (size as f32).sqrt();
        let of_rows = scores.chunks_exact_mut(wide_n).zip(halves.chunks_exact_mut(padded_n)).zip(&mut weights);
        for ((scores, halves), weight) in of_rows.take(rows) {
            simd::dispatch(
                #[inline(always)]
                || *weight = exponentials(&mut scores[..n], scale),
            );
            halve_row(&scores[..n], &mut halves[..n]);
            halves[n..].fill(0);
        }
        for (first, vectors) in panels(size, amx::VECTORS) {
            let cols = (vectors * LANES).min(size - first);
            let mut sums = Sums::new();
            let block = Block {
                a: halves.as_ptr().cast(),
                lda: padded_n * PAIR,
                b: values[first * value_lines..].as_ptr().cast(),
                steps: padded_n / HALVES,
                out: sums.start(),
                ldc: amx::WIDTH,
            };
            // SAFETY: `halves` has `rows` rows of `padded_n` values, the panel `value_lines` lines of `vectors` vectors of
            // words; `rows` and `vectors` are within what the sums have room for.
            unsafe { amx::multiply(Kind::Half, &block, rows, vectors) };
            for (r, weight) in weights.iter().enumerate().take(rows) {
                let at = out.at((row + r) * d + head * size + first);
                // SAFETY: `forward` asserted that `out` has n rows of d columns; each (head, rows) pair occurs in one task
                // only, and one row's slice exists at a time.
                let out = unsafe { std::slice::from_raw_parts_mut(at, cols) };
                for (out, sum) in out.iter_mut().zip(sums.row(r).as_flattened()) {
                    *out = sum * weight;
                }
            }
        }
    }
}

/// Returns first column and number of vectors of each panel of at most `most` vectors.
fn panels(columns: usize, most: usize) -> impl Iterator<Item = (usize, usize)> {
    let vectors = columns.div_ceil(LANES);
    let count = vectors.div_ceil(most);
    (0..count).map(move |i| {
        let (first, next) = (i * vectors / count, (i + 1) * vectors / count);
        (first * LANES, next - first)
    })
}

/// Packs keys: panels of up to 48 keys, one column per key, one line per channel. Padding stays zero.
fn pack_keys<'a>(n: usize, size: usize, key: impl Fn(usize) -> &'a [f32], out: &mut [f32]) {
    for (first, vectors) in panels(n, VECTORS) {
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
    for (first, vectors) in panels(size, VECTORS) {
        let width = vectors * LANES;
        let there = width.min(size - first);
        for (token, out) in out[first * n..(first + width) * n].chunks_exact_mut(width).enumerate() {
            out[..there].copy_from_slice(&value(token)[first..first + there]);
        }
    }
}

/// As [`pack_keys`] in bf16, for panels of up to 32 keys with one line of words per pair of channels.
fn pack_key_pairs<'a>(n: usize, size: usize, key: impl Fn(usize) -> &'a [f32], out: &mut [u32]) {
    let lines = size.next_multiple_of(HALVES) / PAIR;
    let mut words = vec![0; LANES * lines];
    for (first, vectors) in panels(n, amx::VECTORS) {
        let width = vectors * LANES;
        let panel = &mut out[first * lines..(first + width) * lines];
        for vector in (0..width).step_by(LANES) {
            let there = LANES.min(n.saturating_sub(first + vector));
            for (lane, words) in words.chunks_exact_mut(lines).enumerate().take(there) {
                pairs(key(first + vector + lane), words);
            }
            let words: [&[u32]; LANES] = std::array::from_fn(|lane| &words[lane * lines..(lane + 1) * lines]);
            for (line, out) in panel.chunks_exact_mut(width).enumerate() {
                for (out, words) in out[vector..vector + there].iter_mut().zip(&words) {
                    *out = words[line];
                }
            }
        }
    }
}

/// Rounds two values to bf16 and joins them, the first in the lower half.
#[inline(always)]
fn joined(first: f32, second: f32) -> u32 {
    u32::from(bf16(first)) | u32::from(bf16(second)) << 16
}

/// Rounds a row to bf16, two values in a word.
fn pairs(row: &[f32], words: &mut [u32]) {
    simd::dispatch(
        #[inline(always)]
        || {
            let (pairs, rest) = row.as_chunks::<PAIR>();
            for (word, pair) in words.iter_mut().zip(pairs) {
                *word = joined(pair[0], pair[1]);
            }
            if let [last] = rest {
                words[pairs.len()] = joined(*last, 0.0);
            }
        },
    );
}

/// As [`pack_values`] in bf16, for panels of up to 32 channels with one line of words per pair of tokens.
fn pack_value_pairs<'a>(n: usize, size: usize, value: impl Fn(usize) -> &'a [f32], out: &mut [u32]) {
    let lines = n.next_multiple_of(HALVES) / PAIR;
    let zeros = vec![0.0; size];
    for (first, vectors) in panels(size, amx::VECTORS) {
        let width = vectors * LANES;
        let columns = first..size.min(first + width);
        for (line, out) in out[first * lines..(first + width) * lines].chunks_exact_mut(width).enumerate() {
            let [a, b] = [0, 1].map(|i| if line * PAIR + i < n { value(line * PAIR + i) } else { &zeros[..] });
            let (a, b) = (&a[columns.clone()], &b[columns.clone()]);
            simd::dispatch(
                #[inline(always)]
                || {
                    for (word, (a, b)) in out.iter_mut().zip(a.iter().zip(b)) {
                        *word = joined(*a, *b);
                    }
                },
            );
        }
    }
}

/// Replaces each x by e^(scale (x - largest)). Returns one over the sum of the results; NaN if an x is NaN.
#[inline(always)]
fn exponentials(row: &mut [f32], scale: f32) -> f32 {
    let largest = simd::max(row);
    let (chunks, rest) = row.as_chunks_mut::<LANES>();
    let mut sums = [0.0; LANES];
    for chunk in chunks {
        for (x, sum) in chunk.iter_mut().zip(&mut sums) {
            *x = simd::exp(scale * (*x - largest));
            *sum += *x;
        }
    }
    let mut rest_sum = 0.0;
    for x in rest {
        *x = simd::exp(scale * (*x - largest));
        rest_sum += *x;
    }
    1.0 / (simd::fold(sums) + rest_sum)
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
            let [mut out, mut halved] = [Unit::Vectors, Unit::Matrix].map(|unit| {
                let mut out = vec![0.0; n * d + 1];
                Attention::for_unit(n, d, heads, unit).forward(&qkv, &mut out);
                out
            });
            assert_eq!(out.pop(), Some(0.0), "wrote beyond the rows");
            assert_eq!(halved.pop(), Some(0.0), "wrote beyond the rows in bf16");
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
                    // bf16 has 8 bits; a score of magnitude 10 is rounded by 0.02, which changes its weight by 2 %.
                    let got = f64::from(halved[query * d + head * size + i]);
                    assert!((got - want).abs() < 0.1, "bf16, {n} tokens, {heads} heads of {size}: {got} for {want}");
                }
            }
        }
    }
}
