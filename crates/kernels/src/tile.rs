//! The innermost product in floating point: a few rows times a panel of columns, in registers.

use crate::aligned::Number;
use crate::rows::part;
use crate::simd;

/// Rows of most tiles, except with AVX2. With three vectors of columns the sums take 24 of the 32 registers of AVX-512; three more
/// hold a line of the panel and one the broadcast value of `a`.
const ROWS: usize = 8;
/// Rows of most tiles with AVX2: two pieces of [`AVX2_ROWS`].
const ROWS_WITH_AVX2: usize = 2 * AVX2_ROWS;
/// Rows of the largest piece with AVX2. With two vectors of 8 columns the sums take 12 of the 16 registers, a line of the panel two,
/// and the broadcast value of `a` one. With 4 rows and 3 vectors all 16 are taken, but the compiler keeps a sum in memory, and
/// products take twice as long.
const AVX2_ROWS: usize = 6;
/// Rows of the largest tile of any processor. A frame has a multiple of 8 patches and one CLS token: in a tile of its own that token
/// would leave most registers idle, and each multiply-add would wait for the one before.
pub const MOST_ROWS: usize = ROWS_WITH_AVX2 + 1;
/// Lines of a panel that are asked for ahead of their use. Wide panels come from the L2 cache, and the processor alone asks too
/// late: products of 257 x 768 x 2304 took a sixth longer.
#[cfg(target_arch = "x86_64")]
const AHEAD: usize = 16;
/// Lines of a panel between two cache lines that a tile asks for in [`Tile::next`].
pub const PERIOD: usize = 4;
/// Tiles of one task of an attention, one below the other: they share the panel, which stays in the L1 or L2 cache between them.
pub const TILES_PER_TASK: usize = 4;
/// f32 values in a vector of AVX-512.
pub const LANES: usize = 16;
/// Vectors of columns in the widest panel of any processor; see [`ROWS`].
pub const VECTORS: usize = 3;

/// Vectors of columns in the widest panel of this processor.
///
/// AVX2 computes one vector after the other. In panels of their own their lines are contiguous, and the panel of a layer with 3072
/// inputs fits into the L2 cache, which one of three vectors exceeds: that product takes 0.7 of the time, others 0.85 to 1.
pub fn widest() -> usize {
    if prefers_avx2() { 1 } else { VECTORS }
}

/// True if [`compute`] uses AVX2.
fn prefers_avx2() -> bool {
    #[cfg(target_arch = "x86_64")]
    return !std::arch::is_x86_feature_detected!("avx512f") && has_avx2();
    #[cfg(not(target_arch = "x86_64"))]
    false
}

/// True if [`compute`] may use AVX2.
#[cfg(target_arch = "x86_64")]
fn has_avx2() -> bool {
    std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma")
}

/// `out = a b + bias (+ out)` for one tile.
///
/// `a`: rows of `k` values. `b`: a panel, which holds for each of the `k` inputs one line with the weights of all its
/// columns. A tile reads its panel from start to end, so the prefetcher keeps up.
#[derive(Debug, Clone, Copy)]
pub struct Tile<E> {
    /// First value of the first row.
    pub a: *const f32,
    /// Values from one row of `a` to the next.
    pub lda: usize,
    /// The panel.
    pub b: *const E,
    /// Lines of the panel.
    pub k: usize,
    /// Bias of each column; null for none.
    pub bias: *const f32,
    /// First value of the first row of the result.
    pub out: *mut f32,
    /// Values from one row of the result to the next.
    pub ldc: usize,
    /// Columns of the result; the panel is padded to whole vectors.
    pub cols: usize,
    /// True to add to the result instead of replacing it.
    pub add: bool,
    /// Asked for while the tile is computed, a cache line every [`PERIOD`] lines of the panel.
    pub next: Next,
}

/// Memory that a later tile reads: hints bring it into a core's own cache (L2) before.
///
/// Without them the first tile of each panel waits for memory: most products of 257 rows in f32 took 3 to 14 % longer. The hints are spread
/// over the tile; given all at once they keep the tile's own reads waiting, and gained less than half of that.
#[derive(Debug, Clone, Copy)]
pub struct Next {
    at: *const u8,
    step: usize,
}

/// Bytes of a cache line.
const LINE: usize = 64;
static NOWHERE: [u8; LINE] = [0; LINE];

impl Next {
    /// Nothing: the hints name a line that is in the cache already. A null pointer would make the processor search for its page.
    pub const NONE: Self = Self { at: (&raw const NOWHERE).cast(), step: 0 };

