//! Command `egotac model attention`.

use std::path::PathBuf;

use ::image::{RgbImage, imageops};
use anyhow::{Context as _, ensure};
use candle_core::{Device, Tensor};

use crate::file::{self, input, limits};
use crate::image;
use crate::model::{EgoTac, Metadata, checkpoint, shipped};
use crate::render::heat;

/// Side of each drawn image, pixels: twice the input of the larger presets.
const SIDE: u32 = 448;

/// Arguments of `egotac model attention`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// PNG or JPEG files of the observation window, oldest first; where they are too few, the first one is repeated.
    #[arg(required = true, value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// Checkpoint [default: the one shipped with egotac].
    #[arg(long, value_name = "FILE|shipped", value_parser = crate::cli::options::checkpoint())]
    checkpoint: Option<PathBuf>,
    /// Layer of the vision encoder, from 0, whose CLS token's attention is drawn [default: the temporal token of the fusion].
    #[arg(long)]
    layer: Option<usize>,
    /// Attention head, from 0 [default: the mean over all heads].
    #[arg(long)]
    head: Option<usize>,
    /// PNG to write: the images of the window side by side, oldest first, with their attention drawn over them.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let path = args.checkpoint.clone().map_or_else(shipped::path, Ok)?;
    let (model, metadata) = checkpoint::load_uncompiled(&path)?;
    let config = model.config();
    let pictures = read_window(&args.images, config.horizon)?;
    let weights = patch_weights(&model, &metadata, &pictures, args.layer, args.head)?;
    let largest = weights.iter().flatten().fold(0.0f32, |largest, weight| largest.max(*weight));
    let mut out = RgbImage::new(SIDE * config.horizon as u32, SIDE);
    for (i, (picture, weights)) in pictures.iter().zip(&weights).enumerate() {
        let square = image::resize(picture, config.image, metadata.resize, metadata.filter)?;
        let drawn = heat::overlay(&square, weights, config.grid() as u32, largest, SIDE);
        imageops::replace(&mut out, &drawn, i64::from(SIDE) * i as i64, 0);
        println!("image {i}: {:.1} % of the attention on patches", 100.0 * weights.iter().sum::<f32>());
    }
    file::write_png(&args.out, &out)?;
    println!("largest weight of a patch {:.2} %; written to {}", 100.0 * largest, args.out.display());
    Ok(())
}

/// Reads the images of a window; the first one is repeated until there are `horizon`.
fn read_window(paths: &[PathBuf], horizon: usize) -> anyhow::Result<Vec<RgbImage>> {
    ensure!(paths.len() <= horizon, "images: expected at most {horizon}, the window, got {}", paths.len());
    let mut pictures = Vec::new();
    for path in paths {
        let bytes = input::read(path, limits::FILE)?;
        pictures.push(image::decode(&bytes).with_context(|| path.display().to_string())?);
    }
    while pictures.len() < horizon {
        pictures.insert(0, pictures[0].clone());
    }
    Ok(pictures)
}

/// Computes the attention on each patch, `(frames, patches)`: of the CLS token in an encoder layer, or of the temporal
/// token; of one head, or the mean of all.
fn patch_weights(
    model: &EgoTac,
    metadata: &Metadata,
    pictures: &[RgbImage],
    layer: Option<usize>,
    head: Option<usize>,
) -> anyhow::Result<Vec<Vec<f32>>> {
    let config = model.config();
    let preparation = metadata.preparation(config);
    let mut pixels = Vec::new();
    for picture in pictures {
        pixels.extend(preparation.apply(picture)?);
    }
    let frames = Tensor::from_vec(pixels, (config.horizon, 3, config.image, config.image), &Device::Cpu)?;
    let weights = match layer {
        Some(layer) => model.encoder_attention(&frames, layer)?,
        None => {
            let weights = model.temporal_attention(&frames.unsqueeze(0)?)?.get(0)?; // (heads, T, P)
            weights.transpose(0, 1)?.narrow(2, 1, config.tokens() - 1)?
        }
    }; // (frames, heads, patches)
    let heads = weights.dim(1)?;
    let weights = match head {
        Some(head) => {
            ensure!(head < heads, "--head: expected 0 to {}, got {head}", heads - 1);
            weights.narrow(1, head, 1)?.squeeze(1)?
        }
        None => weights.mean(1)?,
    };
    Ok(weights.contiguous()?.to_vec2::<f32>()?)
}
