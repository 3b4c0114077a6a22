//! The most that this processor computes and reads: the two roofs that the time of a layer is compared with.

use crate::aligned::Aligned;
use crate::amx::{self, Block, Kind, STEP, Sums, WIDTH};
use crate::packed::Format;
use crate::simd;
use crate::tile::{LANES, Next};

/// Vectors of sums that the loop keeps in registers: enough that no multiply-add waits for the one before.
const SUMS: usize = 12;
/// Steps of a block whose operands stay in the cache that is nearest to the matrix unit.
const STEPS: usize = 8;

/// Multiplies and adds on this thread, in registers, with the instructions that a layer of this format uses. Returns the number
/// of floating-point (or integer) operations; a multiply-add counts as two.
///
/// Formats of fewer bits have a peak of their own only with a matrix unit; without one it is that of [`Format::F32`].
pub fn multiply_add(format: Format, rounds: usize) -> f64 {
    match format {
        Format::Bf16 if amx::available() => matrix(Kind::Half, rounds),
        Format::Int8 if amx::available() => matrix(Kind::Byte, rounds),
        _ => vectors(rounds),
    }
}

fn vectors(rounds: usize) -> f64 {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx512f") {
        // SAFETY: AVX-512 F was detected.
        return unsafe { avx512(rounds) };
    }
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        // SAFETY: both features were detected.
        return unsafe { avx2(rounds) };
    }
    let mut sums = [0.0f32; SUMS];
    let (a, b) = std::hint::black_box((0.5f32, 0.25f32));
    for _ in 0..rounds {
        sums.iter_mut().for_each(|sum| *sum = *sum * a + b);
    }
    std::hint::black_box(sums);
    2.0 * (rounds * SUMS) as f64
}

/// # Safety
/// The processor has AVX-512 F.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
unsafe fn avx512(rounds: usize) -> f64 {
    use std::arch::x86_64::{_mm512_fmadd_ps, _mm512_set1_ps};
    let (a, b) = std::hint::black_box((_mm512_set1_ps(0.5), _mm512_set1_ps(0.25)));
    let mut sums = [a; SUMS];
    for _ in 0..rounds {
        for sum in &mut sums {
            *sum = _mm512_fmadd_ps(*sum, a, b);
        }
    }
    std::hint::black_box(sums);
    2.0 * (rounds * SUMS * LANES) as f64
}

/// # Safety
/// The processor has AVX2 and FMA.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn avx2(rounds: usize) -> f64 {
    use std::arch::x86_64::{_mm256_fmadd_ps, _mm256_set1_ps};
    let (a, b) = std::hint::black_box((_mm256_set1_ps(0.5), _mm256_set1_ps(0.25)));
    let mut sums = [a; SUMS];
    for _ in 0..rounds {
        for sum in &mut sums {
            *sum = _mm256_fmadd_ps(*sum, a, b);
        }
    }
    std::hint::black_box(sums);
    2.0 * (rounds * SUMS * LANES / 2) as f64
}

fn matrix(kind: Kind, rounds: usize) -> f64 {
    let lda = STEPS * STEP;
    let (a, b) = (Aligned::<u8>::zeros(amx::ROWS * lda), Aligned::<u8>::zeros(STEPS * STEP * amx::VECTORS * LANES));
    let mut sums = Sums::new();
    let (out, next) = (sums.start(), Next::NONE);
    let block = Block { a: a.as_ptr(), lda, b: b.as_ptr(), steps: STEPS, out, ldc: WIDTH, next };
    for _ in 0..rounds {
        // SAFETY: `a` has 32 rows of 64 x STEPS bytes, `b` 16 x STEPS lines of 128 bytes, and the sums room for the block.
        unsafe { amx::multiply(kind, &block, amx::ROWS, amx::VECTORS) };
    }
    std::hint::black_box(&sums);
    let inputs = match kind {
        Kind::Half => lda / 2,
        Kind::Byte => lda,
    };
    2.0 * (rounds * amx::ROWS * WIDTH * inputs) as f64
}

/// Reads all values once. Returns their sum, so that no read is left out.
pub fn read(values: &[f32]) -> f32 {
    simd::dispatch(
        #[inline(always)]
        || {
            simd::sum(
                values,
                #[inline(always)]
                |x| x,
            )
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn operations_are_counted_and_all_values_read() {
        let lanes = multiply_add(Format::F32, 10) / (2.0 * 10.0 * 12.0);
        assert!([1.0, 8.0, 16.0].contains(&lanes), "{lanes}");
        let of_bytes = multiply_add(Format::Int8, 2);
        let of_halves = multiply_add(Format::Bf16, 2);
        match amx::available() {
            true => assert_eq!((of_bytes, of_halves), (2.0 * of_halves, 2.0 * 2.0 * 32.0 * 32.0 * 256.0)),
            false => assert_eq!((of_bytes, of_halves), (multiply_add(Format::F32, 2), of_bytes)),
        }
        assert_eq!(read(&[1.5; 100]), 150.0);
    }
}
