//! The innermost product in 8 bits: unsigned activations times signed weights, summed in 32 bits.
//!
//! All forms give the same result, bit by bit: integers don't round, and what follows rounds alike.

use super::tile::{LANES, VECTORS};

/// Activations that meet in one lane of one instruction.
pub const GROUP: usize = 4;

/// `out = scale x scale of the output x (product - zero point x sum of the weights) + bias (+ out)` for one tile.
///
/// `k` counts groups of four.
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
    /// Scale and zero point of each row of `a`.
    pub rows: *const (f32, i32),
    /// Scale of each column's weights.
    pub scales: *const f32,
    /// Sum of each column's weights.
    pub sums: *const i32,
    /// Bias of each column.
    pub bias: *const f32,
    /// First value of the first row of the result.
    pub out: *mut f32,
    /// From one row of the result to the next.
    pub ldc: usize,
    /// Columns that exist; the panel's others are padding.
    pub cols: usize,
    /// Whether to add to what is there.
    pub add: bool,
}

/// Computes a tile of `rows` rows and `vectors` vectors of columns.
///
/// # Safety
/// `rows` is 1 to 9, `vectors` 1 to 3, and everything the tile names can be read: `rows` x 4 `k` activations, `k` x 64
/// `vectors` weights, `rows` scales and zero points, `cols` scales, sums and biases; `rows` x `cols` of `out` can be
/// written, and nobody else uses them.
#[allow(unsafe_code)]
pub unsafe fn compute(tile: &Tile8, rows: usize, vectors: usize) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx512vnni") && std::arch::is_x86_feature_detected!("avx512f") {
        macro_rules! table {
            ($($r:literal)*) => {
                match (rows, vectors) {
                    // SAFETY: the features are there; the rest is the caller's.
                    $(
                        ($r, 1) => unsafe { vnni::<$r, 1>(tile) },
                        ($r, 2) => unsafe { vnni::<$r, 2>(tile) },
                        ($r, 3) => unsafe { vnni::<$r, 3>(tile) },
                    )*
                    _ => unreachable!("a tile of {rows} rows and {vectors} vectors"),
                }
            };
        }
        return table!(1 2 3 4 5 6 7 8 9);
    }
    // SAFETY: the caller's.
    unsafe { portable(tile, rows, vectors) }
}

#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
#[target_feature(enable = "avx512f,avx512vnni")]
unsafe fn vnni<const R: usize, const V: usize>(tile: &Tile8) {
    use std::arch::x86_64::{
        _mm512_add_ps, _mm512_cvtepi32_ps, _mm512_dpbusd_epi32, _mm512_fmadd_ps, _mm512_loadu_si512,
        _mm512_mask_storeu_ps, _mm512_maskz_loadu_epi32, _mm512_maskz_loadu_ps, _mm512_mul_ps, _mm512_mullo_epi32,
        _mm512_set1_epi32, _mm512_set1_ps, _mm512_setzero_si512, _mm512_sub_epi32,
    };
    let Tile8 { a, lda, b, k, rows, scales, sums, bias, out, ldc, cols, add } = *tile;
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
    for v in 0..V {
        let there = cols.saturating_sub(v * LANES).min(LANES);
        let mask = ((1u32 << there) - 1) as u16;
        // SAFETY: masked to the columns that exist.
        let (scales, sums, bias) = unsafe {
            (
                _mm512_maskz_loadu_ps(mask, scales.wrapping_add(v * LANES)),
                _mm512_maskz_loadu_epi32(mask, sums.wrapping_add(v * LANES)),
                _mm512_maskz_loadu_ps(mask, bias.wrapping_add(v * LANES)),
            )
        };
        for (r, total) in total.iter().enumerate() {
            // SAFETY: one of the rows.
            let (scale, zero) = unsafe { *rows.add(r) };
            let product = _mm512_sub_epi32(total[v], _mm512_mullo_epi32(_mm512_set1_epi32(zero), sums));
            let scale = _mm512_mul_ps(_mm512_set1_ps(scale), scales);
            let mut value = _mm512_fmadd_ps(_mm512_cvtepi32_ps(product), scale, bias);
            let at = out.wrapping_add(r * ldc + v * LANES);
            if add {
                // SAFETY: masked to the columns that exist.
                value = _mm512_add_ps(unsafe { _mm512_maskz_loadu_ps(mask, at) }, value);
            }
            // SAFETY: masked to the columns that exist.
            unsafe { _mm512_mask_storeu_ps(at, mask, value) };
        }
    }
}

