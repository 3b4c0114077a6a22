//! A linear layer whose weights are laid out for the tiles, in one of three number formats.
//!
//! The weights `(n, k)` are cut into panels of up to 48 outputs. A panel holds, input by input, the weights of all its
//! outputs, so that a tile reads it from start to end and each line feeds whole vectors. In 8 bits a line holds groups of
//! four inputs, which one instruction consumes.

use crate::aligned::{Aligned, Number};
use crate::quantise::{Quantised, quantise_weights};
use crate::rows::Rows;
use crate::simd;
use crate::team;
use crate::tile::{self, LANES, TILES_PER_TASK, Tile, VECTORS, Weight};
use crate::tile8::{self, GROUP, Tile8};

/// Multiply-adds below which one thread computes the whole product: handing tasks to others would take longer.
const SMALL: usize = 1 << 17;
/// Least number of tasks that a product is split into, as far as its panels allow: with many small tasks, a thread that
/// the system suspends holds up little work.
const TASKS: usize = 16;

/// Number format of a layer's weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Weights and arithmetic in f32.
    F32,
    /// Weights in bf16, arithmetic in f32.
    Bf16,
    /// Weights in int8 with a scale per output, activations in uint8 with scale and zero point per row.
    Int8,
}

/// Use of the product `x Wᵀ + b`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Then {
    /// It replaces the output.
    Store,
    /// It is added to the output.
    Add,
    /// Its exact GELU replaces the output.
    Gelu,
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

/// Up to [`VECTORS`] vectors of outputs.
#[derive(Debug, Clone, Copy)]
struct Panel {
    /// Index of the first vector.
    first: usize,
    /// Number of vectors.
    vectors: usize,
}

impl Panel {
    /// First output.
    fn start(self) -> usize {
        self.first * LANES
    }

    /// Outputs, padding included.
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
        /// Scale of each output.
        scales: Vec<f32>,
        /// Sum of each output's weights, which a zero point multiplies.
        sums: Vec<i32>,
    },
}

/// One tile of a product: its rows, its panel, and the place of its result.
struct Place<'a> {
    x: Rows<'a>,
    /// First row and number of rows.
    row: usize,
    rows: usize,
    panel: Panel,
    /// First value of the tile in the result, and values from row to row.
    out: *mut f32,
    stride: usize,
    add: bool,
}

impl Packed {
    /// Lays out a layer. `weight`: `(n, k)`, `bias`: `(n)`.
    pub fn new(weight: &[f32], bias: Vec<f32>, format: Format) -> Self {
        let n = bias.len();
        let k = weight.len() / n.max(1);
        let panels = panels(n);
        let weights = match format {
            Format::F32 => Weights::F32(lines(&panels, n, k, |row, i| weight[row * k + i])),
            Format::Bf16 => Weights::Bf16(lines(&panels, n, k, |row, i| bf16(weight[row * k + i]))),
            Format::Int8 => {
                let (bytes, scales) = quantise_weights(weight, n);
                let sums = bytes.chunks_exact(k).map(|row| row.iter().map(|w| i32::from(*w)).sum()).collect();
                Weights::Int8 { weights: groups(&panels, n, k, &bytes), scales, sums }
            }
        };
        Self { n, k, panels, weights, bias }
    }

    /// Number of outputs.
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

