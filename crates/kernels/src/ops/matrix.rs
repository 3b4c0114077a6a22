//! Matrix products on slices.

use std::cell::Cell;

use gemm::Parallelism;

use super::cpu;
use crate::packed::product as unit;
use crate::quantise::bf16;
pub use crate::rows::Mat;
use crate::simd;

/// A matrix to write; its rows are contiguous.
pub struct MatMut<'a> {
    data: &'a mut [f32],
    rows: usize,
    cols: usize,
    stride: usize,
}

impl<'a> MatMut<'a> {
    /// Views a slice as `rows` rows of `cols` contiguous values, `stride` values from one row to the next.
    pub fn new(data: &'a mut [f32], rows: usize, cols: usize, stride: usize) -> Self {
        Self { data, rows, cols, stride }
    }
}

/// Use of the values already in the result of a product.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Onto {
    /// The product replaces them.
    Nothing,
    /// The product is added to them.
    Existing,
}

/// Number format of the factors of a product; values and sums are f32.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Factors {
    /// f32.
    Floats,
    /// Rounded to bf16.
    Halves,
}

thread_local! {
    /// Format for the operations that this thread begins.
    static FACTORS: Cell<Factors> = const { Cell::new(Factors::Floats) };
}

impl Factors {
    /// Returns the format for an operation that begins now on this thread.
    pub fn current() -> Self {
        FACTORS.get()
    }
}

/// Runs `f`. The linear layers that it begins on this thread, and their gradients, round the factors of their products to bf16, as the
/// processor's matrix unit takes them; sums and everything else stay f32. Without such a unit the products are no faster than in f32.
pub fn in_bf16<R>(f: impl FnOnce() -> R) -> R {
    /// Restores the format, also after a panic.
    struct Restore(Factors);
    impl Drop for Restore {
        fn drop(&mut self) {
            FACTORS.set(self.0);
        }
    }
    let _restore = Restore(FACTORS.replace(Factors::Halves));
    f()
}

/// Threads that a product may use; inside a parallel loop only one.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Threads {
    /// The calling thread.
    One,
    /// All threads of the pool, if the product is large enough.
    All,
}

/// Computes `out = scale · lhs rhs (+ out)`.
///
/// # Panics
/// If the shapes don't fit each other or their slices.
pub fn multiply(out: MatMut, onto: Onto, scale: f32, lhs: Mat, rhs: Mat, threads: Threads) {
    let MatMut { data, rows, cols, stride } = out;
    assert_eq!((rows, cols), (lhs.rows, rhs.cols), "shapes of a matrix product");
    if rows == 0 || cols == 0 {
        return;
    }
    assert!(cols <= stride || rows == 1, "rows of the result overlap");
    assert!((rows - 1) * stride + cols <= data.len(), "the result leaves its slice");
    // SAFETY: the assertions place the rows of the result inside its slice and keep them apart; the slice is initialised, and its
    // exclusive borrow separates it from both sides.
    unsafe { write(data.as_mut_ptr(), stride, onto, scale, lhs, rhs, threads) }
}

/// Returns the product, plus `bias` in every row if there is one, computed on all threads.
///
/// # Panics
/// If the shapes don't fit each other or their slices.
pub fn product(lhs: Mat, rhs: Mat, bias: Option<&[f32]>, factors: Factors) -> Vec<f32> {
    match factors {
        Factors::Floats => in_floats(lhs, rhs, bias),
        Factors::Halves if unit::available() => unit::product(lhs, rhs, bias),
        Factors::Halves => {
            in_floats(Mat { data: &rounded(lhs.data), ..lhs }, Mat { data: &rounded(rhs.data), ..rhs }, bias)
        }
    }
}

/// Returns the product of factors as they are.
fn in_floats(lhs: Mat, rhs: Mat, bias: Option<&[f32]>) -> Vec<f32> {
    let (rows, cols) = (lhs.rows, rhs.cols);
    if let Some(bias) = bias {
        let mut out = cpu::filled(rows * cols, cpu::ROWS * cols, |_, out| {
            out.chunks_exact_mut(cols).for_each(|row| row.copy_from_slice(bias));
        });
        multiply(MatMut::new(&mut out, rows, cols, cols), Onto::Existing, 1.0, lhs, rhs, Threads::All);
        return out;
    }
    let mut out: Vec<f32> = Vec::with_capacity(rows * cols);
    if rows > 0 && cols > 0 {
        // SAFETY: the vector has room for `rows` x `cols` values, which nothing else uses and which need no values before.
        unsafe { write(out.as_mut_ptr(), cols, Onto::Nothing, 1.0, lhs, rhs, Threads::All) };
    }
    // SAFETY: the capacity is at least `rows` x `cols`, and `write` has written all of them.
    unsafe { out.set_len(rows * cols) };
    out
}

/// Returns values rounded to bf16, as f32.
fn rounded(values: &[f32]) -> Vec<f32> {
    cpu::filled(values.len(), cpu::CHUNK, |index, out| {
        let values = cpu::block(values, index, cpu::CHUNK);
        simd::dispatch(
            #[inline(always)]
            || {
                for (out, value) in out.iter_mut().zip(values) {
                    *out = f32::from_bits(u32::from(bf16(*value)) << 16);
                }
            },
        );
    })
}

