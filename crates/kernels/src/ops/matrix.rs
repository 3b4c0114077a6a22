//! Matrix products on slices.

use gemm::Parallelism;

/// A matrix in a slice; its rows or its columns are contiguous.
#[derive(Clone, Copy)]
pub struct Mat<'a> {
    data: &'a [f32],
    rows: usize,
    cols: usize,
    row_stride: usize,
    col_stride: usize,
}

impl<'a> Mat<'a> {
    /// Views a slice as `rows` rows of `cols` contiguous values, `stride` values from one row to the next.
    pub fn new(data: &'a [f32], rows: usize, cols: usize, stride: usize) -> Self {
        Self { data, rows, cols, row_stride: stride, col_stride: 1 }
    }

    /// Returns the transpose, a view of the same values.
    pub fn t(self) -> Self {
        Self { rows: self.cols, cols: self.rows, row_stride: self.col_stride, col_stride: self.row_stride, ..self }
    }
}

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

/// Returns the product, computed on all threads.
///
/// # Panics
/// If the shapes don't fit each other or their slices.
pub fn product(lhs: Mat, rhs: Mat) -> Vec<f32> {
    let (rows, cols) = (lhs.rows, rhs.cols);
    let mut out: Vec<f32> = Vec::with_capacity(rows * cols);
    if rows > 0 && cols > 0 {
        // SAFETY: the vector has room for `rows` x `cols` values, which nothing else uses and which need no values before.
        unsafe { write(out.as_mut_ptr(), cols, Onto::Nothing, 1.0, lhs, rhs, Threads::All) };
    }
    // SAFETY: the capacity is at least `rows` x `cols`, and `write` has written all of them.
    unsafe { out.set_len(rows * cols) };
    out
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
    let inside = |side: Mat| {
        side.rows == 0 || side.cols == 0 || {
            (side.rows - 1) * side.row_stride + (side.cols - 1) * side.col_stride < side.data.len()
        }
    };
    assert!(inside(lhs), "the left side leaves its slice");
    assert!(inside(rhs), "the right side leaves its slice");
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
        let got = product(Mat::new(&a, 2, 3, 3), Mat::new(&b, 3, 2, 2));
        assert_eq!(got, [2.0, 6.0, 6.5, 12.0]);
        assert_eq!(product(Mat::new(&[], 2, 0, 0), Mat::new(&[], 0, 3, 3)), [0.0; 6]);
        assert!(product(Mat::new(&[], 0, 3, 3), Mat::new(&b, 3, 2, 2)).is_empty());
    }

    #[test]
    #[should_panic(expected = "leaves its slice")]
    fn a_matrix_larger_than_its_slice_is_refused() {
        let (a, mut out) = (vec![0.0; 5], vec![0.0; 4]);
        let (lhs, rhs) = (Mat::new(&a, 2, 3, 3), Mat::new(&a, 3, 2, 2));
        multiply(MatMut::new(&mut out, 2, 2, 2), Onto::Nothing, 1.0, lhs, rhs, Threads::One);
    }
}
