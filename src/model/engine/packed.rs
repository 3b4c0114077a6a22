//! A linear layer whose weights are laid out for the tiles, in one of the precisions.

use super::aligned::{Aligned, Number};
use super::quantise::{Quantised, quantise_weights};
use super::team;
use super::tile::{self, LANES, TILES_PER_TASK, Tile, VECTORS, Weight};
use super::tile8::{self, GROUP, Tile8};
use crate::model::ops::simd;
use crate::model::precision::Precision;

/// Multiply-adds below which handing work to other threads costs more than it brings.
const SMALL: usize = 1 << 17;
/// Tasks that a product is split into where it can be, so that a thread that is held up elsewhere costs little.
const TASKS: usize = 16;

/// What happens to `x Wᵀ + b`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Then {
    /// It replaces the output.
    Store,
    /// It is added to the output.
    Add,
    /// Its exact GELU replaces the output.
    Gelu,
}

/// Rows in a slice.
#[derive(Debug, Clone, Copy)]
pub struct Rows<'a> {
    /// The values.
    pub data: &'a [f32],
    /// From one row to the next.
    pub stride: usize,
    /// Number of rows.
    pub count: usize,
}

/// `x Wᵀ + b` with weights `(n, k)`.
#[derive(Debug, Clone)]
pub struct Packed {
    n: usize,
    k: usize,
    panels: Vec<Panel>,
    weights: Weights,
    bias: Vec<f32>,
}

/// Up to [`VECTORS`] vectors of columns.
#[derive(Debug, Clone, Copy)]
struct Panel {
    /// First vector.
    first: usize,
    vectors: usize,
}

impl Panel {
    fn width(self) -> usize {
        self.vectors * LANES
    }
}

#[derive(Debug, Clone)]
enum Weights {
    F32(Aligned<f32>),
    Bf16(Aligned<u16>),
    Int8 {
        /// Panel by panel, groups of four inputs by column.
        weights: Aligned<i8>,
        /// One per output.
        scales: Vec<f32>,
        /// Sum of an output's weights: what a zero point costs.
        sums: Vec<i32>,
    },
}

impl Packed {
    /// `weight`: `(n, k)`, `bias`: `(n)`.
    pub fn new(weight: &[f32], bias: Vec<f32>, precision: Precision) -> Self {
        let n = bias.len();
        let k = weight.len() / n.max(1);
        let panels = panels(n);
        let pack = |value: &dyn Fn(usize) -> f32| Self::lines(&panels, n, k, |row, i| value(row * k + i));
        let weights = match precision {
            Precision::F32 => Weights::F32(pack(&|at| weight[at])),
            Precision::Bf16 => Weights::Bf16(Self::lines(&panels, n, k, |row, i| bf16(weight[row * k + i]))),
            Precision::Int8 => {
                let (bytes, scales) = quantise_weights(weight, n);
                let sums = bytes.chunks_exact(k).map(|row| row.iter().map(|w| i32::from(*w)).sum()).collect();
                Weights::Int8 { weights: Self::groups(&panels, n, k, &bytes), scales, sums }
            }
        };
        Self { n, k, panels, weights, bias }
    }

    /// `lines`: for each panel, for each input, the panel's columns.
    fn lines<T: Number>(panels: &[Panel], n: usize, k: usize, value: impl Fn(usize, usize) -> T) -> Aligned<T> {
        let mut data = Aligned::zeros(n.div_ceil(LANES) * LANES * k);
        for panel in panels {
            let (first, width) = (panel.first * LANES, panel.width());
            for (i, line) in data[first * k..(first + width) * k].chunks_exact_mut(width).enumerate() {
                for (column, place) in line.iter_mut().enumerate().take(n - first) {
                    *place = value(first + column, i);
                }
            }
        }
        data
    }

    fn groups(panels: &[Panel], n: usize, k: usize, bytes: &[i8]) -> Aligned<i8> {
        let padded = k.next_multiple_of(GROUP);
        let mut data = Aligned::zeros(n.div_ceil(LANES) * LANES * padded);
        for panel in panels {
            let (first, width) = (panel.first * LANES, panel.width());
            let own = &mut data[first * padded..(first + width) * padded];
            for (group, line) in own.chunks_exact_mut(width * GROUP).enumerate() {
                for (at, place) in line.iter_mut().enumerate() {
                    let (row, i) = (first + at / GROUP, group * GROUP + at % GROUP);
                    if row < n && i < k {
                        *place = bytes[row * k + i];
                    }
                }
            }
        }
        data
    }

