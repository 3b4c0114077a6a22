//! The innermost product in 8 bits: unsigned activations times signed weights, summed in 32 bits.
//!
//! All forms give the same bits: integer sums are exact, and the conversion to f32 takes the same steps.

use crate::simd;
use crate::tile::{LANES, Next, PERIOD, VECTORS};

/// Activations that one lane of `vpdpbusd` multiplies and adds at once.
pub const GROUP: usize = 4;

/// `out = row scale x column scale x (product - zero point x sum of the weights) + bias (+ out)` for one tile.
///
/// The sum of the weights is computed once per layer, so the zero point costs one multiplication per output.
#[derive(Debug, Clone, Copy)]
pub struct Tile8 {
    /// First activation of the first row.
    pub a: *const u8,
    /// Bytes from one row of `a` to the next.
    pub lda: usize,
    /// The panel: for each group of four inputs, for each column, its four weights.
    pub b: *const i8,
    /// Groups of four inputs.
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
    /// Values from one row of the result to the next.
    pub ldc: usize,
    /// Columns of the result; the panel is padded to whole vectors.
    pub cols: usize,
    /// True to add to the result instead of replacing it.
    pub add: bool,
    /// Asked for while the tile is computed, a cache line every [`PERIOD`] groups of the panel.
    pub next: Next,
}

/// Computes a tile of `rows` rows and `vectors` vectors of columns.
///
/// # Panics
/// If the tile is larger than those that [`tile::count`](crate::tile::count) and [`tile::widest`](crate::tile::widest) give on a
/// processor with AVX-512.
///
/// # Safety
/// - `rows` is 1 to [`MOST_ROWS`](crate::tile::MOST_ROWS), `vectors` 1 to 3, `cols` at most 16 `vectors`;
/// - `rows` rows of 4 `k` activations can be read from `a`, `k` x 64 `vectors` weights from `b`, `rows` scales and zero
///   points from `rows`, `cols` values each from `scales`, `sums` and `bias`;
/// - `rows` rows of `cols` values of `out` can be read and written, and no other thread uses them during the call.
pub unsafe fn compute(tile: &Tile8, rows: usize, vectors: usize) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx512vnni") && std::arch::is_x86_feature_detected!("avx512f") {
        macro_rules! table {
            ($($r:literal)*) => {
                match (rows, vectors) {
                    $(
                        ($r, 1) => vnni::<$r, 1>,
                        ($r, 2) => vnni::<$r, 2>,
                        ($r, 3) => vnni::<$r, 3>,
                    )*
                    _ => unreachable!("a tile of {rows} rows and {vectors} vectors"),
                }
            };
        }
        let form: unsafe fn(&Tile8) = table!(1 2 3 4 5 6 7 8 9);
        // SAFETY: both features were detected above, and `form` is the one for `rows` and `vectors`; sizes and pointers are
        // as the caller guarantees.
        return unsafe { form(tile) };
    }
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        // SAFETY: AVX2 and FMA were detected above; sizes and pointers are as the caller guarantees.
        return unsafe { by_avx2(tile, rows, vectors) };
    }
    // SAFETY: sizes and pointers are as the caller guarantees.
    unsafe { portable(tile, rows, vectors) }
}

/// The tile in AVX2, in pieces of up to four rows and eight columns, whose sums stay in registers.
///
/// # Safety
/// As [`compute`]; the processor has AVX2 and FMA.
#[cfg(target_arch = "x86_64")]
unsafe fn by_avx2(tile: &Tile8, rows: usize, vectors: usize) {
    // The columns of a half stay in the L1 cache while all rows pass.
    for half in 0..2 * vectors {
        for row in (0..rows).step_by(4) {
            let form: unsafe fn(&Tile8, usize, usize, usize) = match rows - row {
                1 => avx2::<1>,
                2 => avx2::<2>,
                3 => avx2::<3>,
                _ => avx2::<4>,
            };
            // SAFETY: `form` has at most `rows - row` rows, and `half` lies in the panel; the rest is as the caller guarantees.
            unsafe { form(tile, row, half, 2 * vectors) };
        }
    }
}

