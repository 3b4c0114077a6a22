//! Numpy arrays in and out.

use std::borrow::Cow;

use egotac::crates::glam::Vec3;
use numpy::ndarray::Array;
use numpy::{Element, PyArray, PyArrayDyn, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::error::{Error, raise};

/// Gives `values` to Python as an array of this shape, without a copy.
pub fn give<T: Element, const N: usize>(
    py: Python<'_>,
    name: &str,
    values: Vec<T>,
    shape: [usize; N],
) -> PyResult<Py<PyArrayDyn<T>>> {
    let length = values.len();
    let array = Array::from_shape_vec(&shape[..], values);
    let array = array.map_err(|_| Error::new_err(format!("{name}: expected shape {shape:?}, got {length} values")))?;
    Ok(PyArray::from_owned_array(py, array).unbind())
}

/// Returns points as an array (n, 3).
pub fn points(py: Python<'_>, points: &[Vec3]) -> PyResult<Py<PyArrayDyn<f32>>> {
    let values: Vec<f32> = points.iter().flat_map(|point| point.to_array()).collect();
    give(py, "points", values, [points.len(), 3])
}

/// Returns the values of an array in rows, without a copy if its memory has that order.
///
/// # Errors
/// If the array has another shape; 0 in `shape` stands for any length.
pub fn take<'a, T: Element + Copy>(
    name: &str,
    array: &'a PyReadonlyArrayDyn<'_, T>,
    shape: &[usize],
) -> PyResult<Cow<'a, [T]>> {
    let got = array.shape();
    if got.len() != shape.len() || got.iter().zip(shape).any(|(got, wanted)| *wanted != 0 && got != wanted) {
        let wanted: Vec<String> =
            shape.iter().map(|length| if *length == 0 { "any".into() } else { length.to_string() }).collect();
        let expected = format!("({})", wanted.join(", "));
        return Err(raise(egotac::Error::Shape { name: name.into(), expected, got: format!("{got:?}") }));
    }
    Ok(match array.as_slice() {
        Ok(values) if array.is_c_contiguous() => Cow::Borrowed(values),
        _ => Cow::Owned(array.as_array().iter().copied().collect()),
    })
}