    /// Outputs.
    pub fn n(&self) -> usize {
        self.n
    }

    /// Bytes of weights and bias.
    pub fn bytes(&self) -> usize {
        let weights = match &self.weights {
            Weights::F32(weights) => 4 * weights.len(),
            Weights::Bf16(weights) => 2 * weights.len(),
            Weights::Int8 { weights, scales, sums } => weights.len() + 4 * (scales.len() + sums.len()),
        };
        weights + 4 * self.bias.len()
    }

    /// The layer on each row of `x`; rows of `out` are `stride` apart. `quantised` is room to work in.
    ///
    /// # Panics
    /// If the slices are too short: a mistake in the caller's sizes, which depend on the configuration alone.
    pub fn forward(&self, x: Rows, out: &mut [f32], stride: usize, then: Then, quantised: &mut Quantised) {
        let rows = x.count;
        if rows == 0 || self.n == 0 {
            return;
        }
        assert!(x.stride >= self.k && (rows - 1) * x.stride + self.k <= x.data.len(), "the input leaves its slice");
        assert!(stride >= self.n && (rows - 1) * stride + self.n <= out.len(), "the result leaves its slice");
        if let Weights::Int8 { .. } = self.weights {
            quantised.set(x, self.k);
        }
        let quantised = &*quantised;
        let blocks = tile::count(rows).div_ceil(TILES_PER_TASK);
        let groups = TASKS.div_ceil(blocks).min(self.panels.len());
        let panels_per_group = self.panels.len().div_ceil(groups);
        let out = Shared(out.as_mut_ptr());
        let task = |index: usize| {
            // Tasks of the same panels follow each other.
            let (group, block) = (index / blocks, index % blocks);
            for panel in self.panels.iter().skip(group * panels_per_group).take(panels_per_group) {
                for (row, count) in tile::of_task(block, rows) {
                    self.tile(x, quantised, *panel, row, count, out, stride, then);
                }
            }
        };
        let tasks = blocks * self.panels.len().div_ceil(panels_per_group);
        if rows * self.k * self.n < SMALL {
            (0..tasks).for_each(task);
        } else {
            team::run(tasks, task);
        }
    }

    /// Writes a tile's rows and columns of `out`, and nothing else.
    #[allow(clippy::too_many_arguments, unsafe_code)]
    fn tile(
        &self,
        x: Rows,
        quantised: &Quantised,
        panel: Panel,
        row: usize,
        rows: usize,
        out: Shared,
        stride: usize,
        then: Then,
    ) {
        let first = panel.first * LANES;
        let cols = panel.width().min(self.n - first);
        let at = out.0.wrapping_add(row * stride + first);
        let bias = &self.bias[first..first + cols];
        let (k, add) = (self.k, then == Then::Add);
        match &self.weights {
            Weights::F32(weights) => float_tile(x, row, rows, weights, first, panel, k, bias, at, stride, add),
            Weights::Bf16(weights) => float_tile(x, row, rows, weights, first, panel, k, bias, at, stride, add),
            Weights::Int8 { weights, scales, sums } => {
                let (bytes, lda, of_rows) = quantised.rows(row, rows);
                let padded = k.next_multiple_of(GROUP);
                assert!((rows - 1) * lda + padded <= bytes.len(), "the quantised rows leave their slice");
                let own = &weights[first * padded..(first + panel.width()) * padded];
                let tile = Tile8 {
                    a: bytes.as_ptr(),
                    lda,
                    b: own.as_ptr(),
                    k: padded / GROUP,
                    rows: of_rows.as_ptr(),
                    scales: scales[first..first + cols].as_ptr(),
                    sums: sums[first..first + cols].as_ptr(),
                    bias: bias.as_ptr(),
                    out: at,
                    ldc: stride,
                    cols,
                    add,
                };
                // SAFETY: the slices above hold what the tile reads; `forward` asserted that the result has these rows
                // and columns, and no other task has them.
                unsafe { tile8::compute(&tile, rows, panel.vectors) };
            }
        }
        if then == Then::Gelu {
            // SAFETY: as above: the last row ends inside the result. Between the rows' columns nothing is touched.
            gelu(|r| unsafe { std::slice::from_raw_parts_mut(at.wrapping_add(r * stride), cols) }, rows);
        }
    }
}

