//! Refusal of numbers that are not finite.

use std::path::Path;

use crate::error::{Error, Result};

/// Checks that all values of a tensor are finite.
///
/// # Errors
/// [`Error::NotFinite`] with the first value that is not.
pub(crate) fn check_finite(tensor: &str, values: &[f32]) -> Result<()> {
    match values.iter().position(|value| !value.is_finite()) {
        Some(index) => Err(Error::NotFinite { tensor: tensor.into(), index, value: values[index] }),
        None => Ok(()),
    }
}

/// Checks that all values of a tensor of a file are finite.
///
/// # Errors
/// Names the file, the tensor and the first value that is not.
pub(super) fn check_finite_in(path: &Path, tensor: &str, values: &[f32]) -> Result<()> {
    match values.iter().find(|value| !value.is_finite()) {
        Some(bad) => Err(Error::file(path, format!("{tensor}: expected finite numbers, found {bad}"))),
        None => Ok(()),
    }
}
