//! The innermost product in 8 bits: unsigned activations times signed weights, summed in 32 bits.
//!
//! All forms give the same sums, bit by bit: integers don't round.

use super::tile::{LANES, VECTORS};

/// Activations that meet in one lane of one instruction.
pub const GROUP: usize = 4;

/// Sums of one tile: row by row, [`VECTORS`] x [`LANES`] columns each.
pub type Sums = [[i32; VECTORS * LANES]; super::tile::ROWS];

/// A tile's operands. `k` counts groups of four.
#[derive(Debug, Clone, Copy)]
pub struct Tile8 {
    /// First activation of the first row.
    pub a: *const u8,
    /// From one row of `a` to the next.
    pub lda: usize,
    /// The panel: for each group of four, for each column, its four weights.
    pub b: *const i8,
    /// Groups.
    pub k: usize,
}

/// Sums of `rows` rows and `vectors` vectors of columns; other places of `sums` keep what they hold.
///
/// # Safety
/// `rows` is 1 to 8, `vectors` 1 to 3; `rows` x 4 `k` activations and `k` x 64 `vectors` weights can be read.
#[allow(unsafe_code)]
pub unsafe fn compute(tile: &Tile8, rows: usize, vectors: usize, sums: &mut Sums) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx512vnni") && std::arch::is_x86_feature_detected!("avx512f") {
        macro_rules! table {
            ($($r:literal)*) => {
                match (rows, vectors) {
                    // SAFETY: the features are there; the rest is the caller's.
                    $(
                        ($r, 1) => unsafe { vnni::<$r, 1>(tile, sums) },
                        ($r, 2) => unsafe { vnni::<$r, 2>(tile, sums) },
                        ($r, 3) => unsafe { vnni::<$r, 3>(tile, sums) },
                    )*
                    _ => unreachable!("a tile of {rows} rows and {vectors} vectors"),
                }
            };
        }
        return table!(1 2 3 4 5 6 7 8);
    }
    // SAFETY: the caller's.
    unsafe { portable(tile, rows, vectors, sums) }
}

#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
#[target_feature(enable = "avx512f,avx512vnni")]
unsafe fn vnni<const R: usize, const V: usize>(tile: &Tile8, sums: &mut Sums) {
    use std::arch::x86_64::{
        _mm512_dpbusd_epi32, _mm512_loadu_si512, _mm512_set1_epi32, _mm512_setzero_si512, _mm512_storeu_si512,
    };
    let Tile8 { a, lda, b, k } = *tile;
    let mut total = [[_mm512_setzero_si512(); V]; R];
    for i in 0..k {
        let mut line = [_mm512_setzero_si512(); V];
        for (v, vector) in line.iter_mut().enumerate() {
            // SAFETY: inside the panel.
            *vector = unsafe { _mm512_loadu_si512(b.add((i * V + v) * LANES * GROUP).cast()) };
        }
        for (r, total) in total.iter_mut().enumerate() {
            // SAFETY: inside the row; the address need not be aligned.
            let four = _mm512_set1_epi32(unsafe { a.add(r * lda + i * GROUP).cast::<i32>().read_unaligned() });
            for (total, vector) in total.iter_mut().zip(line) {
                *total = _mm512_dpbusd_epi32(*total, four, vector);
            }
        }
    }
    for (sums, total) in sums.iter_mut().zip(total) {
        for (sums, total) in sums.as_chunks_mut::<LANES>().0.iter_mut().zip(total) {
            // SAFETY: sixteen places of 32 bits.
            unsafe { _mm512_storeu_si512(sums.as_mut_ptr().cast(), total) };
        }
    }
}

/// As [`compute`], in plain Rust.
#[allow(unsafe_code)]
unsafe fn portable(tile: &Tile8, rows: usize, vectors: usize, sums: &mut Sums) {
    let Tile8 { a, lda, b, k } = *tile;
    let width = vectors * LANES;
    // SAFETY: the caller's.
    let panel = unsafe { std::slice::from_raw_parts(b, k * width * GROUP) };
    for (r, sums) in sums.iter_mut().enumerate().take(rows) {
        // SAFETY: the caller's.
        let row = unsafe { std::slice::from_raw_parts(a.add(r * lda), k * GROUP) };
        super::super::ops::simd::dispatch(
            #[inline(always)]
            || {
                let sums = &mut sums[..width];
                sums.fill(0);
                for (four, line) in row.as_chunks::<GROUP>().0.iter().zip(panel.chunks_exact(width * GROUP)) {
                    for (sum, weights) in sums.iter_mut().zip(line.as_chunks::<GROUP>().0) {
                        for i in 0..GROUP {
                            *sum += i32::from(four[i]) * i32::from(weights[i]);
                        }
                    }
                }
            },
        );
    }
}

#[cfg(test)]
#[allow(unsafe_code)]
mod tests {
    use super::*;

    #[test]
    fn sums_are_exact_and_the_same_in_both_forms_for_every_size_and_the_largest_numbers() {
        for (rows, vectors, k) in [(1, 1, 1), (2, 2, 7), (5, 3, 12), (8, 3, 48), (8, 2, 5), (7, 1, 768)] {
            let width = vectors * LANES;
            let lda = GROUP * k + 3;
            for extreme in [false, true] {
                let byte = |i: usize| if extreme { 255 } else { (i * 7919 % 256) as u8 };
                let weight = |i: usize| if extreme { -127 } else { ((i * 104_729) % 255) as i32 as i8 };
                let a: Vec<u8> = (0..rows * lda).map(byte).collect();
                let b: Vec<i8> = (0..k * width * GROUP).map(|i| weight(i) as i8).collect();
                let tile = Tile8 { a: a.as_ptr(), lda, b: b.as_ptr(), k };
                let (mut first, mut second) = ([[7; VECTORS * LANES]; 8], [[7; VECTORS * LANES]; 8]);
                // SAFETY: the slices are as long as the tile says.
                unsafe {
                    compute(&tile, rows, vectors, &mut first);
                    portable(&tile, rows, vectors, &mut second);
                }
                for r in 0..rows {
                    for c in 0..width {
                        let product = |i: usize| {
                            let at = (i / GROUP * width + c) * GROUP + i % GROUP;
                            i64::from(a[r * lda + i]) * i64::from(b[at])
                        };
                        let want: i64 = (0..GROUP * k).map(product).sum();
                        assert_eq!((i64::from(first[r][c]), i64::from(second[r][c])), (want, want), "{rows} {vectors}");
                    }
                }
            }
        }
    }
}