#[allow(clippy::too_many_arguments, unsafe_code)]
fn float_tile<E: Weight>(
    x: Rows,
    row: usize,
    rows: usize,
    weights: &[E],
    first: usize,
    panel: Panel,
    k: usize,
    bias: &[f32],
    out: *mut f32,
    ldc: usize,
    add: bool,
) {
    let a = &x.data[row * x.stride..(row + rows - 1) * x.stride + k];
    let b = &weights[first * k..(first + panel.width()) * k];
    let tile =
        Tile { a: a.as_ptr(), lda: x.stride, b: b.as_ptr(), k, bias: bias.as_ptr(), out, ldc, cols: bias.len(), add };
    // SAFETY: the slices above hold what the tile reads; `forward` asserted that the result has these rows and columns,
    // and no other task has them.
    unsafe { tile::compute(&tile, rows, panel.vectors) };
}

/// Exact GELU of `rows` rows.
#[inline(always)]
fn gelu<'a>(row: impl Fn(usize) -> &'a mut [f32], rows: usize) {
    simd::dispatch(
        #[inline(always)]
        || {
            for r in 0..rows {
                let (chunks, rest) = row(r).as_chunks_mut::<LANES>();
                for chunk in chunks {
                    for value in chunk.iter_mut() {
                        *value = simd::gelu(*value);
                    }
                }
                for value in rest {
                    *value = simd::gelu(*value);
                }
            }
        },
    );
}

/// A result that tasks share, each writing rows and columns of its own.
#[derive(Clone, Copy)]
pub struct Shared(pub *mut f32);

#[allow(unsafe_code)]
// SAFETY: whoever writes through it says which places are its own.
unsafe impl Send for Shared {}
#[allow(unsafe_code)]
// SAFETY: as above.
unsafe impl Sync for Shared {}

/// The vectors of `n` columns, spread evenly over panels.
fn panels(n: usize) -> Vec<Panel> {
    let vectors = n.div_ceil(LANES);
    let count = vectors.div_ceil(VECTORS);
    let starts = (0..=count).map(|i| i * vectors / count.max(1));
    starts.clone().zip(starts.skip(1)).map(|(first, next)| Panel { first, vectors: next - first }).collect()
}

/// Rounded to the nearest bf16, ties to even.
fn bf16(value: f32) -> u16 {
    half::bf16::from_f32(value).to_bits()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layers_of_any_size_are_the_product_of_the_definition() {
        let value = |i: usize| ((i * 7919 % 1013) as f32 / 1013.0) - 0.5;
        for (rows, k, n) in [(1, 3, 5), (9, 16, 48), (41, 23, 64), (33, 70, 100), (2, 192, 1556), (257, 12, 17)] {
            let (stride, out_stride) = (k + 5, n + 3);
            let x: Vec<f32> = (0..rows * stride).map(value).collect();
            let weight: Vec<f32> = (0..n * k).map(|i| value(i + 3)).collect();
            let bias: Vec<f32> = (0..n).map(|i| value(i + 77)).collect();
            for (precision, tolerance) in [(Precision::F32, 2e-6), (Precision::Bf16, 2e-3), (Precision::Int8, 1e-2)] {
                let layer = Packed::new(&weight, bias.clone(), precision);
                for then in [Then::Store, Then::Add, Then::Gelu] {
                    let mut out = vec![0.25; rows * out_stride];
                    let input = Rows { data: &x, stride, count: rows };
                    layer.forward(input, &mut out, out_stride, then, &mut Quantised::default());
                    for (r, c) in [(0, 0), (rows - 1, n - 1), (rows / 2, n / 2), (rows - 1, 0), (0, n - 1)] {
                        let product: f64 =
                            (0..k).map(|i| f64::from(x[r * stride + i]) * f64::from(weight[c * k + i])).sum();
                        let sum = product + f64::from(bias[c]);
                        let want = match then {
                            Then::Store => sum,
                            Then::Add => sum + 0.25,
                            Then::Gelu => sum * f64::from(simd::normal(sum as f32)[0]),
                        };
                        let error = (f64::from(out[r * out_stride + c]) - want).abs();
                        assert!(error < tolerance * (k as f64).sqrt(), "{precision} {then:?} {rows} {k} {n}: {error}");
                    }
                    let gap: Vec<f32> = out.chunks(out_stride).flat_map(|row| row[n..].to_vec()).collect();
                    assert!(gap.iter().all(|value| *value == 0.25), "wrote beyond the columns");
                }
            }
        }
    }
}
