//! Blocks of a layer in the matrix unit.

use super::{PAIR, Packed, Place, Weights, fits};
use crate::activations::Input;
use crate::amx::{self, Block, Finish, HINTS, Kind, STEP, Scales, Sums};
use crate::tile::LANES;

impl Packed {
    /// Computes tiles in the matrix unit: writes their rows and columns of the result, and no other value. 8-bit layers have the bits
    /// of the vector instructions.
    pub(super) fn blocks(&self, x: Input, places: impl Iterator<Item = Place>) {
        let mut sums = Sums::new();
        for place in places {
            self.multiply(x, &place, &mut sums);
            self.finish(x, &place, &mut sums);
        }
        amx::release();
    }

    /// Multiplies the rows and the panel of a tile in the matrix unit.
    fn multiply(&self, x: Input, place: &Place, sums: &mut Sums) {
        let Place { row, rows, panel, .. } = *place;
        let (kind, a, lda, b, steps, next) = match (&self.weights, x) {
            (Weights::Pairs(weights), Input::Halves(halves, lda)) => {
                let padded = self.k.next_multiple_of(STEP / PAIR);
                let halves = &halves[row * lda..];
                assert!(fits(rows, lda, padded, halves.len()), "the halved rows leave their slice");
                let panel = panel.of(weights, padded);
                let steps = padded * PAIR / STEP;
                let next = place.ask(weights, padded, HINTS * steps);
                (Kind::Half, halves.as_ptr().cast(), lda * PAIR, panel.as_ptr().cast(), steps, next)
            }
            (Weights::Int8 { weights, .. }, Input::Bytes(bytes, lda, _)) => {
                let padded = self.k.next_multiple_of(STEP);
                let bytes = &bytes[row * lda..];
                assert!(fits(rows, lda, padded, bytes.len()), "the quantised rows leave their slice");
                let panel = panel.of(weights, padded);
                let steps = padded / STEP;
                let next = place.ask(weights, padded, HINTS * steps);
                (Kind::Byte, bytes.as_ptr(), lda, panel.as_ptr().cast(), steps, next)
            }
            _ => panic!("the rows have another form than the layer reads"),
        };
        let block = Block { a, lda, b, steps, out: sums.start(), ldc: amx::WIDTH, next };
        // SAFETY: the assertions cover the rows, and the slices the panel; a half has two bytes. `Unit::tiles` gives blocks of at
        // most `amx::ROWS` rows and `Unit::vectors` panels of at most `amx::VECTORS`, for which the sums have room.
        unsafe { amx::multiply(kind, &block, rows, panel.vectors) };
    }

    /// Writes the result of a tile from its sums.
    fn finish(&self, x: Input, place: &Place, sums: &mut Sums) {
        let Place { row, rows, panel, out, stride, then, .. } = *place;
        let scales = match (&self.weights, x) {
            (Weights::Int8 { scales, sums, .. }, Input::Bytes(_, _, of_rows)) => Some(Scales {
                rows: &of_rows[row..row + rows],
                columns: &vectors(scales)[panel.first..],
                weights: &vectors(sums)[panel.first..],
            }),
            _ => None,
        };
        let bias = &vectors(&self.bias)[panel.first..];
        let to = Finish { out, ldc: stride, rows, cols: self.cols(panel), then, bias, scales };
        // SAFETY: the result has these rows and columns, and no other task has this block.
        unsafe { amx::finish(sums, &to) };
    }
}

/// Returns values of the outputs by vectors; the padding completes the last.
fn vectors<T>(values: &[T]) -> &[[T; LANES]] {
    values.as_chunks().0
}
