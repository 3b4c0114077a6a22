//! Commands that write a checkpoint from other files: `egotac model import`, `init`, `grow` and `half`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use candle_core::Tensor;

use crate::model::checkpoint::{self, Stored};
use crate::model::grow::{self, Growth};
use crate::model::import::Mapping;
use crate::model::pretrained::{self, InitOptions};
use crate::model::{Checkpoint, Config, Metadata};

/// Arguments of `egotac model import`.
#[derive(Debug, clap::Args)]
pub struct Import {
    /// Checkpoint of another program: safetensors or a PyTorch file. Code in it is never executed.
    #[arg(long, value_name = "FILE")]
    checkpoint: PathBuf,
    /// Table (YAML) of geometry, force scale, hand order, image statistics, frame stride and tensor names.
    #[arg(long, value_name = "FILE")]
    mapping: PathBuf,
    /// Checkpoint to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Arguments of `egotac model init`.
#[derive(Debug, clap::Args)]
pub struct Init {
    /// Published DINOv2 checkpoint (safetensors with Hugging Face names), with or without register tokens.
    #[arg(long, value_name = "FILE")]
    encoder: PathBuf,
    /// Side of the input image, pixels.
    #[arg(long, value_name = "PIXELS", default_value_t = 224)]
    size: usize,
    /// Frames in the observation window.
    #[arg(long, default_value_t = 4)]
    horizon: usize,
    /// Tactile steps predicted.
    #[arg(long, default_value_t = 1)]
    predict: usize,
    /// Layers of the decoder.
    #[arg(long, default_value_t = 12)]
    depth: usize,
    /// Seed of all parameters outside the encoder.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Checkpoint to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Arguments of `egotac model grow`.
#[derive(Debug, clap::Args)]
pub struct Grow {
    /// Checkpoint to enlarge.
    #[arg(long, value_name = "FILE|shipped", value_parser = crate::cli::options::checkpoint())]
    checkpoint: PathBuf,
    /// Width of fusion and decoder; a multiple of the present width keeps the function exactly [default: the present width].
    #[arg(long)]
    width: Option<usize>,
    /// Layers of the encoder [default: the present number].
    #[arg(long, value_name = "LAYERS")]
    vision_depth: Option<usize>,
    /// Layers of the decoder [default: the present number].
    #[arg(long, value_name = "LAYERS")]
    depth: Option<usize>,
    /// Seed of the random shares in which copied channels divide their weights.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Checkpoint to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Arguments of `egotac model half`.
#[derive(Debug, clap::Args)]
pub struct Half {
    /// Checkpoint to convert.
    #[arg(long, value_name = "FILE|shipped", value_parser = crate::cli::options::checkpoint())]
    checkpoint: PathBuf,
    /// Checkpoint to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Runs `egotac model import`.
pub fn import(args: &Import) -> anyhow::Result<()> {
    save(&args.out, Mapping::read(&args.mapping)?.apply(&args.checkpoint)?)
}

/// Runs `egotac model init`.
pub fn init(args: &Init) -> anyhow::Result<()> {
    let Init { size: image, horizon, predict, depth, seed, .. } = *args;
    save(&args.out, pretrained::init(&args.encoder, &InitOptions { image, horizon, predict, depth, seed })?)
}

/// Runs `egotac model grow`.
pub fn grow(args: &Grow) -> anyhow::Result<()> {
    let (config, mut metadata, tensors) = checkpoint::load_tensors(&args.checkpoint)?;
    let growth = Growth {
        width: args.width.unwrap_or(config.width),
        vision_depth: args.vision_depth.unwrap_or(config.vision_depth),
        depth: args.depth.unwrap_or(config.depth),
        seed: args.seed,
    };
    let (config, tensors) = grow::grow(&args.checkpoint, &config, &tensors, &growth)?;
    metadata.name = format!("{}, grown", metadata.name);
    save(&args.out, (config, metadata, tensors))
}

/// Runs `egotac model half`.
pub fn half(args: &Half) -> anyhow::Result<()> {
    let (config, metadata, tensors) = checkpoint::load_tensors(&args.checkpoint)?;
    let sha256 = Checkpoint::save_as(&args.out, &config, &metadata, &tensors, Stored::F16)?;
    println!("{}: {} tensors in f16, sha256 {sha256}", args.out.display(), tensors.len());
    Ok(())
}

fn save(path: &Path, (config, metadata, tensors): (Config, Metadata, BTreeMap<String, Tensor>)) -> anyhow::Result<()> {
    let sha256 = Checkpoint::save_tensors(path, &config, &metadata, &tensors)?;
    println!("{}: {} tensors, sha256 {sha256}", path.display(), tensors.len());
    Ok(())
}