/// As [`compute`], in plain Rust.
#[allow(unsafe_code)]
unsafe fn portable(tile: &Tile8, rows: usize, vectors: usize) {
    let Tile8 { a, lda, b, k, scales, sums, bias, out, ldc, cols, add, .. } = *tile;
    let width = vectors * LANES;
    // SAFETY: the caller's, for all of the blocks below.
    let panel = unsafe { std::slice::from_raw_parts(b, k * width * GROUP) };
    let (scales, sums, bias) = unsafe {
        (
            std::slice::from_raw_parts(scales, cols),
            std::slice::from_raw_parts(sums, cols),
            std::slice::from_raw_parts(bias, cols),
        )
    };
    for r in 0..rows {
        let row = unsafe { std::slice::from_raw_parts(a.add(r * lda), k * GROUP) };
        let (scale, zero) = unsafe { *tile.rows.add(r) };
        let out = unsafe { std::slice::from_raw_parts_mut(out.add(r * ldc), cols) };
        super::super::ops::simd::dispatch(
            #[inline(always)]
            || {
                let mut total = [0i32; VECTORS * LANES];
                for (four, line) in row.as_chunks::<GROUP>().0.iter().zip(panel.chunks_exact(width * GROUP)) {
                    for (total, weights) in total.iter_mut().zip(line.as_chunks::<GROUP>().0) {
                        for i in 0..GROUP {
                            *total += i32::from(four[i]) * i32::from(weights[i]);
                        }
                    }
                }
                let columns = scales.iter().zip(sums).zip(bias).zip(total);
                for (out, (((of_column, sum), bias), total)) in out.iter_mut().zip(columns) {
                    let value = ((total - zero * sum) as f32).mul_add(scale * of_column, *bias);
                    *out = if add { *out + value } else { value };
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
    fn both_forms_give_the_exact_product_for_every_size_and_the_largest_numbers() {
        for (rows, vectors, k, cols) in
            [(1, 1, 1, 16), (2, 2, 7, 20), (5, 3, 12, 33), (8, 3, 48, 48), (8, 2, 5, 32), (7, 1, 768, 9)]
        {
            let width = vectors * LANES;
            let (lda, ldc) = (GROUP * k + 3, cols + 1);
            for (extreme, add) in [(false, false), (true, true), (false, true)] {
                let a: Vec<u8> = (0..rows * lda).map(|i| if extreme { 255 } else { (i * 7919 % 256) as u8 }).collect();
                let weight = |i: usize| if extreme { -127 } else { (i * 104_729 % 255) as i16 - 127 };
                let b: Vec<i8> = (0..k * width * GROUP).map(|i| weight(i) as i8).collect();
                let of_rows: Vec<(f32, i32)> = (0..rows).map(|r| (0.5 + r as f32, 31 * r as i32)).collect();
                let scales: Vec<f32> = (0..cols).map(|c| 0.01 + 0.001 * c as f32).collect();
                let bias: Vec<f32> = (0..cols).map(|c| c as f32 - 7.0).collect();
                let at = |i: usize, c: usize| (i / GROUP * width + c) * GROUP + i % GROUP;
                let sums: Vec<i32> = (0..cols).map(|c| (0..GROUP * k).map(|i| i32::from(b[at(i, c)])).sum()).collect();
                let mut results = [vec![3.0f32; rows * ldc], vec![3.0; rows * ldc]];
                for (form, out) in results.iter_mut().enumerate() {
                    let tile = Tile8 {
                        a: a.as_ptr(),
                        lda,
                        b: b.as_ptr(),
                        k,
                        rows: of_rows.as_ptr(),
                        scales: scales.as_ptr(),
                        sums: sums.as_ptr(),
                        bias: bias.as_ptr(),
                        out: out.as_mut_ptr(),
                        ldc,
                        cols,
                        add,
                    };
                    // SAFETY: the slices are as long as the tile says.
                    unsafe { if form == 0 { compute(&tile, rows, vectors) } else { portable(&tile, rows, vectors) } }
                }
                assert_eq!(results[0], results[1], "{rows} {vectors} {k}");
                for (i, got) in results[0].iter().enumerate() {
                    let (r, c) = (i / ldc, i % ldc);
                    if c == cols {
                        assert_eq!(*got, 3.0, "wrote beyond the columns");
                        continue;
                    }
                    let centred = |i: usize| i64::from(a[r * lda + i]) - i64::from(of_rows[r].1);
                    let product: i64 = (0..GROUP * k).map(|i| centred(i) * i64::from(b[at(i, c)])).sum();
                    let want = product as f64 * f64::from(of_rows[r].0) * f64::from(scales[c])
                        + f64::from(bias[c])
                        + if add { 3.0 } else { 0.0 };
                    assert!((f64::from(*got) - want).abs() <= 1e-6 * want.abs().max(10.0), "{got} for {want}");
                }
            }
        }
    }
}
