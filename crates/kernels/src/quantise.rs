//! Conversion from f32 to 8 or 16 bits: weights once, activations row by row.

use crate::aligned::{Aligned, grow};
use crate::amx::STEP;
use crate::rows::Rows;
use crate::simd;
use crate::team;

/// Rows that one task converts: enough work to be worth handing over, few enough that 257 tokens make several tasks.
const ROWS_PER_TASK: usize = 32;
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

/// Rows of activations in 8 bits, or in 16.
///
/// In 8 bits: value = scale x (integer - zero point), scale and zero point per row. Zero is exact. The rounding is the same
/// on every processor. In 16 bits: bf16.
#[derive(Debug, Clone, Default)]
pub struct Quantised {
    bytes: Aligned<u8>,
    scales: Vec<(f32, i32)>,
    halves: Aligned<u16>,
    stride: usize,
}

impl Quantised {
    /// Converts rows of `k` values to 8 bits. The buffers grow to the largest input so far and are kept.
    pub fn set(&mut self, x: Rows, k: usize) {
        let (stride, count) = (k.next_multiple_of(STEP), x.count);
        self.stride = stride;
        grow(&mut self.bytes, count * stride);
        if self.scales.len() < count {
            self.scales.resize(count, (0.0, 0));
        }
        let bytes = (&mut self.bytes[..count * stride], ROWS_PER_TASK * stride);
        team::chunks2(bytes, (&mut self.scales[..count], ROWS_PER_TASK), |block, bytes, scales| {
            for (i, (bytes, scale)) in bytes.chunks_exact_mut(stride).zip(scales).enumerate() {
                let first = (block * ROWS_PER_TASK + i) * x.stride;
                *scale = quantise_row(&x.data[first..first + k], &mut bytes[..k]);
                bytes[k..].fill(0);
            }
        });
    }

    /// Converts rows of `k` values to bf16.
    pub fn set_halves(&mut self, x: Rows, k: usize) {
        let (stride, count) = (k.next_multiple_of(STEP / size_of::<u16>()), x.count);
        self.stride = stride;
        grow(&mut self.halves, count * stride);
        team::chunks(&mut self.halves[..count * stride], ROWS_PER_TASK * stride, |block, halves| {
            for (i, halves) in halves.chunks_exact_mut(stride).enumerate() {
                let first = (block * ROWS_PER_TASK + i) * x.stride;
                halve_row(&x.data[first..first + k], &mut halves[..k]);
                halves[k..].fill(0);
            }
        });
    }

    /// Returns the integers from row `first` on, the distance between rows, and scale and zero point of `count` rows.
    pub(crate) fn rows(&self, first: usize, count: usize) -> (&[u8], usize, &[(f32, i32)]) {
        (&self.bytes[first * self.stride..], self.stride, &self.scales[first..first + count])
    }

    /// Returns the values in bf16 from row `first` on, and the distance between rows.
    pub(crate) fn halves(&self, first: usize) -> (&[u16], usize) {
        (&self.halves[first * self.stride..], self.stride)
    }
}

/// Rounds a row to bf16, ties to even. NaN stays NaN.
pub(crate) fn halve_row(row: &[f32], halves: &mut [u16]) {
    simd::dispatch(
        #[inline(always)]
        || {
            for (half, value) in halves.iter_mut().zip(row) {
                *half = bf16(*value);
            }
        },
    );
}

/// Rounds to the nearest bf16, ties to even. NaN stays NaN. Without branches, so that loops over it are vectorised.
#[inline(always)]
pub(crate) fn bf16(value: f32) -> u16 {
    let bits = value.to_bits();
    let rounded = bits.wrapping_add(0x7fff + ((bits >> 16) & 1)) >> 16;
    if value.is_nan() { 0x7fc0 } else { rounded as u16 }
}

/// Converts one row. A value that is not finite makes the scale NaN, so that it shows in every product of the row.
fn quantise_row(row: &[f32], bytes: &mut [u8]) -> (f32, i32) {
    simd::dispatch(
        #[inline(always)]
        || {
            let (low, high) = extremes(row);
            // Divided before the subtraction: the difference itself may overflow.
            let scale = (high / 255.0) - (low / 255.0);
            if scale.is_nan() || scale <= SMALLEST {
                bytes.fill(0);
                return (if scale.is_nan() { scale } else { 0.0 }, 0);
            }
            let inverse = 1.0 / scale;
            let zero = (-low * inverse).round_ties_even();
            for (byte, value) in bytes.iter_mut().zip(row) {
                let shifted = value.mul_add(inverse, zero).clamp(0.0, 255.0) + ROUNDING;
                *byte = shifted.to_bits() as u8;
            }
            (scale, zero as i32)
        },
    )
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
        let mut quantised = Quantised::default();
        quantised.set(Rows::new(row, row.len()), row.len());
        let (bytes, _, scales) = quantised.rows(0, 1);
        let (scale, zero) = scales[0];
        bytes[..row.len()].iter().map(|byte| scale * (i32::from(*byte) - zero) as f32).collect()
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
    fn bf16_rounds_as_a_library_does() {
        let some = (0..if cfg!(miri) { 100 } else { 100_000u32 }).map(|i| i.wrapping_mul(2_654_435_761));
        for bits in
            some.chain([0x7f80_0000, 0xff80_0000, 0x7f80_0001, 0x7fff_ffff, 0xffff_ffff, 0x0000_8000, 0x7f7f_ffff])
        {
            let value = f32::from_bits(bits);
            let (got, want) = (half::bf16::from_bits(bf16(value)), half::bf16::from_f32(value));
            assert!(got == want || got.is_nan() && want.is_nan(), "{value}: {got} for {want}");
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
