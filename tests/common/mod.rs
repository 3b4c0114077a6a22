//! Helpers shared by several test files; each file uses a part of them.
#![allow(dead_code)]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use candle_core::Tensor;

/// Runs `egotac` with these arguments.
pub fn egotac(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_egotac")).args(arguments).output().unwrap()
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