    /// The share of `values` that a tile with `hints` hints asks for after `before` tiles like it; nothing once all values were asked for.
    pub fn share<T>(values: &[T], hints: usize, before: usize) -> Self {
        let from = before * hints * LINE;
        match from < size_of_val(values) {
            true => Self { at: values.as_ptr().cast::<u8>().wrapping_add(from), step: LINE },
            false => Self::NONE,
        }
    }

    /// First byte.
    pub fn at(self) -> *const u8 {
        self.at
    }

    /// Bytes from one hint to the next; 0 if nothing is to come.
    pub fn step(self) -> usize {
        self.step
    }

    /// Asks for the cache line of hint `index`. Hints never fault, so one beyond the end does no harm.
    #[cfg(target_arch = "x86_64")]
    #[inline]
    #[target_feature(enable = "sse")]
    pub fn hint(self, index: usize) {
        use std::arch::x86_64::{_MM_HINT_T1, _mm_prefetch};
        _mm_prefetch::<_MM_HINT_T1>(self.at.wrapping_add(index * self.step).cast());
    }
}

/// Number of tiles that `rows` rows are split into by [`part`].
pub fn count(rows: usize) -> usize {
    count_of(rows, if prefers_avx2() { ROWS_WITH_AVX2 } else { ROWS })
}

/// Number of tiles of `most` rows, or of one more: no tile has a single row beside others.
fn count_of(rows: usize, most: usize) -> usize {
    match rows % most {
        1 if rows > most => rows / most,
        _ => rows.div_ceil(most),
    }
}

/// Returns first row and number of rows of each tile of a task, with `rows` rows in all. Tiles differ by at most one row.
pub fn of_task(task: usize, rows: usize) -> impl Iterator<Item = (usize, usize)> {
    let count = count(rows);
    let first = task * TILES_PER_TASK;
    (first..count.min(first + TILES_PER_TASK)).map(move |tile| part(tile, count, rows))
}

/// A stored weight that is converted to f32 when it is used.
pub trait Weight: Number {
    /// The weight as f32.
    fn value(self) -> f32;

    /// Loads 16 weights as f32.
    ///
    /// # Safety
    /// 16 weights can be read from `at`, and the processor has AVX-512 F.
    #[cfg(target_arch = "x86_64")]
    unsafe fn load(at: *const Self) -> std::arch::x86_64::__m512;

    /// Loads 8 weights as f32.
    ///
    /// # Safety
    /// 8 weights can be read from `at`, and the processor has AVX2.
    #[cfg(target_arch = "x86_64")]
    unsafe fn load_half(at: *const Self) -> std::arch::x86_64::__m256;
}

impl Weight for f32 {
    #[inline(always)]
    fn value(self) -> f32 {
        self
    }

    #[cfg(target_arch = "x86_64")]
    #[inline]
    #[target_feature(enable = "avx512f")]
    unsafe fn load(at: *const Self) -> std::arch::x86_64::__m512 {
        // SAFETY: the caller guarantees 16 readable values and the feature; the load needs no alignment.
        unsafe { std::arch::x86_64::_mm512_loadu_ps(at) }
    }

    #[cfg(target_arch = "x86_64")]
    #[inline]
    #[target_feature(enable = "avx2")]
    unsafe fn load_half(at: *const Self) -> std::arch::x86_64::__m256 {
        // SAFETY: the caller guarantees 8 readable values and the feature; the load needs no alignment.
        unsafe { std::arch::x86_64::_mm256_loadu_ps(at) }
    }
}

/// bf16: the upper half of an f32.
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
        // SAFETY: the caller guarantees 16 readable weights, 32 bytes, and the feature; the load needs no alignment.
        let half = unsafe { _mm256_loadu_si256(at.cast()) };
        _mm512_castsi512_ps(_mm512_slli_epi32::<16>(_mm512_cvtepu16_epi32(half)))
    }

    #[cfg(target_arch = "x86_64")]
    #[inline]
    #[target_feature(enable = "avx2")]
    unsafe fn load_half(at: *const Self) -> std::arch::x86_64::__m256 {
        use std::arch::x86_64::{_mm_loadu_si128, _mm256_castsi256_ps, _mm256_cvtepu16_epi32, _mm256_slli_epi32};
        // SAFETY: the caller guarantees 8 readable weights, 16 bytes, and the feature; the load needs no alignment.
        let half = unsafe { _mm_loadu_si128(at.cast()) };
        _mm256_castsi256_ps(_mm256_slli_epi32::<16>(_mm256_cvtepu16_epi32(half)))
    }
}

