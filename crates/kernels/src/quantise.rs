//! Conversion from f32 to 8 or 16 bits: weights once, activations row by row.

use crate::simd;

/// Magnitude below which values count as zero, since the inverse of their scale would not be finite.
const SMALLEST: f32 = 1e-30;
/// 1.5 · 2²³. Adding it to a number below 2²² rounds that number to an integer, ties to even, and leaves the integer
/// in the low bits of the mantissa.
const ROUNDING: f32 = 12_582_912.0;

/// Converts weights `(n, k)` to integers in -127..=127. Returns them with one scale per output.
///
/// An output whose weights are all below 1e-30 becomes zero, with scale 0.
pub fn quantise_weights(weight: &[f32], n: usize) -> (Vec<i8>, Vec<f32>) {
    let k = weight.len() / n.max(1);
    let mut bytes = Vec::with_capacity(weight.len());
    let mut scales = Vec::with_capacity(n);
    for row in weight.chunks_exact(k.max(1)) {
        let largest = row.iter().fold(0.0f32, |largest, w| largest.max(w.abs()));
        let scale = if largest > SMALLEST { largest / 127.0 } else { 0.0 };
        let inverse = if scale > 0.0 { 1.0 / scale } else { 0.0 };
        bytes.extend(row.iter().map(|w| (w * inverse).round_ties_even().clamp(-127.0, 127.0) as i8));
        scales.push(scale);
    }
    (bytes, scales)
}

/// Rounds a row to bf16, ties to even. NaN stays NaN. Some processors take subnormal numbers for zero.
///
/// # Panics
/// If there is no room.
pub(crate) fn halve_row(row: &[f32], halves: &mut [u16]) {
    assert!(halves.len() >= row.len(), "a row leaves its place");
    #[cfg(target_arch = "x86_64")]
    if halved_by_processor() {
        // SAFETY: the features were detected.
        return unsafe { avx512::halve_row(row, halves) };
    }
    simd::dispatch(
        #[inline(always)]
        || {
            for (half, value) in halves.iter_mut().zip(row) {
                *half = bf16(*value);
            }
        },
    );
}

/// True if the processor has an instruction that rounds to bf16.
#[cfg(target_arch = "x86_64")]
pub(crate) fn halved_by_processor() -> bool {
    !cfg!(miri) && std::arch::is_x86_feature_detected!("avx512f") && std::arch::is_x86_feature_detected!("avx512bf16")
}

/// Rounds to the nearest bf16, ties to even. NaN stays NaN. Without branches, so that loops over it are vectorised.
#[inline(always)]
pub(crate) fn bf16(value: f32) -> u16 {
    let bits = value.to_bits();
    let rounded = bits.wrapping_add(0x7fff + ((bits >> 16) & 1)) >> 16;
    if value.is_nan() { 0x7fc0 } else { rounded as u16 }
}

/// Converts one row. Returns scale and zero point. A value that is not finite makes the scale NaN, so that it shows in every product
/// of the row.
///
/// # Panics
/// If there is no room.
pub(crate) fn quantise_row(row: &[f32], bytes: &mut [u8]) -> (f32, i32) {
    assert!(bytes.len() >= row.len(), "a row leaves its place");
    #[cfg(target_arch = "x86_64")]
    if !cfg!(miri) && std::arch::is_x86_feature_detected!("avx512f") {
        // SAFETY: AVX-512 F was detected.
        return unsafe { avx512::quantise_row(row, bytes) };
    }
    plain_quantise_row(row, bytes)
}

/// As [`quantise_row`], for all processors.
fn plain_quantise_row(row: &[f32], bytes: &mut [u8]) -> (f32, i32) {
    simd::dispatch(
        #[inline(always)]
        || {
            let (low, high) = extremes(row);
            let Some((scale, inverse, zero)) = step(low, high) else {
                bytes[..row.len()].fill(0);
                return (if (low + high).is_nan() { f32::NAN } else { 0.0 }, 0);
            };
            for (byte, value) in bytes.iter_mut().zip(row) {
                let shifted = value.mul_add(inverse, zero).clamp(0.0, 255.0) + ROUNDING;
                *byte = shifted.to_bits() as u8;
            }
            (scale, zero as i32)
        },
    )
}

/// Returns scale, its inverse and the zero point of a row between two values; None if the scale is NaN or too small.
#[inline(always)]
fn step(low: f32, high: f32) -> Option<(f32, f32, f32)> {
    // Divided before the subtraction: the difference itself may overflow.
    let scale = (high / 255.0) - (low / 255.0);
    if scale.is_nan() || scale <= SMALLEST {
        return None;
    }
    let inverse = 1.0 / scale;
    Some((scale, inverse, (-low * inverse).round_ties_even()))
}