/// Computes rows `row` to `row + R` of the columns 8 `half` to 8 `half` + 8; the panel has `halves` of them.
///
/// Products are summed in pairs of 16 bits into 32 bits: 255 x 127 twice is far below the limit, so sums are exact.
///
/// # Safety
/// As [`compute`], for a tile of at least `row + R` rows and `halves` / 2 vectors, with `half` below `halves`; the processor has AVX2
/// and FMA.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn avx2<const R: usize>(tile: &Tile8, row: usize, half: usize, halves: usize) {
    use std::arch::x86_64::{
        _mm_loadu_si128, _mm_set1_epi32, _mm256_add_epi32, _mm256_cvtepi8_epi16, _mm256_cvtepu8_epi16,
        _mm256_hadd_epi32, _mm256_madd_epi16, _mm256_permutevar8x32_epi32, _mm256_setr_epi32, _mm256_setzero_si256,
        _mm256_storeu_si256,
    };
    const HALF: usize = LANES / 2;
    let Tile8 { a, lda, b, k, scales, sums, bias, out, ldc, cols, add, .. } = *tile;
    // Sums of pairs: of columns 0 to 3, and of 4 to 7.
    let mut pairs = [[_mm256_setzero_si256(); 2]; R];
    for i in 0..k {
        // SAFETY: group i < k of the panel, half `half` < `halves`: 32 bytes inside of those that the caller guarantees.
        let [low, high] = unsafe {
            let at = b.add((i * halves + half) * HALF * GROUP);
            [_mm_loadu_si128(at.cast()), _mm_loadu_si128(at.add(16).cast())]
        };
        let weights = [_mm256_cvtepi8_epi16(low), _mm256_cvtepi8_epi16(high)];
        for (r, pairs) in pairs.iter_mut().enumerate() {
            // SAFETY: group i < k of row + r, a row of the tile, four bytes; the read needs no alignment.
            let four = unsafe { a.add((row + r) * lda + i * GROUP).cast::<i32>().read_unaligned() };
            let four = _mm256_cvtepu8_epi16(_mm_set1_epi32(four));
            for (pairs, weights) in pairs.iter_mut().zip(weights) {
                *pairs = _mm256_add_epi32(*pairs, _mm256_madd_epi16(weights, four));
            }
        }
    }
    let start = half * HALF;
    let there = cols.saturating_sub(start).min(HALF);
    for (r, [low, high]) in pairs.into_iter().enumerate() {
        // Adding neighbours gives the columns 0 1 4 5 2 3 6 7.
        let ordered =
            _mm256_permutevar8x32_epi32(_mm256_hadd_epi32(low, high), _mm256_setr_epi32(0, 1, 4, 5, 2, 3, 6, 7));
        let mut totals = [0i32; HALF];
        // SAFETY: the array has 8 values; the store needs no alignment.
        unsafe { _mm256_storeu_si256(totals.as_mut_ptr().cast(), ordered) };
        // SAFETY: the caller guarantees a scale and zero point for each row of the tile.
        let (scale, zero) = unsafe { *tile.rows.add(row + r) };
        for (c, total) in (start..start + there).zip(totals) {
            // SAFETY: column c < `cols`, of which the caller guarantees all four, in a row of the tile; nothing else uses `out`.
            unsafe {
                let product = (total - zero * *sums.add(c)) as f32;
                let value = product.mul_add(scale * *scales.add(c), *bias.add(c));
                let at = out.add((row + r) * ldc + c);
                *at = if add { *at + value } else { value };
            }
        }
    }
}

/// The tile in AVX-512 VNNI.
///
/// # Safety
/// As [`compute`] with `R` rows and `V` vectors; the processor has AVX-512 F and VNNI.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512vnni")]
unsafe fn vnni<const R: usize, const V: usize>(tile: &Tile8) {
    use std::arch::x86_64::{
        _mm512_add_ps, _mm512_cvtepi32_ps, _mm512_dpbusd_epi32, _mm512_fmadd_ps, _mm512_loadu_si512,
        _mm512_mask_storeu_ps, _mm512_maskz_loadu_epi32, _mm512_maskz_loadu_ps, _mm512_mul_ps, _mm512_mullo_epi32,
        _mm512_set1_epi32, _mm512_set1_ps, _mm512_setzero_si512, _mm512_sub_epi32,
    };
    let Tile8 { a, lda, b, k, rows, scales, sums, bias, out, ldc, cols, add, next } = *tile;
    let mut total = [[_mm512_setzero_si512(); V]; R];
    for i in 0..k {
        if i % PERIOD == 0 {
            next.hint(i / PERIOD);
        }
        let mut line = [_mm512_setzero_si512(); V];
        for (v, vector) in line.iter_mut().enumerate() {
            // SAFETY: group i < k of the panel, vector v < V: inside the bytes that the caller guarantees.
            *vector = unsafe { _mm512_loadu_si512(b.add((i * V + v) * LANES * GROUP).cast()) };
        }
        for (r, total) in total.iter_mut().enumerate() {
            // SAFETY: group i < k of row r < R, four bytes that the caller guarantees; the read needs no alignment.
            let four = _mm512_set1_epi32(unsafe { a.add(r * lda + i * GROUP).cast::<i32>().read_unaligned() });
            for (total, vector) in total.iter_mut().zip(line) {
                *total = _mm512_dpbusd_epi32(*total, four, vector);
            }
        }
    }
    for v in 0..V {
        let there = cols.saturating_sub(v * LANES).min(LANES);
        let mask = ((1u32 << there) - 1) as u16;
        // SAFETY: the mask admits only columns below `cols`, which the caller guarantees of all three.
        let (scales, sums, bias) = unsafe {
            (
                _mm512_maskz_loadu_ps(mask, scales.wrapping_add(v * LANES)),
                _mm512_maskz_loadu_epi32(mask, sums.wrapping_add(v * LANES)),
                _mm512_maskz_loadu_ps(mask, bias.wrapping_add(v * LANES)),
            )
        };
        for (r, total) in total.iter().enumerate() {
            // SAFETY: the caller guarantees a scale and zero point for each row r < R.
            let (scale, zero) = unsafe { *rows.add(r) };
            let product = _mm512_sub_epi32(total[v], _mm512_mullo_epi32(_mm512_set1_epi32(zero), sums));
            let scale = _mm512_mul_ps(_mm512_set1_ps(scale), scales);
            let mut value = _mm512_fmadd_ps(_mm512_cvtepi32_ps(product), scale, bias);
            let at = out.wrapping_add(r * ldc + v * LANES);
            if add {
                // SAFETY: the mask admits only columns below `cols` of row r, which the caller guarantees of `out`.
                value = _mm512_add_ps(unsafe { _mm512_maskz_loadu_ps(mask, at) }, value);
            }
            // SAFETY: as for the load from `out`; nothing else uses these values, as the caller guarantees.
            unsafe { _mm512_mask_storeu_ps(at, mask, value) };
        }
    }
}

