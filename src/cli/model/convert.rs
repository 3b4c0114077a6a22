//! `egotac model import` and `egotac model start`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use candle_core::Tensor;

use crate::model::hub::{self, Around};
use crate::model::import::Mapping;
use crate::model::{Checkpoint, Config, Metadata};

/// Arguments of `egotac model import`.
#[derive(Debug, clap::Args)]
pub struct Import {
    /// Another program's checkpoint: safetensors, or a PyTorch file; nothing in it is executed.
    #[arg(long, value_name = "FILE")]
    weights: PathBuf,
    /// Table (YAML) of geometry, force scale, hand order, image statistics, frame stride, and names of tensors.
    #[arg(long, value_name = "FILE")]
    mapping: PathBuf,
    /// Checkpoint to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Arguments of `egotac model start`.
#[derive(Debug, clap::Args)]
pub struct Start {
    /// Published DINOv2 checkpoint (safetensors, names of the hub), with or without register tokens.
    #[arg(long, value_name = "FILE")]
    encoder: PathBuf,
    /// Side of the input image, pixels.
    #[arg(long, default_value_t = 224)]
    image: usize,
    /// Frames in the observation window.
    #[arg(long, default_value_t = 4)]
    horizon: usize,
    /// Tactile steps predicted.
    #[arg(long, default_value_t = 1)]
    predict: usize,
    /// Layers of the decoder.
    #[arg(long, default_value_t = 12)]
    depth: usize,
    /// Seed of everything that is not the encoder.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Checkpoint to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Runs `egotac model import`.
pub fn import(args: &Import) -> anyhow::Result<()> {
    save(&args.out, Mapping::read(&args.mapping)?.apply(&args.weights)?)
}

/// Runs `egotac model start`.
pub fn start(args: &Start) -> anyhow::Result<()> {
    let Start { image, horizon, predict, depth, seed, .. } = *args;
    save(&args.out, hub::start(&args.encoder, &Around { image, horizon, predict, depth, seed })?)
}

fn save(path: &Path, (config, metadata, tensors): (Config, Metadata, BTreeMap<String, Tensor>)) -> anyhow::Result<()> {
    let sha256 = Checkpoint::save_tensors(path, &config, &metadata, &tensors)?;
    println!("{}: {} tensors, sha256 {sha256}", path.display(), tensors.len());
    Ok(())
}
