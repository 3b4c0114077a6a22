//! Rows of values in a slice, perhaps with gaps between them, and matrices.

/// Rows in a slice. The width of a row is known to the layer that reads it.
#[derive(Debug, Clone, Copy)]
pub struct Rows<'a> {
    /// The values.
    pub data: &'a [f32],
    /// Values from the start of one row to the start of the next.
    pub stride: usize,
    /// Number of rows.
    pub count: usize,
}

impl<'a> Rows<'a> {
    /// All rows of `data`, of `width` values each, without gaps.
    #[inline]
    pub fn new(data: &'a [f32], width: usize) -> Self {
        Self { data, stride: width, count: data.len() / width }
    }
}

/// A matrix in a slice; its rows or its columns are contiguous.
#[derive(Clone, Copy)]
pub struct Mat<'a> {
    pub(crate) data: &'a [f32],
    pub(crate) rows: usize,
    pub(crate) cols: usize,
    pub(crate) row_stride: usize,
    pub(crate) col_stride: usize,
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

    /// True if all values lie inside the slice.
    pub(crate) fn fits(self) -> bool {
        self.rows == 0
            || self.cols == 0
            || (self.rows - 1) * self.row_stride + (self.cols - 1) * self.col_stride < self.data.len()
    }
}

/// Returns start and length of one of `parts` parts of `total`, which differ by at most one.
pub(crate) fn part(index: usize, parts: usize, total: usize) -> (usize, usize) {
    let (start, end) = (index * total / parts, (index + 1) * total / parts);
    (start, end - start)
}