/// As [`compute`], in plain Rust.
///
/// # Safety
/// As [`compute`].
unsafe fn portable(tile: &Tile8, rows: usize, vectors: usize) {
    let Tile8 { a, lda, b, k, scales, sums, bias, out, ldc, cols, add, .. } = *tile;
    let width = vectors * LANES;
    // SAFETY: the caller guarantees a panel of k x 64 `vectors` weights, which nobody changes during the call.
    let panel = unsafe { std::slice::from_raw_parts(b, k * width * GROUP) };
    // SAFETY: the caller guarantees `cols` scales, sums and biases, which nobody changes during the call.
    let (scales, sums, bias) = unsafe {
        (
            std::slice::from_raw_parts(scales, cols),
            std::slice::from_raw_parts(sums, cols),
            std::slice::from_raw_parts(bias, cols),
        )
    };
    for r in 0..rows {
        // SAFETY: the caller guarantees 4 k activations in row r < `rows` of `a`.
        let row = unsafe { std::slice::from_raw_parts(a.add(r * lda), k * GROUP) };
        // SAFETY: the caller guarantees a scale and zero point for each row r < `rows`.
        let (scale, zero) = unsafe { *tile.rows.add(r) };
        // SAFETY: the caller guarantees `cols` values in row r < `rows` of `out`, which nothing else uses. The slice ends with
        // this turn of the loop, so no two slices of `out` exist together.
        let out = unsafe { std::slice::from_raw_parts_mut(out.add(r * ldc), cols) };
        simd::dispatch(
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
mod tests {
    use super::*;

    #[test]
    fn all_forms_give_the_exact_product_for_every_size_and_the_largest_numbers() {
        // Miri is slow: short products.
        let sizes: &[_] = match cfg!(miri) {
            true => &[(1, 1, 1, 16), (2, 2, 3, 20), (5, 3, 2, 33), (8, 3, 2, 48)],
            false => &[(1, 1, 1, 16), (2, 2, 7, 20), (5, 3, 12, 33), (8, 3, 48, 48), (8, 2, 5, 32), (7, 1, 768, 9)],
        };
        for &(rows, vectors, k, cols) in sizes {
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
                // The form of this processor, plain Rust, and AVX2 where it is, which another form may hide.
                let mut results = [vec![3.0f32; rows * ldc], vec![3.0; rows * ldc], vec![3.0; rows * ldc]];
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
                        next: Next::NONE,
                    };
                    // SAFETY: the slices have the sizes that the tile states, and this thread alone uses `out`.
                    unsafe {
                        match form {
                            0 => compute(&tile, rows, vectors),
                            #[cfg(target_arch = "x86_64")]
                            2 if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") => {
                                by_avx2(&tile, rows, vectors);
                            }
                            _ => portable(&tile, rows, vectors),
                        }
                    }
                }
                assert_eq!(results[0], results[1], "{rows} {vectors} {k}");
                assert_eq!(results[2], results[1], "AVX2: {rows} {vectors} {k}");
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