/// Both conversions in AVX-512.
#[cfg(target_arch = "x86_64")]
pub(crate) mod avx512 {
    use std::arch::x86_64::{
        __m256i, __m512, _mm_storeu_si128, _mm256_storeu_si256, _mm512_cvtneps_pbh, _mm512_cvtps_epi32,
        _mm512_cvtusepi32_epi8, _mm512_fmadd_ps, _mm512_loadu_ps, _mm512_max_epi32, _mm512_max_ps, _mm512_min_ps,
        _mm512_reduce_add_ps, _mm512_reduce_max_ps, _mm512_reduce_min_ps, _mm512_set1_ps, _mm512_setzero_ps,
        _mm512_setzero_si512,
    };

    use super::step;
    use crate::simd::LANES;

    /// Rounds to bf16, ties to even; subnormal numbers become zero.
    #[inline]
    #[target_feature(enable = "avx512f,avx512bf16")]
    pub fn halve(value: __m512) -> __m256i {
        // SAFETY: both are 32 bytes of any bits.
        unsafe { std::mem::transmute(_mm512_cvtneps_pbh(value)) }
    }

    /// As [`super::halve_row`]; the slices have equal lengths, or there is more room.
    #[target_feature(enable = "avx512f,avx512bf16")]
    pub fn halve_row(row: &[f32], halves: &mut [u16]) {
        let (vectors, rest) = row.as_chunks::<LANES>();
        let (places, room) = halves[..row.len()].as_chunks_mut::<LANES>();
        for (vector, place) in vectors.iter().zip(places) {
            // SAFETY: a load and a store of 16 values, which need no alignment.
            unsafe { _mm256_storeu_si256(place.as_mut_ptr().cast(), halve(_mm512_loadu_ps(vector.as_ptr()))) };
        }
        let mut last = [0.0; LANES];
        last[..rest.len()].copy_from_slice(rest);
        let mut place = [0; LANES];
        // SAFETY: as above.
        unsafe { _mm256_storeu_si256(place.as_mut_ptr().cast(), halve(_mm512_loadu_ps(last.as_ptr()))) };
        room.copy_from_slice(&place[..rest.len()]);
    }

    /// As [`super::quantise_row`], with the same bits.
    #[target_feature(enable = "avx512f")]
    pub fn quantise_row(row: &[f32], bytes: &mut [u8]) -> (f32, i32) {
        let (vectors, rest) = row.as_chunks::<LANES>();
        let (places, room) = bytes[..row.len()].as_chunks_mut::<LANES>();
        let mut last = [0.0; LANES];
        last[..rest.len()].copy_from_slice(rest);
        let zeros = _mm512_setzero_ps();
        let (mut low, mut high, mut broken) = (zeros, zeros, zeros);
        for vector in vectors.iter().chain([&last]) {
            // SAFETY: a load of 16 values, which needs no alignment.
            let values = unsafe { _mm512_loadu_ps(vector.as_ptr()) };
            (low, high) = (_mm512_min_ps(values, low), _mm512_max_ps(values, high));
            // Stays zero unless a value is not finite: zero times such a value is NaN.
            broken = _mm512_fmadd_ps(values, zeros, broken);
        }
        let broken = _mm512_reduce_add_ps(broken);
        let (low, high) = (_mm512_reduce_min_ps(low) + broken, _mm512_reduce_max_ps(high) + broken);
        let Some((scale, inverse, zero)) = step(low, high) else {
            bytes[..row.len()].fill(0);
            return (if broken.is_nan() { f32::NAN } else { 0.0 }, 0);
        };
        let (inverses, zero_points) = (_mm512_set1_ps(inverse), _mm512_set1_ps(zero));
        let convert = |vector: &[f32; LANES], place: &mut [u8; LANES]| {
            // SAFETY: a load and a store of 16 values, which need no alignment.
            unsafe {
                let shifted = _mm512_fmadd_ps(_mm512_loadu_ps(vector.as_ptr()), inverses, zero_points);
                let rounded = _mm512_max_epi32(_mm512_cvtps_epi32(shifted), _mm512_setzero_si512());
                _mm_storeu_si128(place.as_mut_ptr().cast(), _mm512_cvtusepi32_epi8(rounded));
            }
        };
        for (vector, place) in vectors.iter().zip(places) {
            convert(vector, place);
        }
        let mut place = [0; LANES];
        convert(&last, &mut place);
        room.copy_from_slice(&place[..rest.len()]);
        (scale, zero as i32)
    }
}