/// Writes all values of a product with at least one row and one column.
///
/// # Panics
/// If the shapes of the sides don't fit each other or their slices.
///
/// # Safety
/// Rows of the result, `stride` apart, can be written at `out`, don't overlap, and are used by nothing else; with [`Onto::Existing`] they
/// hold values.
unsafe fn write(out: *mut f32, stride: usize, onto: Onto, scale: f32, lhs: Mat, rhs: Mat, threads: Threads) {
    let (m, k, n) = (lhs.rows, lhs.cols, rhs.cols);
    assert_eq!(rhs.rows, k, "shapes of a matrix product");
    assert!(lhs.fits(), "the left side leaves its slice");
    assert!(rhs.fits(), "the right side leaves its slice");
    let parallelism = match threads {
        Threads::One => Parallelism::None,
        Threads::All => Parallelism::Rayon(0),
    };
    let existing = if onto == Onto::Existing { 1.0 } else { 0.0 };
    // SAFETY: `gemm` reads and writes exactly the values that sizes and strides address, and without `existing` writes all of the
    // result before it reads any. The assertions above place both sides inside their slices; the result is as the caller guarantees.
    unsafe {
        gemm::gemm(
            m,
            n,
            k,
            out,
            1,
            stride as isize,
            onto == Onto::Existing,
            lhs.data.as_ptr(),
            lhs.col_stride as isize,
            lhs.row_stride as isize,
            rhs.data.as_ptr(),
            rhs.col_stride as isize,
            rhs.row_stride as isize,
            existing,
            scale,
            false,
            false,
            false,
            parallelism,
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_with_strides_and_transposes_agree_with_the_definition() {
        let a: Vec<f32> = (0..7 * 9).map(|i| (i as f32 * 0.7).sin()).collect();
        let b: Vec<f32> = (0..6 * 9).map(|i| (i as f32 * 0.3).cos()).collect();
        // a is (7, 5) in rows of 9, b is (6, 5) in rows of 9, the result (7, 6) in rows of 8.
        let mut out = vec![1.0; 7 * 8];
        let (lhs, rhs) = (Mat::new(&a, 7, 5, 9), Mat::new(&b, 6, 5, 9).t());
        multiply(MatMut::new(&mut out, 7, 6, 8), Onto::Existing, 2.0, lhs, rhs, Threads::All);
        for (i, row) in out.chunks_exact(8).enumerate() {
            for (j, got) in row.iter().enumerate() {
                let product: f32 = (0..5).map(|k| a[9 * i + k] * b[9 * (j % 6) + k]).sum();
                let want = if j < 6 { 1.0 + 2.0 * product } else { 1.0 };
                assert!((got - want).abs() < 1e-5, "({i}, {j}): {got} for {want}");
            }
        }
    }

    #[test]
    fn a_new_product_has_all_its_values_even_without_terms() {
        let (a, b) = ([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [1.0, -1.0, 0.5, 2.0, 0.0, 1.0]);
        for factors in [Factors::Floats, Factors::Halves] {
            let got = product(Mat::new(&a, 2, 3, 3), Mat::new(&b, 3, 2, 2), None, factors);
            assert_eq!(got, [2.0, 6.0, 6.5, 12.0]);
            let got = product(Mat::new(&a, 2, 3, 3), Mat::new(&b, 3, 2, 2), Some(&[1.0, -1.0]), factors);
            assert_eq!(got, [3.0, 5.0, 7.5, 11.0]);
            assert_eq!(product(Mat::new(&[], 2, 0, 0), Mat::new(&[], 0, 3, 3), None, factors), [0.0; 6]);
            assert!(product(Mat::new(&[], 0, 3, 3), Mat::new(&b, 3, 2, 2), None, factors).is_empty());
        }
    }

    #[test]
    fn factors_in_bf16_give_the_same_products_with_and_without_a_matrix_unit() {
        let a: Vec<f32> = (0..90 * 70).map(|i| (i as f32 * 0.7).sin()).collect();
        let b: Vec<f32> = (0..70 * 40).map(|i| (i as f32 * 0.3).cos()).collect();
        let (lhs, rhs) = (Mat::new(&a, 70, 90, 90).t(), Mat::new(&b, 70, 40, 40));
        assert_eq!((lhs.rows, lhs.cols), (90, 70));
        let without = in_floats(Mat { data: &rounded(&a), ..lhs }, Mat { data: &rounded(&b), ..rhs }, None);
        let with = unit::product(lhs, rhs, None);
        assert!(with.iter().zip(&without).all(|(a, b)| (a - b).abs() < 1e-4));
        let exact = in_floats(lhs, rhs, None);
        let largest = |got: &[f32]| got.iter().zip(&exact).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!((1e-3..0.2).contains(&largest(&with)), "{}", largest(&with));
    }

    #[test]
    fn the_format_holds_within_the_scope_alone_even_after_a_panic() {
        assert_eq!(Factors::current(), Factors::Floats);
        assert_eq!(in_bf16(Factors::current), Factors::Halves);
        assert!(std::panic::catch_unwind(|| in_bf16(|| panic!("within"))).is_err());
        assert_eq!(Factors::current(), Factors::Floats);
    }

    #[test]
    #[should_panic(expected = "leaves its slice")]
    fn a_matrix_larger_than_its_slice_is_refused() {
        let (a, mut out) = (vec![0.0; 5], vec![0.0; 4]);
        let (lhs, rhs) = (Mat::new(&a, 2, 3, 3), Mat::new(&a, 3, 2, 2));
        multiply(MatMut::new(&mut out, 2, 2, 2), Onto::Nothing, 1.0, lhs, rhs, Threads::One);
    }
}
