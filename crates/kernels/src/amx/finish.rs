//! The step from the sums of a block to its result: scales, bias, what becomes of the value, and its form.

use super::{ROWS, Sums, VECTORS, WIDTH};
use crate::activations::Target;
use crate::packed::Then;
use crate::quantise::{bf16, halved_by_processor};
use crate::simd;
use crate::tile::LANES;

/// Place and terms of the result of a block.
#[derive(Debug, Clone, Copy)]
pub struct Finish<'a> {
    /// First value of the first row of the result. [`Then::Add`] adds to f32 alone.
    pub out: Target,
    /// Values from one row of the result to the next.
    pub ldc: usize,
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub cols: usize,
    /// Use of the values.
    pub then: Then,
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

/// Writes the result of a block; the sums are undefined then.
///
/// # Panics
/// If a slice has fewer rows or vectors than the result, or values are to be added to bf16.
///
/// # Safety
/// `rows` rows of `cols` values of `out` can be read and written, and no other thread uses them during the call.
pub unsafe fn finish(sums: &mut Sums, to: &Finish) {
    let vectors = to.cols.div_ceil(LANES);
    assert!(to.then != Then::Add || matches!(to.out, Target::Floats(_)), "values are added to f32 alone");
    assert!(to.rows <= ROWS && vectors <= VECTORS && to.bias.len() >= vectors, "a block has too many rows or columns");
    if let Some(scales) = to.scales {
        let Scales { rows, columns, weights } = scales;
        assert!(rows.len() >= to.rows && columns.len().min(weights.len()) >= vectors, "scales of a block are missing");
    }
    #[cfg(target_arch = "x86_64")]
    if halved_by_processor() {
        // SAFETY: the features were detected; the slices were checked above, and the result is as the caller guarantees.
        return unsafe { avx512::finish(sums, to) };
    }
    // SAFETY: as above.
    unsafe { portable(sums, to) }
}

/// Writes rows of a block, each times a factor of its own.
///
/// # Panics
/// If there are more rows or columns than a block has.
///
/// # Safety
/// A row of `cols` values of `out` for each factor, `ldc` values apart, can be written, and no other thread uses them during the
/// call.
pub unsafe fn scale(sums: &Sums, factors: &[f32], cols: usize, out: Target, ldc: usize) {
    assert!(factors.len() <= ROWS && cols <= VECTORS * LANES, "a block has too many rows or columns");
    for (r, factor) in factors.iter().enumerate() {
        for (v, sums) in sums.row(r).iter().enumerate().take(cols.div_ceil(LANES)) {
            let (there, out) = ((cols - v * LANES).min(LANES), out.at(r * ldc + v * LANES));
            #[cfg(target_arch = "x86_64")]
            if halved_by_processor() {
                // SAFETY: the features were detected; columns below `cols` of row r, which the caller guarantees and nothing else uses.
                unsafe { avx512::scale(sums, *factor, there, out) };
                continue;
            }
            // SAFETY: as above.
            unsafe { store(&sums.map(|sum| sum * factor), there, out, false) };
        }
    }
}

/// The steps in AVX-512.
#[cfg(target_arch = "x86_64")]
mod avx512 {
    use std::arch::x86_64::{
        __m512, _mm256_storeu_si256, _mm512_add_ps, _mm512_castps_si512, _mm512_cvtepi32_ps, _mm512_fmadd_ps,
        _mm512_loadu_ps, _mm512_loadu_si512, _mm512_mask_storeu_ps, _mm512_maskz_loadu_ps, _mm512_mul_ps,
        _mm512_mullo_epi32, _mm512_set1_epi32, _mm512_set1_ps, _mm512_setzero_ps, _mm512_storeu_ps, _mm512_sub_epi32,
    };

    use super::{Finish, Scales, Sums, Target, Then, WIDTH};
    use crate::quantise::avx512::halve;
    use crate::simd;
    use crate::tile::LANES;

