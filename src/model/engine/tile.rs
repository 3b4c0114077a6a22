//! The innermost product in floating point: a few rows times a panel of columns, in registers.

use super::aligned::Number;

/// Rows of most tiles: with three vectors of columns its sums take 24 of 32 registers.
const ROWS: usize = 8;
/// Rows of the largest tile. The CLS token is one over a multiple of 8 patches: in a tile of its own most
/// registers would be idle, and each sum wait for the one before.
pub const MOST_ROWS: usize = ROWS + 1;
/// Tiles that one task takes, one below the other.
pub const TILES_PER_TASK: usize = 4;
/// Values in a vector.
pub const LANES: usize = 16;
/// Vectors of columns in the widest panel.
pub const VECTORS: usize = 3;

/// `out = a b + bias (+ out)` for one tile.
///
/// `a`: rows, `lda` apart, `k` values each. `b`: `k` lines of the panel, its vectors side by side.
#[derive(Debug, Clone, Copy)]
pub struct Tile<E> {
    /// First value of the first row.
    pub a: *const f32,
    /// From one row of `a` to the next.
    pub lda: usize,
    /// The panel.
    pub b: *const E,
    /// Lines of the panel.
    pub k: usize,
    /// Bias of the panel's columns; null for none.
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

/// Tiles that `rows` rows are split into.
pub fn count(rows: usize) -> usize {
    match rows % ROWS {
        1 if rows > ROWS => rows / ROWS,
        _ => rows.div_ceil(ROWS),
    }
}

/// First row and number of rows of the tiles that task `task` takes, of all those of `rows` rows: as even as can be.
pub fn of_task(task: usize, rows: usize) -> impl Iterator<Item = (usize, usize)> {
    let count = count(rows);
    let first = task * TILES_PER_TASK;
    (first..count.min(first + TILES_PER_TASK)).map(move |i| {
        let (start, end) = (i * rows / count, (i + 1) * rows / count);
        (start, end - start)
    })
}

/// A weight that becomes an f32.
#[allow(unsafe_code)]
pub trait Weight: Number {
    /// Its value.
    fn value(self) -> f32;

    /// 16 values.
    ///
    /// # Safety
    /// 16 weights can be read from `at`; the processor has AVX-512.
    #[cfg(target_arch = "x86_64")]
    unsafe fn load(at: *const Self) -> std::arch::x86_64::__m512;
}

#[allow(unsafe_code)]
impl Weight for f32 {
    #[inline(always)]
    fn value(self) -> f32 {
        self
    }

    #[cfg(target_arch = "x86_64")]
    #[inline]
    #[target_feature(enable = "avx512f")]
    unsafe fn load(at: *const Self) -> std::arch::x86_64::__m512 {
        // SAFETY: the caller's.
        unsafe { std::arch::x86_64::_mm512_loadu_ps(at) }
    }
}

/// bf16: the upper half of an f32.
#[allow(unsafe_code)]
impl Weight for u16 {
    #[inline(always)]
    fn value(self) -> f32 {
        f32::from_bits(u32::from(self) << 16)
    }

