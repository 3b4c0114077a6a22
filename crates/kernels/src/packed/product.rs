//! Products of two matrices that are both new, as in training: factors in bf16, sums in f32, in the matrix unit.
//!
//! The right side takes the layout of a layer's weights, the left side that of activations, and the product is that of a layer.

use super::{PAIR, Packed, Panel, Then, Unit, Weights, panels};
use crate::activations::{Input, Target};
use crate::aligned::Aligned;
use crate::amx::STEP;
use crate::quantise::{bf16, halve_row};
use crate::rows::Mat;
use crate::tile::LANES;
use crate::{amx, simd, team};

/// Rows of the left side that one task converts, and edge of the squares in which a transposed side is read: a square of f32 is 4 KiB.
const SQUARE: usize = 32;

/// True if the processor has the unit.
pub fn available() -> bool {
    amx::available()
}

/// Computes `lhs rhs + bias` on all threads; without a bias, `lhs rhs`. Runs in plain Rust where the processor has no matrix unit.
///
/// # Panics
/// If the shapes don't fit each other or their slices.
pub fn product(lhs: Mat, rhs: Mat, bias: Option<&[f32]>) -> Vec<f32> {
    let (rows, k, n) = (lhs.rows, lhs.cols, rhs.cols);
    assert_eq!(rhs.rows, k, "shapes of a matrix product");
    assert!(bias.is_none_or(|bias| bias.len() == n), "bias of a matrix product");
    assert!(lhs.fits(), "the left side leaves its slice");
    assert!(rhs.fits(), "the right side leaves its slice");
    if rows == 0 || n == 0 {
        return vec![];
    }
    // At least one step, so that a product without terms is zero.
    let stride = k.max(1).next_multiple_of(STEP / PAIR);
    let halves = left(lhs, stride);
    let layer = Packed::of_lines(right(rhs, stride), n, stride, bias);
    let mut out = Vec::with_capacity(rows * n);
    let target = Target::Floats(out.as_mut_ptr());
    team::lead(|| layer.run(Input::Halves(&halves, stride), rows, target, n, Then::Store));
    // SAFETY: the capacity is `rows` x `n`, and `run` has stored that many values, without gaps.
    unsafe { out.set_len(rows * n) };
    out
}

impl Packed {
    /// Makes a layer of lines that are laid out for the matrix unit. `k` is padded.
    fn of_lines(lines: Aligned<u16>, n: usize, k: usize, bias: Option<&[f32]>) -> Self {
        let mut padded = bias.map(<[f32]>::to_vec).unwrap_or_default();
        padded.resize(n.next_multiple_of(LANES), 0.0);
        let panels = panels(n, Unit::Matrix.vectors());
        Self { n, k, unit: Unit::Matrix, panels, weights: Weights::Pairs(lines), bias: padded }
    }
}

/// Converts the left side to rows of bf16, `stride` values apart; the padding is zero.
fn left(side: Mat, stride: usize) -> Aligned<u16> {
    let blocks = (0..side.rows).step_by(SQUARE).map(|first| (side.rows - first).min(SQUARE) * stride);
    Aligned::by_pieces(blocks, |block, rows| {
        let first = block * SQUARE;
        if side.col_stride == 1 {
            for (r, row) in rows.chunks_exact_mut(stride).enumerate() {
                halve_row(&side.data[(first + r) * side.row_stride..][..side.cols], &mut row[..side.cols]);
            }
        } else {
            simd::dispatch(
                #[inline(always)]
                || transpose(side, first, stride, rows),
            );
        }
    })
}

/// Converts rows of a side whose columns are contiguous, square by square.
#[inline(always)]
fn transpose(side: Mat, first: usize, stride: usize, rows: &mut [u16]) {
    let count = rows.len() / stride;
    let mut square = [[0u16; SQUARE]; SQUARE];
    for column in (0..side.cols).step_by(SQUARE) {
        let width = (side.cols - column).min(SQUARE);
        for (i, line) in square.iter_mut().enumerate().take(width) {
            let values = &side.data[(column + i) * side.col_stride + first..][..count];
            for (half, value) in line.iter_mut().zip(values) {
                *half = bf16(*value);
            }
        }
        for (r, row) in rows.chunks_exact_mut(stride).enumerate() {
            for (half, line) in row[column..column + width].iter_mut().zip(&square) {
                *half = line[r];
            }
        }
    }
}

