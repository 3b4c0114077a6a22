//! Columns of lists of numbers.

use std::path::Path;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type};
use arrow_array::{Array, ArrayRef, RecordBatch};
use arrow_schema::DataType;

use crate::error::{Error, Result};

/// Returns the numbers of a column of lists of `width` each.
pub(super) fn lists(batch: &RecordBatch, name: &str, width: usize, path: &Path) -> Result<Vec<f32>> {
    let column = batch.column_by_name(name);
    let values = column.and_then(|column| match column.data_type() {
        DataType::FixedSizeList(..) => column.as_fixed_size_list_opt().map(|list| list.values().clone()),
        DataType::List(_) => column.as_list_opt::<i32>().map(|list| list.values().clone()),
        _ => None,
    });
    let wide = |values: &ArrayRef| {
        let values = values.as_primitive_opt::<Float64Type>()?;
        Some(values.values().iter().map(|value| *value as f32).collect())
    };
    let narrow = |values: &ArrayRef| values.as_primitive_opt::<Float32Type>().map(|values| values.values().to_vec());
    let values = values.filter(|values| values.null_count() == 0);
    let values = values.and_then(|values| narrow(&values).or_else(|| wide(&values)));
    let values = values.filter(|values| values.len() == batch.num_rows() * width);
    values.ok_or_else(|| Error::file(path, format!("{name}: expected lists of {width} float32 or float64")))
}
