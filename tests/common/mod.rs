//! Helpers shared by several test files; each file uses a part of them.
#![allow(dead_code)]

pub mod store;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use candle_core::Tensor;

/// Runs `egotac` with these arguments.
pub fn egotac(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_egotac")).args(arguments).output().unwrap()
}

/// Runs `egotac` with 1.5 GB of address space, and a minute as a guard against hangs.
pub fn egotac_bounded(arguments: &[&str]) -> Output {
    let limited = "ulimit -v 1500000; exec timeout -k 5 60 \"$@\"";
    Command::new("sh").args(["-c", limited, "sh", env!("CARGO_BIN_EXE_egotac")]).args(arguments).output().unwrap()
}

/// Checks that `egotac`, within the bounds of [`egotac_bounded`], ends with status 1 and one line that contains `word`: no
/// signal, no panic, no time-out. Returns the line.
pub fn refused(arguments: &[&str], word: &str) -> String {
    let output = egotac_bounded(arguments);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {:?} {error}", output.status);
    assert!(error.contains(word) && error.lines().count() == 1, "{arguments:?}: {word:?} is not in: {error}");
    assert!(error.len() < 4000, "{arguments:?}: a message of {} bytes", error.len());
    error
}

/// Returns the path of a file of `tests/data/hand`.
pub fn hand_data(name: &str) -> PathBuf {
    data("hand", name.as_ref())
}

/// Returns the path of a file of `tests/data/model`.
pub fn model_data(name: impl AsRef<Path>) -> PathBuf {
    data("model", name.as_ref())
}

fn data(folder: &str, name: &Path) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(folder).join(name)
}

/// Returns the relative L2 error of a tensor.
pub fn relative_error(got: &Tensor, want: &Tensor) -> f64 {
    assert_eq!(got.dims(), want.dims());
    let norm = |tensor: &Tensor| -> f64 {
        let values = tensor.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        values.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt()
    };
    norm(&(got - want).unwrap()) / norm(want)
}