/// Computes a tile of `rows` rows and `vectors` vectors of columns, with the widest vectors of the processor.
///
/// # Panics
/// If the tile is larger than those that [`count`] and [`widest`] give on a processor with AVX-512.
///
/// # Safety
/// - `rows` is 1 to [`MOST_ROWS`], `vectors` 1 to [`VECTORS`], `cols` at most 16 `vectors`;
/// - `rows` rows of `k` values can be read from `a`, `k` x 16 `vectors` weights from `b`, `cols` values from a bias that is
///   not null;
/// - `rows` rows of `cols` values of `out` can be read and written, and no other thread uses them during the call.
pub unsafe fn compute<E: Weight>(tile: &Tile<E>, rows: usize, vectors: usize) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx512f") {
        macro_rules! table {
            ($($r:literal)*) => {
                match (rows, vectors) {
                    $(
                        ($r, 1) => avx512::<E, $r, 1>,
                        ($r, 2) => avx512::<E, $r, 2>,
                        ($r, 3) => avx512::<E, $r, 3>,
                    )*
                    _ => unreachable!("a tile of {rows} rows and {vectors} vectors"),
                }
            };
        }
        let form: unsafe fn(&Tile<E>) = table!(1 2 3 4 5 6 7 8 9);
        // SAFETY: AVX-512 F was detected above, and `form` is the one for `rows` and `vectors`; sizes and pointers are as the
        // caller guarantees.
        return unsafe { form(tile) };
    }
    #[cfg(target_arch = "x86_64")]
    if has_avx2() {
        // SAFETY: AVX2 and FMA were detected above; sizes and pointers are as the caller guarantees.
        return unsafe { by_avx2(tile, rows, vectors) };
    }
    // SAFETY: sizes and pointers are as the caller guarantees.
    unsafe { portable(tile, rows, vectors) }
}

/// As [`compute`], in pieces of up to [`AVX2_ROWS`] rows and 2 vectors of 8 columns.
///
/// # Safety
/// As [`compute`]; the processor has AVX2 and FMA.
#[cfg(target_arch = "x86_64")]
unsafe fn by_avx2<E: Weight>(tile: &Tile<E>, rows: usize, vectors: usize) {
    let pieces = rows.div_ceil(AVX2_ROWS);
    // The columns of a piece stay in the L1 cache while all rows pass.
    for vector in 0..vectors {
        for piece in 0..pieces {
            let (row, end) = (piece * rows / pieces, (piece + 1) * rows / pieces);
            let form: unsafe fn(&Tile<E>, usize, usize, usize) = match end - row {
                1 => avx2::<E, 1>,
                2 => avx2::<E, 2>,
                3 => avx2::<E, 3>,
                4 => avx2::<E, 4>,
                5 => avx2::<E, 5>,
                AVX2_ROWS => avx2::<E, AVX2_ROWS>,
                rows => unreachable!("a piece of {rows} rows"),
            };
            // SAFETY: rows `row` to `end` and vector `vector` are inside of the tile, whose pointers are as the caller
            // guarantees; `form` is the one for their number, and the caller guarantees the features.
            unsafe { form(tile, row, vector, vectors) };
        }
    }
}

