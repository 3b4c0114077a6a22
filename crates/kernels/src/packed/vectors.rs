//! Tiles of a layer by vector instructions.

use super::{Packed, Place, Then, Weights, fits};
use crate::activations::{Input, Target};
use crate::amx::STEP;
use crate::rows::Rows;
use crate::simd;
use crate::tile::{self, LANES, PERIOD, Tile, Weight};
use crate::tile8::{self, GROUP, Tile8};

/// Parts of [`Weights::Int8`].
struct Int8<'a> {
    weights: &'a [i8],
    scales: &'a [f32],
    sums: &'a [i32],
}

impl Place {
    /// First value of the tile in a result of f32: the vector instructions write no other.
    fn floats(&self) -> *mut f32 {
        match self.out {
            Target::Floats(out) => out,
            Target::Halves(_) => unreachable!("`apply_into` asks vector instructions for f32"),
        }
    }
}

impl Packed {
    /// Computes one tile by vector instructions: writes its rows and columns of the result, and no other value.
    pub(super) fn tile(&self, x: Input, place: &Place) {
        match (&self.weights, x) {
            (Weights::F32(weights), Input::Floats(x)) => self.float_tile(x, place, weights),
            (Weights::Bf16(weights), Input::Floats(x)) => self.float_tile(x, place, weights),
            (Weights::Int8 { weights, scales, sums }, Input::Bytes(bytes, lda, rows)) => {
                self.int8_tile((bytes, lda, rows), place, &Int8 { weights, scales, sums });
            }
            _ => panic!("the rows have another form than the layer reads"),
        }
        if place.then == Then::Gelu {
            let cols = self.cols(place.panel);
            for r in 0..place.rows {
                // SAFETY: row `row + r` of the result has this panel's `cols` columns, and no other task has this tile. One
                // row's slice exists at a time, so none spans the values between rows.
                gelu(unsafe { std::slice::from_raw_parts_mut(place.floats().wrapping_add(r * place.stride), cols) });
            }
        }
    }

    fn float_tile<E: Weight>(&self, x: Rows, place: &Place, weights: &[E]) {
        let Place { row, rows, panel, stride, then, .. } = *place;
        let (out, add) = (place.floats(), then == Then::Add);
        let (k, first, cols) = (self.k, panel.start(), self.cols(panel));
        let a = &x.data[row * x.stride..(row + rows - 1) * x.stride + k];
        let b = panel.of(weights, k);
        let bias = self.bias[first..first + cols].as_ptr();
        let next = place.ask(weights, k, k.div_ceil(PERIOD));
        let tile = Tile { a: a.as_ptr(), lda: x.stride, b: b.as_ptr(), k, bias, out, ldc: stride, cols, add, next };
        // SAFETY: the slices `a`, `b` and the bias hold what the tile reads. The result has these rows and columns, and each tile
        // and panel occur in one task only.
        unsafe { tile::compute(&tile, rows, panel.vectors) };
    }

    fn int8_tile(&self, (bytes, lda, of_rows): (&[u8], usize, &[(f32, i32)]), place: &Place, of: &Int8) {
        let Place { row, rows, panel, stride, then, .. } = *place;
        let (out, add) = (place.floats(), then == Then::Add);
        let (first, cols) = (panel.start(), self.cols(panel));
        let padded = self.k.next_multiple_of(STEP);
        let (bytes, of_rows) = (&bytes[row * lda..], &of_rows[row..row + rows]);
        assert!(fits(rows, lda, padded, bytes.len()), "the quantised rows leave their slice");
        let groups = self.k.div_ceil(GROUP);
        let tile = Tile8 {
            a: bytes.as_ptr(),
            lda,
            b: panel.of(of.weights, padded).as_ptr(),
            k: groups,
            rows: of_rows.as_ptr(),
            scales: of.scales[first..first + cols].as_ptr(),
            sums: of.sums[first..first + cols].as_ptr(),
            bias: self.bias[first..first + cols].as_ptr(),
            out,
            ldc: stride,
            cols,
            add,
            next: place.ask(of.weights, padded, groups.div_ceil(PERIOD)),
        };
        // SAFETY: the assertion and the slices above cover what the tile reads; `of_rows` has `rows` entries. The result has these
        // rows and columns, and no other task has this tile.
        unsafe { tile8::compute(&tile, rows, panel.vectors) };
    }
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
