//! `egotac predict`.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, bail};
use indicatif::ProgressBar;

use crate::dataset::tensors;
use crate::dataset::zarr;
use crate::model::{Checkpoint, Precision, Predictor, predictor, shipped};
use crate::tactile::TactileSequence;
use crate::train::{data::Dataset, predict};

/// Arguments of `egotac predict`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The file holds force (T, 1556) in N, contact (T, 1556) as probability, timestamps (T) in s and \
    episode_ends, ready for `egotac eval`. Vertices: left hand 0..777, right hand 778..1555; what an index means is the \
    metadata's `topology`."
)]
pub struct Args {
    /// Checkpoint to run; the one that comes with egotac if absent.
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// Zarr stores or folders of them; or PNG and JPEG files or folders of them, one sequence in time.
    #[arg(long, value_name = "PATH", num_args = 1.., required = true)]
    data: Vec<PathBuf>,
    /// Images per second of an image sequence; by default one per observation step of the checkpoint.
    #[arg(long, value_name = "F", value_parser = super::positive)]
    fps: Option<f64>,
    /// Field file to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// CUDA device, by index; the CPU without it.
    #[arg(long, value_name = "INDEX")]
    cuda: Option<usize>,
    /// Number format of the network: f32, bf16 or int8.
    #[arg(long, default_value = "f32")]
    precision: Precision,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let device = super::device(args.cuda)?;
    let path = args.checkpoint.map_or_else(shipped::path, Ok)?;
    let checkpoint = Checkpoint::load_as(&path, &device, args.precision)?;
    let metadata = HashMap::from([
        ("model".to_string(), checkpoint.metadata.name.clone()),
        ("checkpoint_sha256".to_string(), checkpoint.sha256.clone()),
    ]);
    let images = images(&args.data)?;
    let predicted = match images.is_empty() {
        true => {
            let preparation = checkpoint.metadata.preparation(checkpoint.model.config());
            let data = Dataset::new(zarr::open_all(&args.data)?, preparation, false)?;
            predict_stores(&checkpoint, &data, &device)?
        }
        false => predict_images(checkpoint, &images, args.fps, device)?,
    };
    tensors::write(&args.out, &predicted, metadata)?;
    println!("{}: {} frames", args.out.display(), predicted.n_frames());
    Ok(ExitCode::SUCCESS)
}

/// Predicts every frame of every store.
pub(super) fn predict_stores(
    checkpoint: &Checkpoint,
    data: &Dataset,
    device: &candle_core::Device,
) -> anyhow::Result<TactileSequence> {
    let bar = ProgressBar::new(data.n_frames() as u64);
    let predicted = predict(&checkpoint.model, &checkpoint.metadata, data, device, |n| bar.inc(n as u64))?;
    bar.finish_and_clear();
    Ok(predicted)
}

fn predict_images(
    checkpoint: Checkpoint,
    paths: &[PathBuf],
    fps: Option<f64>,
    device: candle_core::Device,
) -> anyhow::Result<TactileSequence> {
    let dt = fps.map_or(checkpoint.metadata.frame_dt, |fps| 1.0 / fps);
    // A sequence is one stream, however slow.
    let options = predictor::Options { device, max_gap_secs: Some(f64::MAX), ..Default::default() };
    let mut predictor = Predictor::new(checkpoint, options)?;
    let mut predicted = TactileSequence::default();
    for (index, path) in paths.iter().enumerate() {
        let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
        let image = crate::image::decode(&bytes).with_context(|| path.display().to_string())?;
        let stamp = index as f64 * dt;
        predicted.push(&predictor.push(&image, stamp).with_context(|| path.display().to_string())?.field)?;
        predicted.timestamps.push(stamp);
    }
    predicted.episode_ends = vec![paths.len()];
    Ok(predicted)
}

/// The image files that `paths` name, folders by file name; empty if the paths are stores.
fn images(paths: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let mut images = Vec::new();
    let mut others = Vec::new();
    for path in paths {
        let before = images.len();
        if path.is_dir() {
            let mut inside = Vec::new();
            for entry in std::fs::read_dir(path).with_context(|| path.display().to_string())? {
                inside.push(entry?.path());
            }
            inside.retain(|file| is_image(file));
            inside.sort();
            images.extend(inside);
        } else if is_image(path) {
            images.push(path.clone());
        }
        if images.len() == before {
            others.push(path);
        }
    }
    if let (Some(image), Some(other)) = (images.first(), others.first()) {
        bail!("images and others don't mix: {} and {}", image.display(), other.display());
    }
    Ok(images)
}

fn is_image(path: &Path) -> bool {
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    path.is_file() && extension.is_some_and(|e| ["png", "jpg", "jpeg"].contains(&e.as_str()))
}
