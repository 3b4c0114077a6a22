//! A linear layer whose weights are laid out for the tiles, in one of three number formats.
//!
//! The weights `(n, k)` are cut into panels of up to 48 outputs. A panel holds, input by input, the weights of all its
//! outputs, so that a tile reads it from start to end and each line feeds whole vectors. In 8 bits a line holds groups of
//! four inputs, which one instruction consumes; in 16 bits pairs, where the processor has a matrix unit.

use crate::aligned::{Aligned, Number};
use crate::amx::{self, Block, Finish, Kind, STEP, Scales, Sums};
use crate::quantise::{Quantised, bf16, quantise_weights};
use crate::rows::{Rows, part};
use crate::simd;
use crate::team;
use crate::tile::{self, LANES, Tile, VECTORS, Weight};
use crate::tile8::{self, GROUP, Tile8};

/// Multiply-adds below which one thread computes the whole product: handing tasks to others would take longer.
const SMALL: usize = 1 << 17;
/// Least number of tasks that a product is split into, as far as its panels allow: with many small tasks, a thread that
/// the system suspends holds up little work.
const TASKS: usize = 16;
/// Bytes of activations that a task goes through for one panel: they stay in a core's own cache, beside the panel, until the
/// next panel needs them again.
const CACHE: usize = 1 << 20;
/// Values in bf16 that the matrix unit multiplies and adds at once.
pub(crate) const PAIR: usize = 2;

/// Number format of a layer's weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Weights and arithmetic in f32.
    F32,
    /// Weights in bf16. Arithmetic in f32, or, where the processor has a matrix unit, with activations in bf16 and sums in
    /// f32.
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
    unit: Unit,
    panels: Vec<Panel>,
    weights: Weights,
    /// Padded to whole vectors.
    bias: Vec<f32>,
}

/// Part of the processor that computes a layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unit {
    /// Vector instructions.
    Vectors,
    /// The matrix unit.
    Matrix,
}

impl Unit {
    /// Returns the faster one that this processor has for a format.
    pub(crate) fn of(format: Format) -> Self {
        if format != Format::F32 && amx::available() { Self::Matrix } else { Self::Vectors }
    }

    /// Vectors of outputs in the widest panel.
    fn vectors(self) -> usize {
        match self {
            Self::Vectors => VECTORS,
            Self::Matrix => amx::VECTORS,
        }
    }

    /// Number of tiles that `rows` rows are split into. Tiles differ by at most one row.
    fn tiles(self, rows: usize) -> usize {
        match self {
            Self::Vectors => tile::count(rows),
            Self::Matrix => amx::count(rows),
        }
    }
}

/// Vectors of outputs that a tile computes at once.
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
    /// bf16, panel by panel, pairs of inputs by column.
    Pairs(Aligned<u16>),
    Int8 {
        /// Panel by panel, groups of four inputs by column.
        weights: Aligned<i8>,
        /// Scale of each output, padded to whole vectors.
        scales: Vec<f32>,
        /// Sum of each output's weights, which a zero point multiplies.
        sums: Vec<i32>,
    },
}