/// A piece of a tile in AVX2: `R` rows from `row` on, 16 columns: vector `vector` of the `vectors` of a line.
///
/// # Safety
/// As [`compute`] with `vectors` vectors, `row + R` at most the tile's rows and `vector` below `vectors`; the processor has AVX2 and
/// FMA.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn avx2<E: Weight, const R: usize>(tile: &Tile<E>, row: usize, vector: usize, vectors: usize) {
    use std::arch::x86_64::{
        _mm256_add_ps, _mm256_fmadd_ps, _mm256_loadu_ps, _mm256_set1_ps, _mm256_setzero_ps, _mm256_storeu_ps,
    };
    const HALF: usize = LANES / 2;
    // `next` is not asked for: with the hints, most products took longer.
    let Tile { a, lda, b, k, bias, out, ldc, cols, add, .. } = *tile;
    let mut sums = [[_mm256_setzero_ps(); 2]; R];
    for i in 0..k {
        // SAFETY: line i < k of the panel, vector `vector` < `vectors`: 16 weights inside the panel that the caller guarantees.
        let line = unsafe {
            let at = b.add((i * vectors + vector) * LANES);
            [E::load_half(at), E::load_half(at.add(HALF))]
        };
        for (r, sums) in sums.iter_mut().enumerate() {
            // SAFETY: value i < k of row + r, which is a row of the tile.
            let value = _mm256_set1_ps(unsafe { *a.add((row + r) * lda + i) });
            for (sum, half) in sums.iter_mut().zip(line) {
                *sum = _mm256_fmadd_ps(value, half, *sum);
            }
        }
    }
    for half in 0..2 {
        let start = vector * LANES + half * HALF;
        let there = cols.saturating_sub(start).min(HALF);
        for (r, sums) in sums.iter().enumerate() {
            let at = out.wrapping_add((row + r) * ldc + start);
            if there == HALF {
                // SAFETY: columns start to start + 8 are below `cols`, which the caller guarantees of a bias that is not null
                // and of each row of `out`, which nothing else uses.
                unsafe {
                    let bias = if bias.is_null() { _mm256_setzero_ps() } else { _mm256_loadu_ps(bias.add(start)) };
                    let sum = _mm256_add_ps(sums[half], bias);
                    _mm256_storeu_ps(at, if add { _mm256_add_ps(sum, _mm256_loadu_ps(at)) } else { sum });
                }
                continue;
            }
            let mut values = [0.0f32; HALF];
            // SAFETY: the array has 8 values.
            unsafe { _mm256_storeu_ps(values.as_mut_ptr(), sums[half]) };
            for (c, value) in values.into_iter().take(there).enumerate() {
                // SAFETY: column start + c is below `cols`, which the caller guarantees of a bias that is not null and of each
                // row of `out`, which nothing else uses.
                unsafe {
                    let sum = if bias.is_null() { value } else { value + *bias.add(start + c) };
                    let place = at.add(c);
                    *place = if add { sum + *place } else { sum };
                }
            }
        }
    }
}

/// The tile in AVX-512: `R` x `V` sums stay in registers while the panel passes once.
///
/// # Safety
/// As [`compute`] with `R` rows and `V` vectors; the processor has AVX-512 F.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
unsafe fn avx512<E: Weight, const R: usize, const V: usize>(tile: &Tile<E>) {
    use std::arch::x86_64::{
        _MM_HINT_T0, _mm_prefetch, _mm512_add_ps, _mm512_fmadd_ps, _mm512_mask_storeu_ps, _mm512_maskz_loadu_ps,
        _mm512_set1_ps, _mm512_setzero_ps,
    };
    let Tile { a, lda, b, k, bias, out, ldc, cols, add, next } = *tile;
    let mut sums = [[_mm512_setzero_ps(); V]; R];
    for i in 0..k {
        if i % PERIOD == 0 {
            next.hint(i / PERIOD);
        }
        let mut line = [_mm512_setzero_ps(); V];
        for (v, vector) in line.iter_mut().enumerate() {
            // SAFETY: line i < k of the panel, vector v < V: inside the k x V vectors that the caller guarantees.
            *vector = unsafe { E::load(b.add((i * V + v) * LANES)) };
            _mm_prefetch::<_MM_HINT_T0>(b.wrapping_add(((i + AHEAD) * V + v) * LANES).cast());
        }
        for (r, sums) in sums.iter_mut().enumerate() {
            // SAFETY: value i < k of row r < R, which the caller guarantees.
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
            // SAFETY: the mask admits only columns below `cols`, which the caller guarantees of the bias.
            false => unsafe { _mm512_maskz_loadu_ps(mask, bias.wrapping_add(v * LANES)) },
        };
        for (r, sums) in sums.iter().enumerate() {
            let at = out.wrapping_add(r * ldc + v * LANES);
            let mut sum = _mm512_add_ps(sums[v], bias);
            if add {
                // SAFETY: the mask admits only columns below `cols` of row r, which the caller guarantees of `out`.
                sum = _mm512_add_ps(sum, unsafe { _mm512_maskz_loadu_ps(mask, at) });
            }
            // SAFETY: as for the load from `out`; nothing else uses these values, as the caller guarantees.
            unsafe { _mm512_mask_storeu_ps(at, mask, sum) };
        }
    }
}

