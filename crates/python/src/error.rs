//! Errors of the library as Python exceptions with the same text.

use pyo3::create_exception;
use pyo3::exceptions::{PyFileNotFoundError, PyOSError, PyValueError};
use pyo3::prelude::*;

create_exception!(
    egotac,
    Error,
    PyValueError,
    "Error of egotac: names what was read, what was expected, and what came."
);

/// Returns the exception for an error of the library: `OSError` where a file can't be read or written, else `egotac.Error`.
pub fn raise(error: egotac::Error) -> PyErr {
    match &error {
        egotac::Error::Io { source, .. } if source.kind() == std::io::ErrorKind::NotFound => {
            PyFileNotFoundError::new_err(error.to_string())
        }
        egotac::Error::Io { .. } => PyOSError::new_err(error.to_string()),
        _ => Error::new_err(error.to_string()),
    }
}

/// Returns the exception for an error of a command, with its causes.
pub fn raise_any(error: anyhow::Error) -> PyErr {
    match error.downcast::<egotac::Error>() {
        Ok(error) => raise(error),
        Err(error) => Error::new_err(egotac::text::error_chain(error.as_ref())),
    }
}