    /// As [`super::finish`].
    ///
    /// # Safety
    /// As [`super::finish`], whose assertions hold; the processor has AVX-512 F and BF16.
    #[target_feature(enable = "avx512f,avx512bf16")]
    pub unsafe fn finish(sums: &mut Sums, to: &Finish) {
        let vectors = to.cols.div_ceil(LANES);
        let in_place = to.then == Then::Gelu || to.scales.is_some();
        if in_place {
            for v in 0..vectors {
                weigh(sums, to, v);
            }
        }
        if to.then == Then::Gelu {
            // One long loop, in which the processor works on several vectors at once.
            for value in &mut sums.0[..to.rows * WIDTH] {
                *value = simd::gelu(*value);
            }
        }
        for v in 0..vectors {
            let bias = if in_place { _mm512_setzero_ps() } else { load(&to.bias[v]) };
            let (there, out) = ((to.cols - v * LANES).min(LANES), to.out.at(v * LANES));
            let rows = sums.rows().iter().take(to.rows).enumerate();
            for (r, row) in rows {
                // SAFETY: columns below `cols` of row r, which the caller guarantees and nothing else uses.
                unsafe {
                    store(_mm512_add_ps(load(&row[v]), bias), there, out.at(r * to.ldc), to.then == Then::Add);
                }
            }
        }
    }

    /// Replaces the sums of vector `v` of all rows by their values, bias included.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn weigh(sums: &mut Sums, to: &Finish, v: usize) {
        let bias = load(&to.bias[v]);
        let rows = sums.rows_mut().iter_mut().take(to.rows);
        match to.scales {
            None => {
                for row in rows {
                    let value = _mm512_add_ps(load(&row[v]), bias);
                    save(&mut row[v], value);
                }
            }
            Some(Scales { rows: of_rows, columns, weights }) => {
                // SAFETY: a load of 16 values, which needs no alignment.
                let weights = unsafe { _mm512_loadu_si512(weights[v].as_ptr().cast()) };
                let columns = load(&columns[v]);
                for (row, (scale, zero)) in rows.zip(of_rows) {
                    let shift = _mm512_mullo_epi32(_mm512_set1_epi32(*zero), weights);
                    let product = _mm512_cvtepi32_ps(_mm512_sub_epi32(_mm512_castps_si512(load(&row[v])), shift));
                    let scale = _mm512_mul_ps(_mm512_set1_ps(*scale), columns);
                    save(&mut row[v], _mm512_fmadd_ps(product, scale, bias));
                }
            }
        }
    }

    #[inline]
    #[target_feature(enable = "avx512f")]
    fn load(values: &[f32; LANES]) -> __m512 {
        // SAFETY: 16 values; the load needs no alignment.
        unsafe { _mm512_loadu_ps(values.as_ptr()) }
    }

    #[inline]
    #[target_feature(enable = "avx512f")]
    fn save(values: &mut [f32; LANES], vector: __m512) {
        // SAFETY: 16 values; the store needs no alignment.
        unsafe { _mm512_storeu_ps(values.as_mut_ptr(), vector) };
    }

    /// Writes sums times a factor.
    ///
    /// # Safety
    /// `there` values, at most 16, can be written at `out`, and no other thread uses them; the processor has AVX-512 F and BF16.
    #[target_feature(enable = "avx512f,avx512bf16")]
    pub unsafe fn scale(sums: &[f32; LANES], factor: f32, there: usize, out: Target) {
        let value = _mm512_mul_ps(load(sums), _mm512_set1_ps(factor));
        // SAFETY: as the caller guarantees.
        unsafe { store(value, there, out, false) };
    }

    /// Writes the first `there` lanes, or adds them to f32.
    ///
    /// # Safety
    /// `there` values, at most 16, can be read and written, and no other thread uses them; the processor has AVX-512 F and BF16.
    #[inline]
    #[target_feature(enable = "avx512f,avx512bf16")]
    unsafe fn store(value: __m512, there: usize, out: Target, add: bool) {
        match out {
            Target::Floats(out) => {
                let mask = ((1u32 << there) - 1) as u16;
                // SAFETY: the mask admits the lanes that the caller guarantees.
                unsafe {
                    let value = if add { _mm512_add_ps(_mm512_maskz_loadu_ps(mask, out), value) } else { value };
                    _mm512_mask_storeu_ps(out, mask, value);
                }
            }
            // SAFETY: 16 values, as the caller guarantees; the store needs no alignment.
            Target::Halves(out) if there == LANES => unsafe { _mm256_storeu_si256(out.cast(), halve(value)) },
            Target::Halves(out) => {
                let mut lanes = [0u16; LANES];
                // SAFETY: the array has room for 16 values; the caller guarantees `there` of them at `out`, which are not those of
                // the array.
                unsafe {
                    _mm256_storeu_si256(lanes.as_mut_ptr().cast(), halve(value));
                    std::ptr::copy_nonoverlapping(lanes.as_ptr(), out, there);
                }
            }
        }
    }
}

