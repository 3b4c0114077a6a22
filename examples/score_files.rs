//! Scores predicted touch against true touch, both as tensor files (`egotac predict` writes them).
//!
//! `cargo run --release --example score_files -- PREDICTED.safetensors TRUTH.safetensors`

use std::path::PathBuf;

use egotac::dataset::tensors;
use egotac::score::metrics::{self, EvalOptions};

fn main() -> anyhow::Result<()> {
    let paths: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [predicted, truth] = &paths[..] else { anyhow::bail!("usage: score_files PREDICTED TRUTH") };
    let (predicted, truth) = (tensors::read(predicted)?, tensors::read(truth)?);
    let scores = metrics::evaluate(&predicted, &truth, &EvalOptions::default())?;
    println!("{}", metrics::table(&[("predicted", &scores)]));
    Ok(())
}