/// Returns the smallest and the largest value, zero included; NaN twice if a value is not finite.
#[inline(always)]
fn extremes(row: &[f32]) -> (f32, f32) {
    const LANES: usize = simd::LANES;
    let (chunks, rest) = row.as_chunks::<LANES>();
    let (mut low, mut high, mut sum) = ([0.0f32; LANES], [0.0f32; LANES], [0.0f32; LANES]);
    // Three loops: the compiler vectorises each of them, but not one loop that does all three.
    for chunk in chunks {
        for (low, value) in low.iter_mut().zip(chunk) {
            *low = if *value < *low { *value } else { *low };
        }
        for (high, value) in high.iter_mut().zip(chunk) {
            *high = if *value > *high { *value } else { *high };
        }
        for (sum, value) in sum.iter_mut().zip(chunk) {
            *sum += 0.0 * value;
        }
    }
    let mut broken: f32 = sum.iter().sum();
    for value in rest {
        low[0] = if *value < low[0] { *value } else { low[0] };
        high[0] = if *value > high[0] { *value } else { high[0] };
        broken += 0.0 * value;
    }
    let low = low.iter().fold(0.0f32, |a, b| a.min(*b));
    let high = high.iter().fold(0.0f32, |a, b| a.max(*b));
    // `broken` is zero unless a value is not finite: zero times such a value is NaN.
    (low + broken, high + broken)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Length of a row: no multiple of a vector's; shorter in miri, which is slow.
    const LENGTH: usize = if cfg!(miri) { 21 } else { 103 };

    fn restored(row: &[f32]) -> Vec<f32> {
        let mut bytes = vec![0; row.len()];
        let (scale, zero) = quantise_row(row, &mut bytes);
        bytes.iter().map(|byte| scale * (i32::from(*byte) - zero) as f32).collect()
    }

    #[test]
    fn a_row_is_restored_to_within_half_a_step() {
        for (low, high) in [(-1.0f32, 1.0), (0.0, 3.0), (-0.17, 900.0), (-5.0, -1.0), (-1e-6, 2e-6), (-1e30, 3e38)] {
            let row: Vec<f32> = (0..LENGTH).map(|i| low + (high - low) * (i as f32 * 0.37).sin().abs()).collect();
            let step = (high.max(0.0) / 255.0) - (low.min(0.0) / 255.0);
            for (value, back) in row.iter().zip(restored(&row)) {
                assert!((value - back).abs() <= 0.501 * step * 1.01 + 0.5 * step, "{low} {high}: {back} for {value}");
            }
        }
        assert_eq!(restored(&[0.0; 7]), [0.0; 7]);
        assert_eq!(restored(&[3.0, 0.0, -2.0])[1], 0.0, "zero is exact");
    }

    #[test]
    fn both_forms_of_a_row_in_bytes_have_the_same_bits() {
        for (length, low, high) in [(1, -1.0f32, 2.0f32), (16, 0.0, 3.0), (LENGTH, -0.17, 900.0), (40, -1e30, 3e38)] {
            let mut row: Vec<f32> = (0..length).map(|i| low + (high - low) * (i as f32 * 0.37).sin().abs()).collect();
            for bad in [0.0, f32::NAN, f32::INFINITY, 1e-35] {
                row[length / 2] = if bad == 0.0 { row[length / 2] } else { bad };
                let (mut bytes, mut plain) = (vec![7; length + 3], vec![7; length + 3]);
                let (scale, zero) = quantise_row(&row, &mut bytes);
                let (want, want_zero) = plain_quantise_row(&row, &mut plain);
                assert_eq!((scale.to_bits(), zero, bytes), (want.to_bits(), want_zero, plain), "{length} {bad}");
            }
        }
    }

    #[test]
    fn bf16_rounds_as_a_library_does() {
        let some = (0..if cfg!(miri) { 100 } else { 100_000u32 }).map(|i| i.wrapping_mul(2_654_435_761));
        for bits in
            some.chain([0x7f80_0000, 0xff80_0000, 0x7f80_0001, 0x7fff_ffff, 0xffff_ffff, 0x0000_8000, 0x7f7f_ffff])
        {
            let value = f32::from_bits(bits);
            let (got, want) = (half::bf16::from_bits(bf16(value)), half::bf16::from_f32(value));
            assert!(got == want || got.is_nan() && want.is_nan(), "{value}: {got} for {want}");
            let mut of_row = [0];
            halve_row(&[value], &mut of_row);
            let of_row = half::bf16::from_bits(of_row[0]);
            let zero = value.is_subnormal() && of_row == half::bf16::ZERO;
            assert!(
                of_row == want || of_row.is_nan() && want.is_nan() || zero,
                "{value}: {of_row} for {want} in a row"
            );
        }
    }

    #[test]
    fn a_value_that_is_not_finite_makes_the_whole_row_nan() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            for at in [0, 16, 20] {
                let mut row = vec![1.0; 21];
                row[at] = bad;
                assert!(restored(&row).iter().all(|value| value.is_nan()), "{bad} at {at}");
            }
        }
    }

    #[test]
    fn subnormal_and_zero_weights_become_zero() {
        let (bytes, scales) = quantise_weights(&[1e-40, -1e-42, 0.0, 0.0, 1.0, -0.5], 3);
        assert_eq!((bytes, scales[0], scales[1]), (vec![0, 0, 0, 0, 127, -64], 0.0, 0.0));
    }
}
