//! The innermost product in the matrix unit of recent Intel processors (AMX), in 16 and in 8 bits.
//!
//! A register of the unit, a *tile*, holds up to 16 rows of 64 bytes. One instruction multiplies a tile of activations by a
//! tile of weights and adds the products to a tile of 16 x 16 sums. A *word* is the four bytes that one sum consumes at once:
//! two numbers in 16 bits, or four in 8 bits. A block of up to 32 rows and 32 columns has four tiles of sums, two of
//! activations and two of weights: all eight that there are.
//!
//! Panels have the layout of the vector instructions for the same words: for each word of the inputs, one line with that
//! word of each column. Sixteen such lines are a tile, so processors with and without the unit share the layout.

mod finish;
#[cfg(all(target_arch = "x86_64", target_os = "linux", not(miri)))]
mod unit;

pub use finish::{Finish, Scales, finish, scale};

use crate::tile::{LANES, Next};

/// Rows of a tile.
const TILE_ROWS: usize = 16;
/// Rows of the largest block: two tiles.
pub const ROWS: usize = 2 * TILE_ROWS;
/// Vectors of columns in the widest panel: two tiles.
pub const VECTORS: usize = 2;
/// Bytes of a row of a tile. Inputs are padded to a multiple with zeros.
pub const STEP: usize = 64;
/// Bytes of a word.
pub const WORD: usize = 4;
/// Cache lines that each step of a block asks for in [`Block::next`].
pub const HINTS: usize = 4;
/// Sums in a row of [`Sums`].
pub const WIDTH: usize = VECTORS * LANES;

/// Number format of a product.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// bf16 times bf16, summed in f32.
    Half,
    /// Unsigned times signed bytes, summed in i32.
    Byte,
}

/// Operands and result of a block.
#[derive(Debug, Clone, Copy)]
pub struct Block {
    /// First byte of the first row of activations.
    pub a: *const u8,
    /// Bytes from one row of activations to the next.
    pub lda: usize,
    /// First byte of the panel of weights.
    pub b: *const u8,
    /// Steps of 64 bytes of activations: 16 lines of the panel each.
    pub steps: usize,
    /// First value of the first row of the result: f32 for [`Kind::Half`], the bits of an i32 for [`Kind::Byte`].
    pub out: *mut f32,
    /// Values from one row of the result to the next.
    pub ldc: usize,
    /// Asked for while the block is computed, [`HINTS`] cache lines in each step.
    pub next: Next,
}

/// Room for the result of a block, in rows of [`WIDTH`].
#[derive(Debug, Clone)]
#[repr(C, align(64))]
pub struct Sums([f32; ROWS * WIDTH]);

impl Sums {
    /// Creates sums that are zero.
    pub const fn new() -> Self {
        Self([0.0; ROWS * WIDTH])
    }

    /// First value, for [`Block::out`] with a [`Block::ldc`] of [`WIDTH`].
    pub fn start(&mut self) -> *mut f32 {
        self.0.as_mut_ptr()
    }

    /// Returns the sums of all rows by vectors.
    #[inline(always)]
    fn rows(&self) -> &[[[f32; LANES]; VECTORS]] {
        self.0.as_chunks().0.as_chunks().0
    }

    /// As [`Self::rows`], to be changed.
    #[inline(always)]
    fn rows_mut(&mut self) -> &mut [[[f32; LANES]; VECTORS]] {
        self.0.as_chunks_mut().0.as_chunks_mut().0
    }

    /// Returns the sums of a row by vectors.
    #[inline(always)]
    pub fn row(&self, row: usize) -> &[[f32; LANES]; VECTORS] {
        &self.rows()[row]
    }
}

/// True if this processor has the unit, and the system lets this process use it.
///
/// The first call asks Linux for the permission, which holds for all threads of the process.
pub fn available() -> bool {
    #[cfg(all(target_arch = "x86_64", target_os = "linux", not(miri)))]
    {
        static AVAILABLE: std::sync::LazyLock<bool> = std::sync::LazyLock::new(unit::permitted);
        *AVAILABLE
    }
    #[cfg(not(all(target_arch = "x86_64", target_os = "linux", not(miri))))]
    false
}

/// Number of blocks that `rows` rows are split into by [`crate::rows::part`].
pub fn count(rows: usize) -> usize {
    rows.div_ceil(ROWS)
}

/// Multiplies `rows` rows of activations by a panel of `vectors` vectors of columns, in the unit if it is [`available`].
///
/// # Safety
/// - `rows` is 1 to [`ROWS`], `vectors` 1 to [`VECTORS`], `block.steps` at least 1;
/// - 64 `steps` bytes can be read from each of `rows` rows at `a`, `lda` bytes apart;
/// - 16 `steps` lines of 64 `vectors` bytes can be read from `b`;
/// - `rows` rows of 16 `vectors` values can be written at `out`, `ldc` values apart, and no other thread uses them during the
///   call.
pub unsafe fn multiply(kind: Kind, block: &Block, rows: usize, vectors: usize) {
    #[cfg(all(target_arch = "x86_64", target_os = "linux", not(miri)))]
    if available() {
        // SAFETY: the unit is there and permitted; sizes and pointers are as the caller guarantees.
        return unsafe { unit::multiply(kind, block, rows, vectors) };
    }
    // SAFETY: sizes and pointers are as the caller guarantees.
    unsafe { portable(kind, block, rows, vectors) }
}

