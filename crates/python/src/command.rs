//! The command line, and labelling of recordings.

use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;

use egotac::cli;
use egotac::host::{self, Host};
use pyo3::prelude::*;

use crate::error::raise_any;

/// Sets the folder of the shipped files, and the program that runs egotac's commands in child processes.
#[pyfunction]
pub fn set_host(share: PathBuf, program: Option<PathBuf>) {
    host::set(Host { share, program });
}

/// Runs the command line `arguments`, whose first one is the program's name; returns the exit status.
#[pyfunction]
pub fn run_command(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    let code = py.detach(|| cli::main_with(arguments));
    (0..=u8::MAX).find(|status| ExitCode::from(*status) == code).unwrap_or(1)
}

/// Labels recordings with the arguments behind `egotac label`; returns the summary as JSON.
#[pyfunction]
pub fn label(py: Python<'_>, arguments: Vec<OsString>) -> PyResult<String> {
    Ok(py.detach(|| cli::label::summary(arguments)).map_err(raise_any)?.to_string())
}