    /// Applies the layer to each row of `x`. Rows of `out` are `stride` apart; values between them are not touched.
    /// `quantised` is a buffer for the input in 8 bits.
    ///
    /// # Panics
    /// If a slice is too short for its rows. Sizes depend on the configuration alone, never on the data.
    pub fn forward(&self, x: Rows, out: &mut [f32], stride: usize, then: Then, quantised: &mut Quantised) {
        let rows = x.count;
        if rows == 0 || self.n == 0 {
            return;
        }
        assert!(fits(rows, x.stride, self.k, x.data.len()), "the input leaves its slice");
        assert!(fits(rows, stride, self.n, out.len()), "the result leaves its slice");
        if let Weights::Int8 { .. } = self.weights {
            quantised.set(x, self.k);
        }
        let quantised = &*quantised;
        // Tasks are blocks of rows times groups of panels: rows first, and panels too where rows give too few tasks.
        let blocks = tile::count(rows).div_ceil(TILES_PER_TASK);
        let groups = TASKS.div_ceil(blocks).min(self.panels.len());
        let panels_per_group = self.panels.len().div_ceil(groups);
        let out = Shared(out.as_mut_ptr());
        let task = |index: usize| {
            // Consecutive tasks have the same panels, which threads then share in the outer cache.
            let (group, block) = (index / blocks, index % blocks);
            for panel in self.panels.iter().skip(group * panels_per_group).take(panels_per_group) {
                for (row, count) in tile::of_task(block, rows) {
                    let out = out.at(row * stride + panel.start());
                    let add = then == Then::Add;
                    let place = Place { x, row, rows: count, panel: *panel, out, stride, add };
                    self.tile(&place, quantised, then);
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

    /// Computes one tile: writes its rows and columns of the result, and no other value.
    fn tile(&self, place: &Place, quantised: &Quantised, then: Then) {
        match &self.weights {
            Weights::F32(weights) => self.float_tile(place, weights),
            Weights::Bf16(weights) => self.float_tile(place, weights),
            Weights::Int8 { weights, scales, sums } => self.int8_tile(place, weights, scales, sums, quantised),
        }
        if then == Then::Gelu {
            let cols = self.cols(place.panel);
            for r in 0..place.rows {
                // SAFETY: `forward` asserted that row `row + r` of the result has this panel's `cols` columns, and no other
                // task has this tile. One row's slice exists at a time, so none spans the values between rows.
                gelu(unsafe { std::slice::from_raw_parts_mut(place.out.wrapping_add(r * place.stride), cols) });
            }
        }
    }

    /// Outputs of a panel, padding not included.
    fn cols(&self, panel: Panel) -> usize {
        panel.width().min(self.n - panel.start())
    }

    fn float_tile<E: Weight>(&self, place: &Place, weights: &[E]) {
        let Place { x, row, rows, panel, out, stride, add } = *place;
        let (k, first, cols) = (self.k, panel.start(), self.cols(panel));
        let a = &x.data[row * x.stride..(row + rows - 1) * x.stride + k];
        let b = &weights[first * k..(first + panel.width()) * k];
        let bias = self.bias[first..first + cols].as_ptr();
        let tile = Tile { a: a.as_ptr(), lda: x.stride, b: b.as_ptr(), k, bias, out, ldc: stride, cols, add };
        // SAFETY: the slices `a`, `b` and the bias hold what the tile reads. `forward` asserted that the result has these
        // rows and columns, and each tile of `tile::of_task` and panel occurs in one task only.
        unsafe { tile::compute(&tile, rows, panel.vectors) };
    }

    fn int8_tile(&self, place: &Place, weights: &[i8], scales: &[f32], sums: &[i32], quantised: &Quantised) {
        let Place { row, rows, panel, out, stride, add, .. } = *place;
        let (first, cols) = (panel.start(), self.cols(panel));
        let padded = self.k.next_multiple_of(GROUP);
        let (bytes, lda, of_rows) = quantised.rows(row, rows);
        assert!(fits(rows, lda, padded, bytes.len()), "the quantised rows leave their slice");
        let tile = Tile8 {
            a: bytes.as_ptr(),
            lda,
            b: weights[first * padded..(first + panel.width()) * padded].as_ptr(),
            k: padded / GROUP,
            rows: of_rows.as_ptr(),
            scales: scales[first..first + cols].as_ptr(),
            sums: sums[first..first + cols].as_ptr(),
            bias: self.bias[first..first + cols].as_ptr(),
            out,
            ldc: stride,
            cols,
            add,
        };
        // SAFETY: the assertion and the slices above cover what the tile reads; `of_rows` has `rows` entries. `forward`
        // asserted that the result has these rows and columns, and no other task has this tile.
        unsafe { tile8::compute(&tile, rows, panel.vectors) };
    }
}

/// True if `rows` rows of `width` values, `stride` apart, do not overlap and lie inside a slice of `len` values.
fn fits(rows: usize, stride: usize, width: usize, len: usize) -> bool {
    let last = rows.saturating_sub(1).checked_mul(stride).and_then(|start| start.checked_add(width));
    stride >= width && last.is_some_and(|end| end <= len)
}

/// Packs floating-point weights: for each panel, for each input, the weights of the panel's outputs. Padding is zero.
fn lines<T: Number>(panels: &[Panel], n: usize, k: usize, value: impl Fn(usize, usize) -> T) -> Aligned<T> {
    let mut data = Aligned::zeros(n.div_ceil(LANES) * LANES * k);
    for panel in panels {
        let (first, width) = (panel.start(), panel.width());
        for (i, line) in data[first * k..(first + width) * k].chunks_exact_mut(width).enumerate() {
            for (column, place) in line.iter_mut().enumerate().take(n - first) {
                *place = value(first + column, i);
            }
        }
    }
    data
}

/// Packs 8-bit weights: for each panel, for each group of four inputs, the four weights of each output. Padding is zero.
fn groups(panels: &[Panel], n: usize, k: usize, bytes: &[i8]) -> Aligned<i8> {
    let padded = k.next_multiple_of(GROUP);
    let mut data = Aligned::zeros(n.div_ceil(LANES) * LANES * padded);
    for panel in panels {
        let (first, width) = (panel.start(), panel.width());
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

/// Exact GELU of a row, in place.
#[inline(always)]
fn gelu(row: &mut [f32]) {
    simd::dispatch(
        #[inline(always)]
        || {
            let (chunks, rest) = row.as_chunks_mut::<LANES>();
            for chunk in chunks {
                for value in chunk.iter_mut() {
                    *value = simd::gelu(*value);
                }
            }
            for value in rest {
                *value = simd::gelu(*value);
            }
        },
    );
}

/// Start of a result whose tasks write disjoint tiles.
#[derive(Clone, Copy)]
pub(crate) struct Shared(pub *mut f32);

impl Shared {
    /// Address of a value; to be used inside the slice that the pointer was taken from.
    pub fn at(&self, index: usize) -> *mut f32 {
        self.0.wrapping_add(index)
    }
}

// SAFETY: the pointer itself is never changed. Its users, `Packed::forward` and `Attention::forward`, give every task its
// own tiles of the result, so threads never share a value, and keep the result borrowed until all tasks are done.
unsafe impl Sync for Shared {}

/// Distributes the vectors of `n` outputs evenly over panels of at most [`VECTORS`].
fn panels(n: usize) -> Vec<Panel> {
    let vectors = n.div_ceil(LANES);
    let count = vectors.div_ceil(VECTORS);
    let starts = (0..=count).map(|i| i * vectors / count.max(1));
    starts.clone().zip(starts.skip(1)).map(|(first, next)| Panel { first, vectors: next - first }).collect()
}

/// Rounds to the nearest bf16, ties to even.
fn bf16(value: f32) -> u16 {
    half::bf16::from_f32(value).to_bits()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_layer_of_any_size_gives_the_product_in_f64() {
        let value = |i: usize| ((i * 7919 % 1013) as f32 / 1013.0) - 0.5;
        // Miri takes seconds for what takes others a millisecond: one tile, then two tiles beside a panel with a rest.
        let sizes: &[_] = match cfg!(miri) {
            true => &[(1, 3, 5), (10, 5, 50)],
            false => &[(1, 3, 5), (9, 16, 48), (41, 23, 64), (33, 70, 100), (2, 192, 1556), (257, 12, 17)],
        };
        for &(rows, k, n) in sizes {
            let (stride, out_stride) = (k + 5, n + 3);
            let x: Vec<f32> = (0..rows * stride).map(value).collect();
            let weight: Vec<f32> = (0..n * k).map(|i| value(i + 3)).collect();
            let bias: Vec<f32> = (0..n).map(|i| value(i + 77)).collect();
            for (format, tolerance) in [(Format::F32, 2e-6), (Format::Bf16, 2e-3), (Format::Int8, 1e-2)] {
                let layer = Packed::new(&weight, bias.clone(), format);
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
                        assert!(error < tolerance * (k as f64).sqrt(), "{format:?} {then:?} {rows} {k} {n}: {error}");
                    }
                    let gap: Vec<f32> = out.chunks(out_stride).flat_map(|row| row[n..].to_vec()).collect();
                    assert!(gap.iter().all(|value| *value == 0.25), "wrote beyond the columns");
                }
            }
        }
    }
}
