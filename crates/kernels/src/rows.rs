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
