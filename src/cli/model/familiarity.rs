//! Command `egotac model familiarity`.

use std::path::PathBuf;

use candle_core::Device;

use crate::cli::progress;
use crate::dataset::zarr;
use crate::model::{Checkpoint, DoubtThresholds, checkpoint};
use crate::train::data::Dataset;
use crate::train::familiarity;

/// Arguments of `egotac model familiarity`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Checkpoint to start from. The weights stay as they are.
    #[arg(long, value_name = "FILE|shipped", value_parser = crate::cli::options::checkpoint())]
    checkpoint: PathBuf,
    /// Zarr stores of training images, or folders of them.
    #[arg(long, value_name = "STORE", num_args = 1.., required = true)]
    data: Vec<PathBuf>,
    /// Stores of held-out images of the same kind; by default every fifth episode is held out.
    #[arg(long, value_name = "STORE", num_args = 1..)]
    held_out: Vec<PathBuf>,
    /// Share of images of the training's kind that may be called unfamiliar [default: 0.02].
    #[arg(long, value_name = "SHARE")]
    threshold: Option<f32>,
    /// Checkpoint to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let stored = checkpoint::stored(&args.checkpoint)?;
    let (config, mut metadata, mut tensors) = checkpoint::load_tensors(&args.checkpoint)?;
    metadata.doubt.familiarity = args.threshold.unwrap_or(DoubtThresholds::default().familiarity);
    metadata.check()?;
    let device = Device::Cpu;
    let model = Checkpoint::load(&args.checkpoint, &device)?.model;
    let open = |paths: &[PathBuf]| Dataset::new(zarr::open_all(paths)?, metadata.preparation(&config), false);
    let training = open(&args.data)?;
    let held_out = if args.held_out.is_empty() { None } else { Some(open(&args.held_out)?) };
    let bar = progress::bar("images");
    let fitted = familiarity::measure(&model, &training, held_out.as_ref(), &device, &mut |n| bar.inc(n as u64))?;
    let frames = bar.position();
    bar.finish_and_clear();
    tensors.extend(fitted.tensors()?);
    let sha256 = Checkpoint::save_as(&args.out, &config, &metadata, &tensors, stored)?;
    println!(
        "{}: familiarity from {frames} images, unfamiliar below {}, sha256 {sha256}",
        args.out.display(),
        metadata.doubt.familiarity
    );
    Ok(())
}
