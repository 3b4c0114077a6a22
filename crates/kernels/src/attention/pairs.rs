//! Attention in the matrix unit, with operands in bf16.

use super::{Scratch, Shape, exponentials, panels};
use crate::activations::Target;
use crate::aligned::{Aligned, grow};
use crate::amx::{self, Block, Kind, STEP, Sums};
use crate::packed::PAIR;
use crate::quantise::halve_row;
use crate::rows::part;
use crate::simd;
use crate::team;
use crate::tile::{LANES, Next};

/// Operands are padded with zeros to a multiple of this number of bf16 values.
const HALVES: usize = STEP / PAIR;

/// Packed keys and values. A *word* has two of a key's channels, or a channel of two values.
#[derive(Debug, Clone)]
pub(super) struct Pairs {
    /// Per head, keys and then values: panels of keys with a line of words per pair of channels, and panels of the head's columns
    /// with a line of words per pair of tokens. The number of pairs is padded. Both have equal room, so that threads share them.
    words: Aligned<u32>,
}

/// Number of tasks per head.
pub(super) fn tasks(shape: Shape) -> usize {
    amx::count(shape.n)
}

impl Shape {
    /// Lines of a panel of keys.
    fn key_lines(self) -> usize {
        self.size.next_multiple_of(HALVES) / PAIR
    }

    /// Lines of a panel of values.
    fn value_lines(self) -> usize {
        self.n.next_multiple_of(HALVES) / PAIR
    }

    /// Words of a head's keys and of its values, the larger number.
    fn words(self) -> usize {
        (self.key_lines() * self.wide_n()).max(self.value_lines() * self.wide_size())
    }
}

impl Pairs {
    /// Creates buffers.
    pub fn new(shape: Shape) -> Self {
        Self { words: Aligned::zeros(2 * shape.heads * shape.words()) }
    }

    /// Packs keys and values of `qkv`, `(n, 3 d)`, whose rows are `lda` values apart.
    pub fn pack(&mut self, shape: Shape, (qkv, lda): (&[u16], usize)) {
        team::chunks(&mut self.words, shape.words(), |index, words| {
            let (head, part) = (index / 2, 1 + index % 2);
            let of = |token: usize| &qkv[lda * token + part * shape.d() + head * shape.size..][..shape.size];
            match part {
                1 => pack_keys(shape, of, words),
                _ => pack_values(shape, of, words),
            }
        });
    }