/// To be called by a thread after its last [`multiply`] for some time.
pub fn release() {
    #[cfg(all(target_arch = "x86_64", target_os = "linux", not(miri)))]
    unit::release();
}

/// As [`multiply`], in plain Rust: what the instructions do, word by word. It checks the layout on processors without the
/// unit.
///
/// # Safety
/// As [`multiply`].
unsafe fn portable(kind: Kind, block: &Block, rows: usize, vectors: usize) {
    let Block { a, lda, b, steps, out, ldc, .. } = *block;
    let words = steps * STEP / WORD;
    // SAFETY: the caller guarantees 16 lines of 64 `vectors` bytes for each step, which nobody changes during the call.
    let panel = unsafe { std::slice::from_raw_parts(b, words * vectors * STEP) };
    for r in 0..rows {
        // SAFETY: the caller guarantees 64 `steps` bytes in each of the rows.
        let row = unsafe { std::slice::from_raw_parts(a.add(r * lda), steps * STEP) };
        // SAFETY: the caller guarantees 16 `vectors` values in each of the rows, which nothing else uses. The slice ends with
        // this turn of the loop, so no two slices of `out` exist together.
        let out = unsafe { std::slice::from_raw_parts_mut(out.add(r * ldc), vectors * LANES) };
        out.fill(0.0);
        for (x, line) in row.as_chunks::<WORD>().0.iter().zip(panel.chunks_exact(vectors * STEP)) {
            for (sum, w) in out.iter_mut().zip(line.as_chunks::<WORD>().0) {
                *sum = match kind {
                    Kind::Byte => {
                        let product = |i: usize| i32::from(x[i]) * i32::from(w[i].cast_signed());
                        let total = sum.to_bits().cast_signed().wrapping_add((0..WORD).map(product).sum());
                        f32::from_bits(total.cast_unsigned())
                    }
                    Kind::Half => {
                        let value = |word: &[u8; WORD], i: usize| {
                            f32::from_bits(u32::from_le_bytes([0, 0, word[i], word[i + 1]]))
                        };
                        value(x, 2).mul_add(value(w, 2), value(x, 0).mul_add(value(w, 0), *sum))
                    }
                };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::aligned::Aligned;

    /// Activations and weights of any bits, as numbers of a format.
    fn operand(kind: Kind, len: usize, seed: usize) -> Aligned<u8> {
        let mut bytes = Aligned::zeros(len);
        for (i, pair) in bytes.as_chunks_mut::<2>().0.iter_mut().enumerate() {
            let number = (i + seed) * 7919 % 1013;
            *pair = match kind {
                Kind::Byte => [(number % 256) as u8, (number * 31 % 256) as u8],
                Kind::Half => half::bf16::from_f32(number as f32 / 1013.0 - 0.5).to_bits().to_le_bytes(),
            };
        }
        bytes
    }

    /// The definition in f64: the sum of `row` times `column`. Each line of the panel holds one word of `column`.
    fn expected(kind: Kind, row: &[u8], panel: &[u8], vectors: usize, column: usize) -> f64 {
        let lines = panel.chunks_exact(vectors * STEP).map(|line| &line[column * WORD..(column + 1) * WORD]);
        let half = |bytes: &[u8], i: usize| f64::from(half::bf16::from_le_bytes([bytes[2 * i], bytes[2 * i + 1]]));
        let words = row.chunks_exact(WORD).zip(lines);
        words
            .map(|(x, w)| match kind {
                Kind::Byte => (0..4).map(|i| f64::from(x[i]) * f64::from(w[i].cast_signed())).sum::<f64>(),
                Kind::Half => (0..2).map(|i| half(x, i) * half(w, i)).sum(),
            })
            .sum()
    }

    #[test]
    fn both_forms_give_the_product_in_f64_for_every_number_of_tiles() {
        let sizes: &[_] = match cfg!(miri) {
            true => &[(1, 1, 1), (18, 2, 1)],
            false => &[(1, 1, 1), (3, 2, 5), (16, 1, 2), (17, 2, 3), (31, 1, 12), (32, 2, 48)],
        };
        for (kind, &(rows, vectors, steps)) in
            [Kind::Half, Kind::Byte].into_iter().flat_map(|kind| sizes.iter().map(move |size| (kind, size)))
        {
            let lda = (steps + 1) * STEP;
            let (a, b) = (operand(kind, rows * lda, 3), operand(kind, steps * TILE_ROWS * vectors * STEP, 5));
            for form in [multiply, portable] {
                let mut sums = Sums::new();
                let next = Next::share(&b, HINTS * steps, 0);
                let block = Block { a: a.as_ptr(), lda, b: b.as_ptr(), steps, out: sums.start(), ldc: WIDTH, next };
                // SAFETY: the arrays have the sizes that the block states.
                unsafe { form(kind, &block, rows, vectors) };
                for (r, c) in (0..rows).flat_map(|r| (0..vectors * LANES).map(move |c| (r, c))) {
                    let sum = sums.row(r)[c / LANES][c % LANES];
                    let want = expected(kind, &a[r * lda..][..steps * STEP], &b, vectors, c);
                    match kind {
                        Kind::Byte => {
                            assert_eq!(f64::from(sum.to_bits().cast_signed()), want, "{rows} {vectors} ({r}, {c})")
                        }
                        Kind::Half => {
                            let error = (f64::from(sum) - want).abs();
                            assert!(error < 1e-6 * (steps * STEP) as f64, "{rows} {vectors} ({r}, {c}): {error}");
                        }
                    }
                }
            }
        }
    }
}