/// As [`compute`], in plain Rust.
///
/// # Safety
/// As [`compute`].
unsafe fn portable<E: Weight>(tile: &Tile<E>, rows: usize, vectors: usize) {
    let Tile { a, lda, b, k, bias, out, ldc, cols, add, .. } = *tile;
    // SAFETY: the caller guarantees a panel of k x 16 `vectors` weights, which nobody changes during the call.
    let panel = unsafe { std::slice::from_raw_parts(b, k * vectors * LANES) };
    // SAFETY: not null, so the caller guarantees `cols` biases, which nobody changes during the call.
    let bias = (!bias.is_null()).then(|| unsafe { std::slice::from_raw_parts(bias, cols) });
    for r in 0..rows {
        // SAFETY: the caller guarantees k values in row r < `rows` of `a`.
        let row = unsafe { std::slice::from_raw_parts(a.add(r * lda), k) };
        // SAFETY: the caller guarantees `cols` values in row r < `rows` of `out`, which nothing else uses. The slice ends with
        // this turn of the loop, so no two slices of `out` exist together.
        let out = unsafe { std::slice::from_raw_parts_mut(out.add(r * ldc), cols) };
        simd::dispatch(
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
mod tests {
    use super::*;

    /// A way to compute a tile of f32 and of bf16 weights.
    type Form = (unsafe fn(&Tile<f32>, usize, usize), unsafe fn(&Tile<u16>, usize, usize));

    /// Rows of the largest tile that [`compute`] takes on this processor.
    fn most_rows() -> usize {
        if prefers_avx2() { MOST_ROWS } else { ROWS + 1 }
    }

    #[test]
    fn the_shares_of_successive_tiles_ask_for_each_cache_line_of_a_panel_once() {
        let panel = vec![0u8; 1000 * LINE + 7];
        let hints = 96;
        let mut asked = vec![0; 1001];
        for before in 0..40 {
            let Next { at, step } = Next::share(&panel, hints, before);
            for hint in (0..hints).filter(|_| step > 0) {
                let line = (at.addr() - panel.as_ptr().addr()) / LINE + hint;
                // A hint beyond the end does no harm.
                if let Some(count) = asked.get_mut(line) {
                    *count += 1;
                }
            }
        }
        assert!(asked.iter().all(|count| *count == 1), "{asked:?}");
    }

    #[test]
    fn tiles_cover_all_rows_once_and_none_has_a_single_row() {
        for rows in 1..if cfg!(miri) { 60 } else { 2000 } {
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
            for most in [ROWS, ROWS_WITH_AVX2] {
                let tiles = count_of(rows, most);
                let mut sizes = (0..tiles).map(|tile| part(tile, tiles, rows).1);
                assert!(sizes.all(|size| (rows.min(4)..=most + 1).contains(&size)), "{rows} in tiles of {most}");
            }
        }
    }

    #[test]
    fn all_forms_give_the_product_in_f64_for_every_size() {
        let mut forms: Vec<(Form, usize)> =
            vec![((compute::<f32>, compute::<u16>), most_rows()), ((portable::<f32>, portable::<u16>), MOST_ROWS)];
        #[cfg(target_arch = "x86_64")]
        if has_avx2() {
            forms.push(((by_avx2::<f32>, by_avx2::<u16>), MOST_ROWS));
        }
        let value = |i: usize| ((i * 7919 % 1013) as f32 / 1013.0) - 0.5;
        // Miri is slow: a short product.
        let k = if cfg!(miri) { 5 } else { 21 };
        let lda = k + 4;
        let a: Vec<f32> = (0..MOST_ROWS * lda).map(value).collect();
        let narrow = (1..=MOST_ROWS).map(|rows| (rows, 1, 16 - rows));
        let wide = [(2, 2, 32), (5, 3, 33), (8, 3, 48), (8, 2, 17), (7, 1, 16), (9, 3, 40), (MOST_ROWS, 3, 48)];
        for (rows, vectors, cols) in narrow.chain(wide) {
            let width = vectors * LANES;
            let b: Vec<f32> = (0..k * width).map(|i| value(i + 5)).collect();
            let half: Vec<u16> = b.iter().map(|b| half::bf16::from_f32(*b).to_bits()).collect();
            let bias: Vec<f32> = (0..cols).map(|i| value(i + 99)).collect();
            let ldc = cols + 2;
            let forms = forms.iter().filter(|(_, most)| rows <= *most);
            for (form, add, bf16) in forms.flat_map(|(form, _)| [0, 1, 2, 3].map(|i| (form, i % 2 == 1, i > 1))) {
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
                    next: Next::NONE,
                };
                let Tile { a: x, bias: terms, out: at, next, .. } = base;
                let with_half = Tile { b: half.as_ptr(), a: x, lda, k, bias: terms, out: at, ldc, cols, add, next };
                // SAFETY: the slices have the sizes that the tile states, and this thread alone uses `out`.
                unsafe {
                    match bf16 {
                        false => (form.0)(&base, rows, vectors),
                        true => (form.1)(&with_half, rows, vectors),
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