    #[cfg(target_arch = "x86_64")]
    #[inline]
    #[target_feature(enable = "avx512f")]
    unsafe fn load(at: *const Self) -> std::arch::x86_64::__m512 {
        use std::arch::x86_64::{_mm256_loadu_si256, _mm512_castsi512_ps, _mm512_cvtepu16_epi32, _mm512_slli_epi32};
        // SAFETY: the caller's.
        let half = unsafe { _mm256_loadu_si256(at.cast()) };
        _mm512_castsi512_ps(_mm512_slli_epi32::<16>(_mm512_cvtepu16_epi32(half)))
    }
}

/// Computes a tile of `rows` rows and `vectors` vectors of columns, with the widest vectors the processor has.
///
/// # Safety
/// `rows` is 1 to [`MOST_ROWS`], `vectors` 1 to [`VECTORS`], and everything the tile names can be read: `rows` x `k` of
/// `a`, `k` x 16 `vectors` of `b`, `cols` of the bias; `rows` x `cols` of `out` can be written, and nobody else uses them.
#[allow(unsafe_code)]
pub unsafe fn compute<E: Weight>(tile: &Tile<E>, rows: usize, vectors: usize) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx512f") {
        macro_rules! table {
            ($($r:literal)*) => {
                match (rows, vectors) {
                    // SAFETY: the feature is there; the rest is the caller's.
                    $(
                        ($r, 1) => unsafe { avx512::<E, $r, 1>(tile) },
                        ($r, 2) => unsafe { avx512::<E, $r, 2>(tile) },
                        ($r, 3) => unsafe { avx512::<E, $r, 3>(tile) },
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
#[target_feature(enable = "avx512f")]
unsafe fn avx512<E: Weight, const R: usize, const V: usize>(tile: &Tile<E>) {
    use std::arch::x86_64::{
        _mm512_add_ps, _mm512_fmadd_ps, _mm512_mask_storeu_ps, _mm512_maskz_loadu_ps, _mm512_set1_ps, _mm512_setzero_ps,
    };
    let Tile { a, lda, b, k, bias, out, ldc, cols, add } = *tile;
    let mut sums = [[_mm512_setzero_ps(); V]; R];
    for i in 0..k {
        let mut line = [_mm512_setzero_ps(); V];
        for (v, vector) in line.iter_mut().enumerate() {
            // SAFETY: inside the panel.
            *vector = unsafe { E::load(b.add((i * V + v) * LANES)) };
        }
        for (r, sums) in sums.iter_mut().enumerate() {
            // SAFETY: inside the row.
            let value = _mm512_set1_ps(unsafe { *a.add(r * lda + i) });
            for (sum, vector) in sums.iter_mut().zip(line) {
                *sum = _mm512_fmadd_ps(value, vector, *sum);
            }
        }
    }
    for v in 0..V {
        let there = cols.saturating_sub(v * LANES).min(LANES);
        let mask = ((1u32 << there) - 1) as u16;
        let bias = match bias.is_null() {
            true => _mm512_setzero_ps(),
            // SAFETY: masked to the columns that exist.
            false => unsafe { _mm512_maskz_loadu_ps(mask, bias.wrapping_add(v * LANES)) },
        };
        for (r, sums) in sums.iter().enumerate() {
            let at = out.wrapping_add(r * ldc + v * LANES);
            let mut sum = _mm512_add_ps(sums[v], bias);
            if add {
                // SAFETY: masked to the columns that exist.
                sum = _mm512_add_ps(sum, unsafe { _mm512_maskz_loadu_ps(mask, at) });
            }
            // SAFETY: masked to the columns that exist.
            unsafe { _mm512_mask_storeu_ps(at, mask, sum) };
        }
    }
}

/// As [`compute`], in plain Rust.
#[allow(unsafe_code)]
unsafe fn portable<E: Weight>(tile: &Tile<E>, rows: usize, vectors: usize) {
    let Tile { a, lda, b, k, bias, out, ldc, cols, add } = *tile;
    // SAFETY: the caller's, for all of the blocks below.
    let panel = unsafe { std::slice::from_raw_parts(b, k * vectors * LANES) };
    let bias = (!bias.is_null()).then(|| unsafe { std::slice::from_raw_parts(bias, cols) });
    for r in 0..rows {
        let row = unsafe { std::slice::from_raw_parts(a.add(r * lda), k) };
        let out = unsafe { std::slice::from_raw_parts_mut(out.add(r * ldc), cols) };
        super::super::ops::simd::dispatch(
            #[inline(always)]
            || {
                let mut sums = [0.0f32; VECTORS * LANES];
                for (value, line) in row.iter().zip(panel.chunks_exact(vectors * LANES)) {
                    for (sum, weight) in sums.iter_mut().zip(line) {
                        *sum = value.mul_add(weight.value(), *sum);
                    }
                }
                for (i, (out, sum)) in out.iter_mut().zip(sums).enumerate() {
                    let sum = sum + bias.map_or(0.0, |bias| bias[i]);
                    *out = if add { *out + sum } else { sum };
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
    fn tiles_cover_all_rows_once_and_none_is_a_row_over() {
        for rows in 1..2000 {
            let tasks = count(rows).div_ceil(TILES_PER_TASK);
            let tiles: Vec<_> = (0..tasks).flat_map(|task| of_task(task, rows)).collect();
            assert_eq!(tiles.len(), count(rows));
            let mut next = 0;
            for (first, size) in tiles {
                assert_eq!(first, next, "{rows}");
                assert!((rows.min(4)..=MOST_ROWS).contains(&size), "{rows}: {size}");
                next += size;
            }
            assert_eq!(next, rows);
        }
    }

    /// Every size of tile, by both forms, against sums in f64.
    #[test]
    fn tiles_of_every_size_are_the_product_in_both_forms() {
        let value = |i: usize| ((i * 7919 % 1013) as f32 / 1013.0) - 0.5;
        let (k, lda) = (21, 25);
        let a: Vec<f32> = (0..MOST_ROWS * lda).map(value).collect();
        for (rows, vectors, cols) in [(1, 1, 3), (2, 2, 32), (5, 3, 33), (8, 3, 48), (8, 2, 17), (7, 1, 16), (9, 3, 40)]
        {
            let width = vectors * LANES;
            let b: Vec<f32> = (0..k * width).map(|i| value(i + 5)).collect();
            let half: Vec<u16> = b.iter().map(|b| half::bf16::from_f32(*b).to_bits()).collect();
            let bias: Vec<f32> = (0..cols).map(|i| value(i + 99)).collect();
            let ldc = cols + 2;
            for (add, portable_form, bf16) in [
                (false, false, false),
                (true, false, false),
                (true, true, false),
                (false, false, true),
                (false, true, true),
            ] {
                let mut out = vec![1.0f32; rows * ldc];
                let base = Tile {
                    a: a.as_ptr(),
                    lda,
                    b: b.as_ptr(),
                    k,
                    bias: bias.as_ptr(),
                    out: out.as_mut_ptr(),
                    ldc,
                    cols,
                    add,
                };
                let with_half =
                    Tile { b: half.as_ptr(), a: base.a, lda, k, bias: base.bias, out: base.out, ldc, cols, add };
                // SAFETY: all slices are as long as the tile says.
                unsafe {
                    match (portable_form, bf16) {
                        (false, false) => compute(&base, rows, vectors),
                        (true, false) => portable(&base, rows, vectors),
                        (false, true) => compute(&with_half, rows, vectors),
                        (true, true) => portable(&with_half, rows, vectors),
                    }
                }
                for (i, got) in out.iter().enumerate() {
                    let (r, c) = (i / ldc, i % ldc);
                    let weight = |j: usize| if bf16 { half[j].value() } else { b[j] };
                    let sum: f64 = (0..k)
                        .map(|j| f64::from(a[r * lda + j]) * f64::from(weight(j * width + c.min(width - 1))))
                        .sum();
                    let want = match c < cols {
                        true => sum + f64::from(bias[c]) + if add { 1.0 } else { 0.0 },
                        false => 1.0,
                    };
                    assert!((f64::from(*got) - want).abs() < 1e-5, "{rows} {vectors} ({r}, {c}): {got} for {want}");
                }
            }
        }
    }
}