/// Lays out the right side as panels of lines: `lines` inputs, those that it does not have are zero.
fn right(side: Mat, lines: usize) -> Aligned<u16> {
    let panels = panels(side.cols, Unit::Matrix.vectors());
    Aligned::by_pieces(panels.iter().map(|panel| panel.width() * lines), |index, own| {
        simd::dispatch(
            #[inline(always)]
            || panel(side, panels[index], own),
        );
    })
}

/// Lays out a panel of the right side: a line holds the pairs of two inputs of all columns.
#[inline(always)]
fn panel(side: Mat, panel: Panel, own: &mut [u16]) {
    let first = panel.start();
    let cols = panel.width().min(side.cols - first);
    let line = panel.width() * PAIR;
    if side.col_stride == 1 {
        let row = |i: usize| &side.data[i * side.row_stride + first..][..cols];
        for (pair, line) in own.chunks_exact_mut(line).enumerate().take(side.rows.div_ceil(PAIR)) {
            let i = PAIR * pair;
            let pairs = line.as_chunks_mut::<PAIR>().0;
            if i + 1 < side.rows {
                for ((pair, a), b) in pairs.iter_mut().zip(row(i)).zip(row(i + 1)) {
                    *pair = [bf16(*a), bf16(*b)];
                }
            } else {
                for (pair, a) in pairs.iter_mut().zip(row(i)) {
                    *pair = [bf16(*a), 0];
                }
            }
        }
    } else {
        for c in 0..cols {
            let column = &side.data[(first + c) * side.col_stride..][..side.rows];
            let (pairs, rest) = column.as_chunks::<PAIR>();
            for (line, pair) in own.chunks_exact_mut(line).zip(pairs) {
                line[PAIR * c..][..PAIR].copy_from_slice(&pair.map(bf16));
            }
            if let [last] = rest {
                own[pairs.len() * line + PAIR * c] = bf16(*last);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_of_any_shape_and_arrangement_agree_with_f64() {
        let value = |i: usize| ((i * 7919 % 1013) as f32 / 1013.0) - 0.5;
        let rounded = |value: f32| f64::from(half::bf16::from_f32(value).to_f32());
        let sizes: &[_] = match cfg!(miri) {
            true => &[(2, 3, 5), (1, 0, 3)],
            false => &[(1, 1, 1), (3, 0, 4), (33, 70, 100), (65, 129, 31), (257, 64, 48), (40, 1030, 17)],
        };
        for &(m, k, n) in sizes {
            let (wide, gap) = (m.max(k).max(n) + 3, 3 * (m + k + n));
            let data: Vec<f32> = (0..wide * wide + gap).map(value).collect();
            let bias: Vec<f32> = (0..n).map(|i| value(i + 9)).collect();
            let lefts = [Mat::new(&data, m, k, wide), Mat::new(&data, k, m, wide).t()];
            let rights = [Mat::new(&data[gap..], k, n, wide), Mat::new(&data[gap..], n, k, wide).t()];
            for (lhs, rhs) in lefts.into_iter().flat_map(|lhs| rights.map(|rhs| (lhs, rhs))) {
                let at = |side: Mat, r: usize, c: usize| rounded(side.data[r * side.row_stride + c * side.col_stride]);
                for bias in [None, Some(bias.as_slice())] {
                    let got = product(lhs, rhs, bias);
                    assert_eq!(got.len(), m * n);
                    for (r, c) in (0..m).flat_map(|r| (0..n).map(move |c| (r, c))) {
                        let sum: f64 = (0..k).map(|i| at(lhs, r, i) * at(rhs, i, c)).sum();
                        let want = sum + bias.map_or(0.0, |bias| f64::from(bias[c]));
                        let error = (f64::from(got[r * n + c]) - want).abs();
                        assert!(error < 1e-6 * (k as f64 + 1.0), "{m} {k} {n} ({r}, {c}): {error}");
                    }
                }
            }
        }
    }

    #[test]
    #[should_panic(expected = "leaves its slice")]
    fn a_side_larger_than_its_slice_is_refused() {
        let data = [0.0; 5];
        product(Mat::new(&data, 2, 3, 3), Mat::new(&data, 3, 1, 1), None);
    }
}
