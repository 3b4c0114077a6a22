//! The step from the sums of a block to its result: scales, bias, and the sum with what is there.

use super::{ROWS, Sums, VECTORS};
use crate::tile::LANES;

/// Place and terms of the result of a block.
#[derive(Debug, Clone, Copy)]
pub struct Finish<'a> {
    /// First value of the first row of the result.
    pub out: *mut f32,
    /// Values from one row of the result to the next.
    pub ldc: usize,
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub cols: usize,
    /// True to add to the result instead of replacing it.
    pub add: bool,
    /// Bias of each column, by vectors.
    pub bias: &'a [[f32; LANES]],
    /// Scales of sums of bytes.
    pub scales: Option<Scales<'a>>,
}

/// Scales of sums of bytes: `value = row scale x column scale x (sum - zero point x sum of the weights)`.
#[derive(Debug, Clone, Copy)]
pub struct Scales<'a> {
    /// Scale and zero point of each row.
    pub rows: &'a [(f32, i32)],
    /// Scale of each column's weights, by vectors.
    pub columns: &'a [[f32; LANES]],
    /// Sum of each column's weights, by vectors.
    pub weights: &'a [[i32; LANES]],
}

/// Writes the result of a block.
///
/// # Panics
/// If a slice has fewer rows or vectors than the result.
///
/// # Safety
/// `rows` rows of `cols` values of `out` can be read and written, and no other thread uses them during the call.
pub unsafe fn finish(sums: &Sums, to: &Finish) {
    let vectors = to.cols.div_ceil(LANES);
    assert!(to.rows <= ROWS && vectors <= VECTORS && to.bias.len() >= vectors, "a block has too many rows or columns");
    if let Some(scales) = to.scales {
        let Scales { rows, columns, weights } = scales;
        assert!(rows.len() >= to.rows && columns.len().min(weights.len()) >= vectors, "scales of a block are missing");
    }
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx512f") {
        // SAFETY: AVX-512 F was detected; the slices were checked above, and the result is as the caller guarantees.
        return unsafe { avx512(sums, to) };
    }
    // SAFETY: as above.
    unsafe { portable(sums, to) }
}

/// As [`finish`], in AVX-512.
///
/// # Safety
/// As [`finish`], whose assertions hold; the processor has AVX-512 F.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
unsafe fn avx512(sums: &Sums, to: &Finish) {
    use std::arch::x86_64::{
        _mm512_add_ps, _mm512_castps_si512, _mm512_cvtepi32_ps, _mm512_fmadd_ps, _mm512_loadu_ps, _mm512_loadu_si512,
        _mm512_mask_storeu_ps, _mm512_maskz_loadu_ps, _mm512_mul_ps, _mm512_mullo_epi32, _mm512_set1_epi32,
        _mm512_set1_ps, _mm512_sub_epi32,
    };
    for r in 0..to.rows {
        for (v, sums) in sums.row(r).iter().enumerate().take(to.cols.div_ceil(LANES)) {
            let there = (to.cols - v * LANES).min(LANES);
            let mask = ((1u32 << there) - 1) as u16;
            let at = to.out.wrapping_add(r * to.ldc + v * LANES);
            // SAFETY: loads from arrays of 16 values; none needs alignment.
            let mut value = unsafe {
                let (sum, bias) = (_mm512_loadu_ps(sums.as_ptr()), _mm512_loadu_ps(to.bias[v].as_ptr()));
                match to.scales {
                    None => _mm512_add_ps(sum, bias),
                    Some(Scales { rows, columns, weights }) => {
                        let (scale, zero) = rows[r];
                        let weights = _mm512_loadu_si512(weights[v].as_ptr().cast());
                        let shift = _mm512_mullo_epi32(_mm512_set1_epi32(zero), weights);
                        let product = _mm512_cvtepi32_ps(_mm512_sub_epi32(_mm512_castps_si512(sum), shift));
                        let scale = _mm512_mul_ps(_mm512_set1_ps(scale), _mm512_loadu_ps(columns[v].as_ptr()));
                        _mm512_fmadd_ps(product, scale, bias)
                    }
                }
            };
            // SAFETY: the mask admits only columns below `cols` of row r, which the caller guarantees and nothing else uses.
            unsafe {
                if to.add {
                    value = _mm512_add_ps(_mm512_maskz_loadu_ps(mask, at), value);
                }
                _mm512_mask_storeu_ps(at, mask, value);
            }
        }
    }
}

/// As [`finish`], in plain Rust.
///
/// # Safety
/// As [`finish`], whose assertions hold.
unsafe fn portable(sums: &Sums, to: &Finish) {
    for r in 0..to.rows {
        // SAFETY: the caller guarantees `cols` values in row r < `rows`, which nothing else uses. The slice ends with this turn
        // of the loop, so no two slices of the result exist together.
        let out = unsafe { std::slice::from_raw_parts_mut(to.out.add(r * to.ldc), to.cols) };
        for (c, (out, sum)) in out.iter_mut().zip(sums.row(r).as_flattened()).enumerate() {
            let (v, i) = (c / LANES, c % LANES);
            let value = match to.scales {
                None => sum + to.bias[v][i],
                Some(Scales { rows, columns, weights }) => {
                    let (scale, zero) = rows[r];
                    let product = (sum.to_bits().cast_signed() - zero * weights[v][i]) as f32;
                    product.mul_add(scale * columns[v][i], to.bias[v][i])
                }
            };
            *out = if to.add { *out + value } else { value };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_have_the_same_bits_and_write_their_columns_alone() {
        let mut sums = Sums::new();
        sums.0.iter_mut().enumerate().for_each(|(i, sum)| *sum = f32::from_bits((i as u32 * 7919) % 100_000));
        let value = |i: usize| (i * 31 % 17) as f32 * 0.25 - 2.0;
        let bias: [[f32; LANES]; 2] = std::array::from_fn(|v| std::array::from_fn(|i| value(v * LANES + i)));
        let weights = bias.map(|vector| vector.map(|value| (value * 40.0) as i32));
        let rows: Vec<(f32, i32)> = (0..ROWS).map(|r| (value(r), r as i32)).collect();
        let scales = Scales { rows: &rows, columns: &bias, weights: &weights };
        for (rows, cols) in [(1, 1), (3, 16), (7, 17), (32, 32)] {
            for (add, scales) in [(false, None), (true, None), (false, Some(scales)), (true, Some(scales))] {
                let ldc = cols + 3;
                let results = [finish, portable].map(|form| {
                    let mut out: Vec<f32> = (0..rows * ldc).map(value).collect();
                    let to = Finish { out: out.as_mut_ptr(), ldc, rows, cols, add, bias: &bias, scales };
                    // SAFETY: `out` has the rows and columns, and this thread alone uses it.
                    unsafe { form(&sums, &to) };
                    out
                });
                assert_eq!(results[0], results[1], "{rows} {cols} {add}");
                for (r, c) in (0..rows).flat_map(|r| (cols..ldc).map(move |c| (r, c))) {
                    assert_eq!(results[0][r * ldc + c], value(r * ldc + c), "wrote beyond the columns");
                }
                let before = if add { value(0) } else { 0.0 };
                let sum = f64::from(sums.row(0)[0][0].to_bits());
                let want = match scales {
                    None => f64::from(sums.row(0)[0][0]) + f64::from(bias[0][0]),
                    Some(_) => sum * f64::from(value(0)) * f64::from(bias[0][0]) + f64::from(bias[0][0]),
                };
                assert!((f64::from(results[0][0]) - want - f64::from(before)).abs() < 1e-4, "{rows} {cols} {add}");
            }
        }
    }
}
