//! Rows of values in a slice, perhaps with gaps between them.

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

/// Returns start and length of one of `parts` parts of `total`, which differ by at most one.
pub(crate) fn part(index: usize, parts: usize, total: usize) -> (usize, usize) {
    let (start, end) = (index * total / parts, (index + 1) * total / parts);
    (start, end - start)
}