/// As [`finish`], in plain Rust.
///
/// # Safety
/// As [`finish`], whose assertions hold.
unsafe fn portable(sums: &mut Sums, to: &Finish) {
    for r in 0..to.rows {
        for (v, sums) in sums.row(r).iter().enumerate().take(to.cols.div_ceil(LANES)) {
            let there = (to.cols - v * LANES).min(LANES);
            let mut values = [0.0; LANES];
            for (i, value) in values.iter_mut().enumerate() {
                *value = match to.scales {
                    None => sums[i] + to.bias[v][i],
                    Some(Scales { rows, columns, weights }) => {
                        let (scale, zero) = rows[r];
                        let product = (sums[i].to_bits().cast_signed() - zero * weights[v][i]) as f32;
                        product.mul_add(scale * columns[v][i], to.bias[v][i])
                    }
                };
                if to.then == Then::Gelu {
                    *value = simd::gelu(*value);
                }
            }
            // SAFETY: columns below `cols` of row r, which the caller guarantees and nothing else uses.
            unsafe { store(&values, there, to.out.at(r * to.ldc + v * LANES), to.then == Then::Add) };
        }
    }
}

/// Writes the first `there` values, or adds them to f32.
///
/// # Safety
/// `there` values can be read and written, and no other thread uses them during the call.
unsafe fn store(values: &[f32; LANES], there: usize, out: Target, add: bool) {
    match out {
        Target::Floats(out) => {
            // SAFETY: as the caller guarantees.
            let out = unsafe { std::slice::from_raw_parts_mut(out, there) };
            out.iter_mut().zip(values).for_each(|(out, value)| *out = if add { *out + value } else { *value });
        }
        Target::Halves(out) => {
            // SAFETY: as the caller guarantees.
            let out = unsafe { std::slice::from_raw_parts_mut(out, there) };
            out.iter_mut().zip(values).for_each(|(out, value)| *out = bf16(*value));
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
            let all =
                [Then::Store, Then::Add, Then::Gelu].into_iter().flat_map(|then| [(then, None), (then, Some(scales))]);
            for (then, scales) in all {
                let ldc = cols + 3;
                let results = [finish, portable].map(|form| {
                    let mut out: Vec<f32> = (0..rows * ldc).map(value).collect();
                    let to =
                        Finish { out: Target::Floats(out.as_mut_ptr()), ldc, rows, cols, then, bias: &bias, scales };
                    // SAFETY: `out` has the rows and columns, and this thread alone uses it.
                    unsafe { form(&mut sums.clone(), &to) };
                    out
                });
                assert_eq!(results[0], results[1], "{rows} {cols} {then:?}");
                if then != Then::Add {
                    let mut halves = vec![7u16; rows * ldc];
                    let out = Target::Halves(halves.as_mut_ptr());
                    let to = Finish { out, ldc, rows, cols, then, bias: &bias, scales };
                    // SAFETY: `halves` has the rows and columns, and this thread alone uses it.
                    unsafe { finish(&mut sums.clone(), &to) };
                    for (i, half) in halves.into_iter().enumerate() {
                        let want = if i % ldc < cols { bf16(results[0][i]) } else { 7 };
                        // The instruction takes subnormal numbers for zero.
                        let zero = results[0][i].is_subnormal() && half == 0;
                        assert!(half == want || zero, "bf16 of the same value: {half} for {want}");
                    }
                }
                for (r, c) in (0..rows).flat_map(|r| (cols..ldc).map(move |c| (r, c))) {
                    assert_eq!(results[0][r * ldc + c], value(r * ldc + c), "wrote beyond the columns");
                }
                let before = if then == Then::Add { value(0) } else { 0.0 };
                let sum = f64::from(sums.row(0)[0][0].to_bits());
                let want = match scales {
                    None => f64::from(sums.row(0)[0][0]) + f64::from(bias[0][0]),
                    Some(_) => sum * f64::from(value(0)) * f64::from(bias[0][0]) + f64::from(bias[0][0]),
                };
                let want = match then {
                    Then::Gelu => want * f64::from(simd::normal(want as f32)[0]),
                    Then::Store | Then::Add => want + f64::from(before),
                };
                assert!((f64::from(results[0][0]) - want).abs() < 1e-4, "{rows} {cols} {then:?}");
            }
        }
    }
}