    /// Attends with the queries of one task of a head, at most [`amx::ROWS`]. Writes their rows of the head's columns of `out`, and
    /// no other value.
    pub fn attend(
        &self,
        shape: Shape,
        (qkv, lda): (&[u16], usize),
        (head, task): (usize, usize),
        scratch: &mut Scratch,
        (out, stride): (Target, usize),
    ) {
        let Shape { n, size, .. } = shape;
        let (row, rows) = part(task, tasks(shape), n);
        let (wide_n, padded_n, padded_size) = (shape.wide_n(), n.next_multiple_of(HALVES), PAIR * shape.key_lines());
        let (keys, values) = self.words[2 * head * shape.words()..][..2 * shape.words()].split_at(shape.words());
        let (key_lines, value_lines) = (shape.key_lines(), shape.value_lines());
        let Scratch { scores, halves } = scratch;
        grow(scores, amx::ROWS * wide_n);
        grow(halves, amx::ROWS * padded_n.max(padded_size));
        let queries = &qkv[row * lda + head * size..(row + rows - 1) * lda + head * size + size];
        // Queries are read where they lie, if no padding of zeros is needed after each.
        let (a, lda) = if size == padded_size {
            (queries.as_ptr(), lda)
        } else {
            for (halves, query) in halves.chunks_exact_mut(padded_size).zip(queries.chunks(lda)) {
                halves[..size].copy_from_slice(&query[..size]);
                halves[size..].fill(0);
            }
            (halves.as_ptr(), padded_size)
        };
        for (first, vectors) in panels(n, amx::VECTORS) {
            let panel = &keys[first * key_lines..][..vectors * LANES * key_lines];
            let block = Block {
                a: a.cast(),
                lda: lda * PAIR,
                b: panel.as_ptr().cast(),
                steps: padded_size / HALVES,
                out: scores[first..].as_mut_ptr(),
                ldc: wide_n,
                next: Next::NONE,
            };
            // SAFETY: `a` has `rows` rows of `padded_size` values, in `queries` or in `halves`; the panel has `key_lines` lines of
            // `vectors` vectors of words; `scores` has amx::ROWS rows of `wide_n` values and belongs to this thread.
            unsafe { amx::multiply(Kind::Half, &block, rows, vectors) };
        }
        let mut weights = [0.0; amx::ROWS];
        let of_rows = scores.chunks_exact_mut(wide_n).zip(halves.chunks_exact_mut(padded_n)).zip(&mut weights);
        for ((scores, halves), weight) in of_rows.take(rows) {
            simd::dispatch(
                #[inline(always)]
                || *weight = exponentials(&mut scores[..n], shape.scale()),
            );
            halve_row(&scores[..n], &mut halves[..n]);
            halves[n..].fill(0);
        }
        for (first, vectors) in panels(size, amx::VECTORS) {
            let cols = (vectors * LANES).min(size - first);
            let panel = &values[first * value_lines..][..vectors * LANES * value_lines];
            let mut sums = Sums::new();
            let block = Block {
                a: halves.as_ptr().cast(),
                lda: padded_n * PAIR,
                b: panel.as_ptr().cast(),
                steps: padded_n / HALVES,
                out: sums.start(),
                ldc: amx::WIDTH,
                next: Next::NONE,
            };
            // SAFETY: `halves` has `rows` rows of `padded_n` values, the panel `value_lines` lines of `vectors` vectors of
            // words; `rows` and `vectors` are within what the sums have room for.
            unsafe { amx::multiply(Kind::Half, &block, rows, vectors) };
            let at = out.at(row * stride + head * size + first);
            // SAFETY: `out` has n rows of d columns; each (head, task) pair, and with it these rows and columns, occurs once.
            unsafe { amx::scale(&sums, &weights[..rows], cols, at, stride) };
        }
        amx::release();
    }
}

/// Packs keys: one column per key, one line of words per pair of channels. Padding stays zero.
fn pack_keys<'a>(shape: Shape, key: impl Fn(usize) -> &'a [u16], out: &mut [u32]) {
    let (n, lines) = (shape.n, shape.key_lines());
    for (first, vectors) in panels(n, amx::VECTORS) {
        let width = vectors * LANES;
        let panel = &mut out[first * lines..(first + width) * lines];
        for vector in (0..width).step_by(LANES) {
            let there = LANES.min(n.saturating_sub(first + vector));
            // Lanes beyond the last key refer to that key, so that the array is full; they are not copied below.
            let keys: [&[u16]; LANES] = std::array::from_fn(|lane| key((first + vector + lane).min(n - 1)));
            for (line, out) in panel.chunks_exact_mut(width).enumerate().take(shape.size.div_ceil(PAIR)) {
                for (out, key) in out[vector..vector + there].iter_mut().zip(&keys) {
                    let second = key.get(line * PAIR + 1).copied().unwrap_or(0);
                    *out = joined(key[line * PAIR], second);
                }
            }
        }
    }
}

/// Packs values: one column per channel of a head, one line of words per pair of tokens. Padding stays zero.
fn pack_values<'a>(shape: Shape, value: impl Fn(usize) -> &'a [u16], out: &mut [u32]) {
    let (n, size, lines) = (shape.n, shape.size, shape.value_lines());
    let zeros = vec![0; size];
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

/// Joins two halves to a word, the first in the lower part.
#[inline(always)]
fn joined(first: u16, second: u16) -> u32 {
    u32::from(first) | u32::from(second) << 16
}
