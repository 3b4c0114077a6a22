//! A linear layer whose weights are laid out for the tiles, in one of three number formats.
//!
//! The weights `(n, k)` are cut into panels of up to 48 outputs, 16 on AVX2. A panel holds, input by input, the weights of all its
//! outputs, so that a tile reads it from start to end and each line feeds whole vectors. In 8 bits a line holds groups of
//! four inputs, which one instruction consumes; in 16 bits pairs, where the processor has a matrix unit.

mod matrix;
pub(crate) mod product;
mod vectors;

use crate::activations::{Activations, Form, Input, Target};
use crate::aligned::{Aligned, Number};
use crate::amx::{self, STEP};
use crate::quantise::{bf16, quantise_weights};
use crate::rows::{Rows, part};
use crate::team;
use crate::tile::{self, LANES, Next};
use crate::tile8::GROUP;

/// Multiply-adds below which one thread computes the whole product: handing tasks to others would take longer.
const SMALL: usize = 1 << 17;
/// Least number of tasks that a product is split into, as far as its panels allow: with many small tasks, a thread that
/// the system suspends holds up little work.
const TASKS: usize = 16;
/// Bytes of activations that a task goes through for one panel: they stay in a core's own cache, beside this panel and the next,
/// until the next panel needs them again.
const CACHE: usize = 1 << 19;
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
            Self::Vectors => tile::widest(),
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

    /// Its part of the packed weights, with `inputs` weights of each output.
    fn of<T>(self, weights: &[T], inputs: usize) -> &[T] {
        &weights[self.start() * inputs..(self.start() + self.width()) * inputs]
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

/// One tile of a product: its rows, its panel, and the place of its result.
struct Place {
    /// First row and number of rows.
    row: usize,
    rows: usize,
    panel: Panel,
    /// First value of the tile in the result, and values from row to row.
    out: Target,
    stride: usize,
    then: Then,
    /// Panel that this thread needs next, if there is one, and tiles of the present panel that it has computed.
    next: Option<Panel>,
    before: usize,
}

impl Place {
    /// Returns the part of the next panel that this tile asks for with `hints` hints. `inputs`: weights of each output.
    fn ask<T>(&self, weights: &[T], inputs: usize, hints: usize) -> Next {
        self.next.map_or(Next::NONE, |next| Next::share(next.of(weights, inputs), hints, self.before))
    }
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

    /// Form in which the layer reads its input.
    pub fn form(&self) -> Form {
        match self.weights {
            Weights::F32(_) | Weights::Bf16(_) => Form::Floats,
            Weights::Pairs(_) => Form::Halves,
            Weights::Int8 { .. } => Form::Bytes,
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
    /// `buffer` holds the input in fewer bits.
    ///
    /// # Panics
    /// If a slice is too short for its rows. Sizes depend on the configuration alone, never on the data.
    pub fn forward(&self, x: Rows, out: &mut [f32], stride: usize, then: Then, buffer: &mut Activations) {
        let input = match self.form() {
            Form::Floats => Input::Floats(x),
            form => {
                buffer.set(x, self.k, form);
                buffer.rows()
            }
        };
        self.checked(input, x.count, out, stride, then);
    }

    /// As [`Self::forward`], from rows in the [`Self::form`] of this layer.
    ///
    /// # Panics
    /// As [`Self::forward`], and if the rows have another form or width.
    pub fn apply(&self, x: &Activations, out: &mut [f32], stride: usize, then: Then) {
        assert_eq!(x.width(), self.k, "the rows have another width than the layer");
        self.checked(x.rows(), x.count(), out, stride, then);
    }

    /// As [`Self::apply`], into rows of the form in which another layer reads them. They are those of [`Self::apply`], converted.
    ///
    /// # Panics
    /// If the rows have another form or width than those that the layer reads, or the result is to be added.
    pub fn apply_into(&self, x: &Activations, out: &mut Activations, form: Form, then: Then) {
        assert_eq!(x.width(), self.k, "the rows have another width than the layer");
        assert_ne!(then, Then::Add, "activations are replaced, not added to");
        out.receive(form, x.count(), self.n, self.unit == Unit::Matrix, |target, stride| {
            self.run(x.rows(), x.count(), target, stride, then);
        });
    }

    /// Outputs of a panel, padding not included.
    fn cols(&self, panel: Panel) -> usize {
        panel.width().min(self.n - panel.start())
    }

    fn checked(&self, x: Input, rows: usize, out: &mut [f32], stride: usize, then: Then) {
        if rows > 0 && self.n > 0 {
            assert!(fits(rows, stride, self.n, out.len()), "the result leaves its slice");
            self.run(x, rows, Target::Floats(out.as_mut_ptr()), stride, then);
        }
    }

    /// Applies the layer to `rows` rows; `out` must have room for as many, `stride` values apart.
    fn run(&self, x: Input, rows: usize, out: Target, stride: usize, then: Then) {
        if rows == 0 || self.n == 0 {
            return;
        }
        let bytes_per_input = match x {
            Input::Floats(x) => {
                assert!(fits(rows, x.stride, self.k, x.data.len()), "the input leaves its slice");
                size_of::<f32>()
            }
            Input::Halves(..) => size_of::<u16>(),
            Input::Bytes(..) => size_of::<u8>(),
        };
        // A task takes one panel, so that weights come from memory once, and the rows of as many tiles as stay in a core's
        // own cache; fewer where the panels give too few tasks.
        let tiles = self.unit.tiles(rows);
        let bytes = rows * self.k * bytes_per_input;
        let blocks = TASKS.div_ceil(self.panels.len()).max(bytes.div_ceil(CACHE)).min(tiles);
        let threads = team::threads();
        let task = |index: usize| {
            // Consecutive tasks have the same panel.
            let (panel, block) = (self.panels[index / blocks], index % blocks);
            let (first, count) = part(block, blocks, tiles);
            // Threads take tasks in turn: each needs the next panel, or skips those that the others take.
            let (skipped, done) = match blocks < threads {
                true => (threads / blocks, 0),
                false => (1, block / threads * count),
            };
            let next = self.panels.get(index / blocks + skipped).copied();
            let places = (first..first + count).map(|tile| {
                let (row, rows) = part(tile, tiles, rows);
                let out = out.at(row * stride + panel.start());
                Place { row, rows, panel, out, stride, then, next, before: done + tile - first }
            });
            match self.unit {
                Unit::Vectors => places.for_each(|place| self.tile(x, &place)),
                Unit::Matrix => self.blocks(x, places),
            }
        };
        let tasks = blocks * self.panels.len();
        if rows * self.k * self.n < SMALL {
            (0..tasks).for_each(task);
        } else {
            team::run(tasks, task);
        }
    }
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
    use crate::activations::tests::restored;
    use crate::simd;

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
                    layer.forward(input, &mut out, out_stride, then, &mut Activations::default());
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
    fn rows_for_the_next_layer_are_those_of_the_layer_converted() {
        let value = |i: usize| ((i * 7919 % 1013) as f32 / 1013.0) - 0.5;
        let (rows, k, n) = if cfg!(miri) { (3, 5, 18) } else { (67, 150, 100) };
        let x: Vec<f32> = (0..rows * k).map(value).collect();
        let weight: Vec<f32> = (0..n * k).map(|i| value(i + 3)).collect();
        for (format, unit) in [Format::F32, Format::Bf16, Format::Int8]
            .into_iter()
            .flat_map(|format| [(format, Unit::Vectors), (format, Unit::Matrix)])
            .filter(|pair| *pair != (Format::F32, Unit::Matrix))
        {
            let layer = Packed::for_unit(&weight, (0..n).map(value).collect(), format, unit);
            for (then, form) in [Then::Store, Then::Gelu]
                .into_iter()
                .flat_map(|then| [Form::Floats, Form::Halves, Form::Bytes].map(|form| (then, form)))
            {
                let [mut input, mut got, mut want] = std::array::from_fn(|_| Activations::default());
                let mut out = vec![0.0; rows * n];
                layer.forward(Rows::new(&x, k), &mut out, n, then, &mut Activations::default());
                want.set(Rows::new(&out, n), n, form);
                input.set(Rows::new(&x, k), k, layer.form());
                layer.apply_into(&input, &mut got, form, then);
                assert_eq!(restored(&got), restored(&want), "{format:?} {unit:?} {then:?} {form:?}");
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
        for then in [Then::Store, Then::Add, Then::Gelu] {
            let results = [Unit::Vectors, Unit::Matrix].map(|unit| {
                let layer = Packed::for_unit(&weight, bias.clone(), Format::Int8, unit);
                let mut out = vec![0.25; rows * n];
                layer.forward(Rows::new(&x, k), &mut out, n, then, &mut Activations::default());
                out
            });
            assert_eq!(results[0], results[1], "{then:?}");
        }
    }
}
