//! Command `egotac model presence`.

use std::path::PathBuf;

use candle_core::Device;

use crate::cli::progress;
use crate::dataset::zarr;
use crate::model::{Checkpoint, DoubtThresholds, checkpoint};
use crate::train::data::Dataset;
use crate::train::presence::{self, Settings};

/// Arguments of `egotac model presence`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The stores hold poses of camera and hands of egotac's built-in hand, as `egotac sim` writes them. Add scenes \
    without hands: `egotac sim generate --hands none`. The network also sees frames whose hands are cut off or covered, and \
    procedural pictures without hands. A hand counts as present with three of its 21 keypoints in view, as absent with none."
)]
pub struct Args {
    /// Checkpoint to start from. The weights stay as they are.
    #[arg(long, value_name = "FILE|shipped", value_parser = crate::cli::options::checkpoint())]
    checkpoint: PathBuf,
    /// Zarr stores of training images, or folders of them.
    #[arg(long, value_name = "STORE", num_args = 1.., required = true)]
    data: Vec<PathBuf>,
    /// Stores of held-out images of the same kind, for the score; by default every fifth episode is held out.
    #[arg(long, value_name = "STORE", num_args = 1..)]
    held_out: Vec<PathBuf>,
    /// Training frames, at most; evenly spread over the stores.
    #[arg(long, value_name = "N", default_value_t = Settings::default().frames, value_parser = frames)]
    frames: usize,
    /// Passes over the training images.
    #[arg(long, value_name = "N", default_value_t = Settings::default().epochs)]
    epochs: usize,
    /// Seed of weights, changes of the images and their order.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Presence of a hand below which its touch is unknown [default: 0.5].
    #[arg(long, value_name = "PROBABILITY")]
    threshold: Option<f32>,
    /// Checkpoint to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Parses a number of frames; each takes 80 kB in the shipped network's size.
fn frames(text: &str) -> Result<usize, String> {
    let expected = "expected 32 to 100000 frames";
    text.parse().ok().filter(|frames| (32..=100_000).contains(frames)).ok_or_else(|| expected.into())
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let stored = checkpoint::stored(&args.checkpoint)?;
    let (config, mut metadata, mut tensors) = checkpoint::load_tensors(&args.checkpoint)?;
    metadata.doubt.presence = args.threshold.unwrap_or(DoubtThresholds::default().presence);
    metadata.check()?;
    let model = Checkpoint::load(&args.checkpoint, &Device::Cpu)?.model;
    let open = |paths: &[PathBuf]| {
        let mut dataset = Dataset::new(zarr::open_all(paths)?, metadata.preparation(&config), false)?;
        dataset.find_keypoints()?;
        anyhow::Ok(dataset)
    };
    let training = open(&args.data)?;
    let held_out = if args.held_out.is_empty() { None } else { Some(open(&args.held_out)?) };
    let settings = Settings { frames: args.frames, epochs: args.epochs, seed: args.seed };
    let [images, steps] = ["images", "steps"].map(progress::bar);
    let mut progress = |encoded: usize, taken: usize| {
        images.inc(encoded as u64);
        steps.inc(taken as u64);
    };
    let fitted = presence::fit(&model, &training, held_out.as_ref(), &settings, None, &mut progress)?;
    let count = images.position();
    images.finish_and_clear();
    steps.finish_and_clear();
    tensors.extend(fitted.tensors);
    let sha256 = Checkpoint::save_as(&args.out, &config, &metadata, &tensors, stored)?;
    println!(
        "{}: presence from {count} images, a hand's touch unknown below {}, sha256 {sha256}",
        args.out.display(),
        metadata.doubt.presence
    );
    println!("{}", fitted.score);
    Ok(())
}