/// Parts of [`Weights::Int8`].
struct Int8<'a> {
    weights: &'a [i8],
    scales: &'a [f32],
    sums: &'a [i32],
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
        Self::for_unit(weight, bias, format, Unit::of(format))
    }

    fn for_unit(weight: &[f32], mut bias: Vec<f32>, format: Format, unit: Unit) -> Self {
        let n = bias.len();
        let k = weight.len() / n.max(1);
        let padded = n.next_multiple_of(LANES);
        bias.resize(padded, 0.0);
        let panels = panels(n, unit.vectors());
        let of = |row: usize, i: usize| weight[row * k + i];
        let weights = match (format, unit) {
            (Format::F32, _) => Weights::F32(lines::<1, _>(&panels, n, k, of)),
            (Format::Bf16, Unit::Vectors) => Weights::Bf16(lines::<1, _>(&panels, n, k, |row, i| bf16(of(row, i)))),
            (Format::Bf16, Unit::Matrix) => Weights::Pairs(lines::<PAIR, _>(&panels, n, k, |row, i| bf16(of(row, i)))),
            (Format::Int8, _) => {
                let (bytes, mut scales) = quantise_weights(weight, n);
                let mut sums: Vec<i32> =
                    bytes.chunks_exact(k).map(|row| row.iter().map(|w| i32::from(*w)).sum()).collect();
                scales.resize(padded, 0.0);
                sums.resize(padded, 0);
                Weights::Int8 { weights: lines::<GROUP, _>(&panels, n, k, |row, i| bytes[row * k + i]), scales, sums }
            }
        };
        Self { n, k, unit, panels, weights, bias }
    }

    /// Bytes of an activation as the tiles read it.
    fn bytes_per_input(&self) -> usize {
        match self.weights {
            Weights::F32(_) | Weights::Bf16(_) => 4,
            Weights::Pairs(_) => 2,
            Weights::Int8 { .. } => 1,
        }
    }

    /// Number of outputs.
    pub fn n(&self) -> usize {
        self.n
    }

    /// Bytes of weights and bias.
    pub fn bytes(&self) -> usize {
        let weights = match &self.weights {
            Weights::F32(weights) => 4 * weights.len(),
            Weights::Bf16(weights) | Weights::Pairs(weights) => 2 * weights.len(),
            Weights::Int8 { weights, scales, sums } => weights.len() + 4 * (scales.len() + sums.len()),
        };
        weights + 4 * self.bias.len()
    }

    /// Applies the layer to each row of `x`. Rows of `out` are `stride` apart; values between them are not touched.
    /// `quantised` is a buffer for the input in fewer bits.
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
        match self.weights {
            Weights::Int8 { .. } => quantised.set(x, self.k),
            Weights::Pairs(_) => quantised.set_halves(x, self.k),
            Weights::F32(_) | Weights::Bf16(_) => {}
        }
        let quantised = &*quantised;
        // A task takes one panel, so that weights come from memory once, and the rows of as many tiles as stay in a core's
        // own cache; fewer where the panels give too few tasks.
        let tiles = self.unit.tiles(rows);
        let bytes = rows * self.k * self.bytes_per_input();
        let blocks = TASKS.div_ceil(self.panels.len()).max(bytes.div_ceil(CACHE)).min(tiles);
        let out = Shared(out.as_mut_ptr());
        let task = |index: usize| {
            // Consecutive tasks have the same panel.
            let (panel, block) = (self.panels[index / blocks], index % blocks);
            let (first, count) = part(block, blocks, tiles);
            for tile in first..first + count {
                let (row, count) = part(tile, tiles, rows);
                let out = out.at(row * stride + panel.start());
                let add = then == Then::Add;
                self.tile(&Place { x, row, rows: count, panel, out, stride, add }, quantised, then);
            }
        };
        let tasks = blocks * self.panels.len();
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
            Weights::Pairs(weights) => self.pair_block(place, weights, quantised),
            Weights::Int8 { weights, scales, sums } => {
                let int8 = Int8 { weights, scales, sums };
                match self.unit {
                    Unit::Vectors => self.int8_tile(place, &int8, quantised),
                    Unit::Matrix => self.int8_block(place, &int8, quantised),
                }
            }
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
        // rows and columns, and each tile and panel occur in one task only.
        unsafe { tile::compute(&tile, rows, panel.vectors) };
    }

    fn int8_tile(&self, place: &Place, of: &Int8, quantised: &Quantised) {
        let Place { row, rows, panel, out, stride, add, .. } = *place;
        let (first, cols) = (panel.start(), self.cols(panel));
        let padded = self.k.next_multiple_of(STEP);
        let (bytes, lda, of_rows) = quantised.rows(row, rows);
        assert!(fits(rows, lda, padded, bytes.len()), "the quantised rows leave their slice");
        let tile = Tile8 {
            a: bytes.as_ptr(),
            lda,
            b: of.weights[first * padded..(first + panel.width()) * padded].as_ptr(),
            k: self.k.div_ceil(GROUP),
            rows: of_rows.as_ptr(),
            scales: of.scales[first..first + cols].as_ptr(),
            sums: of.sums[first..first + cols].as_ptr(),
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

    /// Computes a block of an 8-bit layer in the matrix unit, with the bits of [`Self::int8_tile`].
    fn int8_block(&self, place: &Place, of: &Int8, quantised: &Quantised) {
        let (first, width) = (place.panel.start(), place.panel.width());
        let padded = self.k.next_multiple_of(STEP);
        let (bytes, lda, rows) = quantised.rows(place.row, place.rows);
        assert!(fits(place.rows, lda, padded, bytes.len()), "the quantised rows leave their slice");
        let panel = of.weights[first * padded..(first + width) * padded].as_ptr();
        let operands = (bytes.as_ptr(), lda, panel.cast(), padded / STEP);
        let lanes = first / LANES..;
        let (columns, weights) = (&vectors(of.scales)[lanes.clone()], &vectors(of.sums)[lanes]);
        // SAFETY: the assertion covers the rows, and the slice the panel.
        unsafe { self.block(place, Kind::Byte, operands, Some(Scales { rows, columns, weights })) };
    }

    /// Computes a block of a layer in bf16 in the matrix unit.
    fn pair_block(&self, place: &Place, weights: &[u16], quantised: &Quantised) {
        let (first, width) = (place.panel.start(), place.panel.width());
        let padded = self.k.next_multiple_of(STEP / PAIR);
        let (halves, lda) = quantised.halves(place.row);
        assert!(fits(place.rows, lda, padded, halves.len()), "the halved rows leave their slice");
        let panel = weights[first * padded..(first + width) * padded].as_ptr();
        let operands = (halves.as_ptr().cast(), lda * PAIR, panel.cast(), padded * PAIR / STEP);
        // SAFETY: the assertion covers the rows, and the slice the panel; a half has two bytes.
        unsafe { self.block(place, Kind::Half, operands, None) };
    }

    /// Computes a block in the matrix unit. `a`, `lda`, `b`, `steps`: see [`Block`].
    ///
    /// # Safety
    /// `place.rows` rows of 64 `steps` bytes can be read from `a`, `lda` bytes apart, and 16 `steps` lines of the panel's
    /// vectors from `b`.
    unsafe fn block(
        &self,
        place: &Place,
        kind: Kind,
        (a, lda, b, steps): (*const u8, usize, *const u8, usize),
        scales: Option<Scales>,
    ) {
        let Place { rows, panel, out, stride, add, .. } = *place;
        let mut sums = Sums::new();
        let block = Block { a, lda, b, steps, out: sums.start(), ldc: amx::WIDTH };
        let bias = &vectors(&self.bias)[panel.first..];
        let to = Finish { out, ldc: stride, rows, cols: self.cols(panel), add, bias, scales };
        // SAFETY: operands are as the caller guarantees. `Unit::tiles` gives blocks of at most `amx::ROWS` rows and
        // `Unit::vectors` panels of at most `amx::VECTORS`, for which the sums have room. `forward` asserted that the result has
        // these rows and columns, and no other task has this block.
        unsafe {
            amx::multiply(kind, &block, rows, panel.vectors);
            amx::finish(&sums, &to);
        }
    }
}

/// Returns values of the outputs by vectors; the padding completes the last.
fn vectors<T>(values: &[T]) -> &[[T; LANES]] {
    values.as_chunks().0
}

/// True if `rows` rows of `width` values, `stride` apart, do not overlap and lie inside a slice of `len` values.
fn fits(rows: usize, stride: usize, width: usize, len: usize) -> bool {
    let last = rows.saturating_sub(1).checked_mul(stride).and_then(|start| start.checked_add(width));
    stride >= width && last.is_some_and(|end| end <= len)
}

/// Packs weights: for each panel, for each group of `PER` inputs, the group's weights of each output. Padding is zero; inputs
/// of groups are padded to whole cache lines.
fn lines<const PER: usize, T: Number>(
    panels: &[Panel],
    n: usize,
    k: usize,
    value: impl Fn(usize, usize) -> T,
) -> Aligned<T> {
    let padded = if PER == 1 { k } else { k.next_multiple_of(STEP / size_of::<T>()) };
    let mut data = Aligned::zeros(n.div_ceil(LANES) * LANES * padded);
    for panel in panels {
        let (first, width) = (panel.start(), panel.width());
        let own = &mut data[first * padded..(first + width) * padded];
        for (group, line) in own.chunks_exact_mut(width * PER).enumerate() {
            for (at, place) in line.iter_mut().enumerate() {
                let (row, i) = (first + at / PER, group * PER + at % PER);
                if row < n && i < k {
                    *place = value(row, i);
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

/// Distributes the vectors of `n` outputs evenly over panels of at most `most`.
fn panels(n: usize, most: usize) -> Vec<Panel> {
    let vectors = n.div_ceil(LANES);
    let count = vectors.div_ceil(most);
    let starts = (0..=count).map(|i| i * vectors / count.max(1));
    starts.clone().zip(starts.skip(1)).map(|(first, next)| Panel { first, vectors: next - first }).collect()
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
            // Without a matrix unit its layout is tested with the plain form of its products.
            for (format, unit, tolerance) in [
                (Format::F32, Unit::Vectors, 2e-6),
                (Format::Bf16, Unit::Vectors, 2e-3),
                (Format::Bf16, Unit::Matrix, 3e-3),
                (Format::Int8, Unit::Vectors, 1e-2),
                (Format::Int8, Unit::Matrix, 1e-2),
            ] {
                let layer = Packed::for_unit(&weight, bias.clone(), format, unit);
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
                        assert!(
                            error < tolerance * (k as f64).sqrt(),
                            "{format:?} {unit:?} {then:?} {rows} {k} {n}: {error}"
                        );
                    }
                    let gap: Vec<f32> = out.chunks(out_stride).flat_map(|row| row[n..].to_vec()).collect();
                    assert!(gap.iter().all(|value| *value == 0.25), "wrote beyond the columns");
                }
            }
        }
    }

    #[test]
    fn an_8_bit_layer_has_the_same_bits_in_both_units() {
        let value = |i: usize| ((i * 7919 % 1013) as f32 / 1013.0) - 0.5;
        let (rows, k, n) = if cfg!(miri) { (3, 5, 18) } else { (67, 150, 100) };
        let x: Vec<f32> = (0..rows * k).map(value).collect();
        let weight: Vec<f32> = (0..n * k).map(|i| value(i + 3)).collect();
        let bias: Vec<f32> = (0..n).map(|i| value(i + 77)).collect();
        let results = [Unit::Vectors, Unit::Matrix].map(|unit| {
            let layer = Packed::for_unit(&weight, bias.clone(), Format::Int8, unit);
            let mut out = vec![0.25; rows * n];
            layer.forward(Rows::new(&x, k), &mut out, n, Then::Add, &mut Quantised::default());
            out
        });
        assert_eq!(results[0], results[1]);
    }
}
