//! Self-attention of one sequence, for inference.
//!
//! Keys and values are packed into panels per head, as the weights of a layer are; queries are read where they lie. A task
//! computes the scores of a few queries, their exponentials and the weighted sum of the values while the scores are in its
//! own cache. The division by the sum of exponentials comes last, on the few outputs instead of the many weights.
//!
//! Where fewer bits are wanted and the processor has a matrix unit, both products have operands in bf16 and sums in f32.

mod lines;
mod pairs;

use std::cell::RefCell;

use crate::activations::{Activations, Form, Input, Target};
use crate::aligned::Aligned;
use crate::packed::{Format, Unit};
use crate::rows::Rows;
use crate::simd;
use crate::team;
use crate::tile::LANES;

use lines::Lines;
use pairs::Pairs;

thread_local! {
    /// Buffers of the queries that this thread works on, kept so that a task allocates nothing.
    static SCRATCH: RefCell<Scratch> = RefCell::new(Scratch::default());
}

/// Multi-head self-attention with buffers for the keys and values of one sequence.
#[derive(Debug, Clone)]
pub struct Attention {
    shape: Shape,
    operands: Operands,
}

/// Sizes of a sequence.
#[derive(Debug, Clone, Copy)]
struct Shape {
    /// Tokens.
    n: usize,
    heads: usize,
    /// Channels of a head.
    size: usize,
}

/// Packed keys and values.
#[derive(Debug, Clone)]
enum Operands {
    /// For vector instructions.
    Lines(Lines),
    /// For the matrix unit.
    Pairs(Pairs),
}

/// Intermediate results of a few queries.
#[derive(Debug, Default)]
struct Scratch {
    scores: Aligned<f32>,
    /// Queries, then weights of the values, in bf16.
    halves: Aligned<u16>,
}

impl Shape {
    /// Channels of a token.
    fn d(self) -> usize {
        self.heads * self.size
    }

    /// Tokens, padded to whole vectors.
    fn wide_n(self) -> usize {
        self.n.next_multiple_of(LANES)
    }

    /// Channels of a head, padded to whole vectors.
    fn wide_size(self) -> usize {
        self.size.next_multiple_of(LANES)
    }

    /// Factor of the scores: 1 / √size.
    fn scale(self) -> f32 {
        1.0 / (self.size as f32).sqrt()
    }
}

impl Attention {
    /// Creates buffers for sequences of `n` tokens of width `d`. A format other than [`Format::F32`] permits operands in bf16.
    pub fn new(n: usize, d: usize, heads: usize, format: Format) -> Self {
        Self::for_unit(n, d, heads, Unit::of(format))
    }

    fn for_unit(n: usize, d: usize, heads: usize, unit: Unit) -> Self {
        let shape = Shape { n, heads, size: d / heads };
        let operands = match unit {
            Unit::Vectors => Operands::Lines(Lines::new(shape)),
            Unit::Matrix => Operands::Pairs(Pairs::new(shape)),
        };
        Self { shape, operands }
    }

    /// Form in which it reads queries, keys and values.
    pub fn form(&self) -> Form {
        match self.operands {
            Operands::Lines(_) => Form::Floats,
            Operands::Pairs(_) => Form::Halves,
        }
    }

    /// Computes softmax(q kᵀ / √size) v for each head.
    ///
    /// `qkv`: `(n, 3 d)`, queries, keys and values side by side. `out`: `(n, d)`. `buffer` holds the input in fewer bits.
    ///
    /// # Panics
    /// If a slice is shorter.
    pub fn forward(&mut self, qkv: &[f32], out: &mut [f32], buffer: &mut Activations) {
        let (n, d) = (self.shape.n, self.shape.d());
        assert!(qkv.len() >= 3 * d * n && out.len() >= d * n, "attention of {n} tokens leaves its slices");
        let rows = Rows { data: qkv, stride: 3 * d, count: n };
        let input = match self.form() {
            Form::Floats => Input::Floats(rows),
            form => {
                buffer.set(rows, 3 * d, form);
                buffer.rows()
            }
        };
        self.run(input, Target::Floats(out.as_mut_ptr()), d);
    }

    /// As [`Self::forward`], from rows in the [`Self::form`] of this step into rows of the form in which a layer reads them. They are
    /// those of [`Self::forward`], converted.
    ///
    /// # Panics
    /// If the rows have another form, number or width.
    pub fn apply_into(&mut self, qkv: &Activations, out: &mut Activations, form: Form) {
        let (n, d) = (self.shape.n, self.shape.d());
        assert_eq!((qkv.count(), qkv.width()), (n, 3 * d), "attention needs the rows that it was made for");
        out.receive(form, n, d, self.form() == Form::Halves, |target, stride| self.run(qkv.rows(), target, stride));
    }

    /// Attends with all queries; `out` must have room for n rows of d values, `stride` values apart.
    fn run(&mut self, qkv: Input, out: Target, stride: usize) {
        let shape = self.shape;
        match (&mut self.operands, qkv) {
            (Operands::Lines(lines), Input::Floats(qkv)) => {
                lines.pack(shape, qkv);
                let tasks = lines::tasks(shape);
                team::run(shape.heads * tasks, |index| {
                    SCRATCH.with_borrow_mut(|scratch| {
                        lines.attend(shape, qkv, (index / tasks, index % tasks), scratch, (out, stride));
                    });
                });
            }
            (Operands::Pairs(pairs), Input::Halves(qkv, lda)) => {
                pairs.pack(shape, (qkv, lda));
                let tasks = pairs::tasks(shape);
                team::run(shape.heads * tasks, |index| {
                    SCRATCH.with_borrow_mut(|scratch| {
                        pairs.attend(shape, (qkv, lda), (index / tasks, index % tasks), scratch, (out, stride));
                    });
                });
            }
            _ => panic!("the rows have another form than attention reads"),
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
    use crate::activations::tests::restored;

    #[test]
    fn attention_of_any_size_agrees_with_its_definition_in_f64() {
        let value = |i: usize| (i * 7919 % 1013) as f32 / 250.0 - 2.0;
        let sizes = [(1, 1, 8), (7, 2, 12), (20, 3, 16), (50, 2, 33), (45, 2, 32)];
        for &(n, heads, size) in &sizes[..if cfg!(miri) { 2 } else { sizes.len() }] {
            let d = heads * size;
            let qkv: Vec<f32> = (0..n * 3 * d).map(value).collect();
            let [mut out, mut halved] = [Unit::Vectors, Unit::Matrix].map(|unit| {
                let mut out = vec![0.0; n * d + 1];
                let mut attention = Attention::for_unit(n, d, heads, unit);
                attention.forward(&qkv, &mut out, &mut Activations::default());
                for form in [Form::Floats, Form::Halves, Form::Bytes] {
                    let [mut input, mut got, mut want] = std::array::from_fn(|_| Activations::default());
                    input.set(Rows::new(&qkv, 3 * d), 3 * d, attention.form());
                    attention.apply_into(&input, &mut got, form);
                    want.set(Rows::new(&out[..n * d], d), d, form);
                    assert_eq!(restored(&got), restored(&want), "{unit:?} {form:?}");
                }
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
