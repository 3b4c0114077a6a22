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
    let (m, k, n) = (lhs.rows, lhs.cols, rhs.cols);
    assert_eq!((rhs.rows, out.rows, out.cols), (k, m, n), "shapes of a matrix product");
    if m == 0 || n == 0 {
        return;
    }
    let inside = |rows: usize, cols: usize, row_stride: usize, col_stride: usize, len: usize| {
        rows == 0 || cols == 0 || (rows - 1) * row_stride + (cols - 1) * col_stride < len
    };
    assert!(n <= out.stride || m == 1, "rows of the result overlap");
    assert!(inside(m, n, out.stride, 1, out.data.len()), "the result leaves its slice");
    assert!(inside(m, k, lhs.row_stride, lhs.col_stride, lhs.data.len()), "the left side leaves its slice");
    assert!(inside(k, n, rhs.row_stride, rhs.col_stride, rhs.data.len()), "the right side leaves its slice");
    let parallelism = match threads {
        Threads::One => Parallelism::None,
        Threads::All => Parallelism::Rayon(0),
    };
    let existing = if onto == Onto::Existing { 1.0 } else { 0.0 };
    // SAFETY: `gemm` reads and writes exactly the values that sizes and strides address. The assertions above place all of
    // them inside their slices and keep the rows of the result apart; the exclusive borrow of the result separates it from
    // both sides.
    unsafe {
        gemm::gemm(
            m,
            n,
            k,
            out.data.as_mut_ptr(),
            1,
            out.stride as isize,
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
    #[should_panic(expected = "leaves its slice")]
    fn a_matrix_larger_than_its_slice_is_refused() {
        let (a, mut out) = (vec![0.0; 5], vec![0.0; 4]);
        let (lhs, rhs) = (Mat::new(&a, 2, 3, 3), Mat::new(&a, 3, 2, 2));
        multiply(MatMut::new(&mut out, 2, 2, 2), Onto::Nothing, 1.0, lhs, rhs, Threads::One);
    }
}
