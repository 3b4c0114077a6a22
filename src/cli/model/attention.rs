//! `egotac model attention`.

use std::path::PathBuf;

use ::image::{Rgb, RgbImage, imageops};
use anyhow::{Context as _, ensure};
use candle_core::{Device, Tensor};

use crate::model::{checkpoint, shipped};
use crate::{file, image};

/// Side of the picture, pixels.
const SIDE: u32 = 448;

/// Arguments of `egotac model attention`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// PNG or JPEG files, oldest first: the observation window; the last one stands in for those that lack.
    #[arg(required = true, value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// Checkpoint; the one that comes with egotac if absent.
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// Layer of the vision encoder, from 0: what its CLS token attends to. Without it, what the temporal token does.
    #[arg(long)]
    layer: Option<usize>,
    /// Head, from 0; the mean over all without it.
    #[arg(long)]
    head: Option<usize>,
    /// PNG to write: the window's images side by side, oldest first, with the attention on them.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let path = args.checkpoint.clone().map_or_else(shipped::path, Ok)?;
    let (model, metadata) = checkpoint::load_uncompiled(&path)?;
    let config = model.config().clone();
    let horizon = config.horizon;
    ensure!(args.images.len() <= horizon, "images: expected at most {horizon}, the window, got {}", args.images.len());
    let mut pictures = Vec::new();
    for path in &args.images {
        let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
        pictures.push(image::decode(&bytes).with_context(|| path.display().to_string())?);
    }
    while pictures.len() < horizon {
        pictures.insert(0, pictures[0].clone());
    }
    let preparation = metadata.preparation(&config);
    let mut pixels = Vec::new();
    for picture in &pictures {
        pixels.extend(preparation.apply(picture)?);
    }
    let frames = Tensor::from_vec(pixels, (horizon, 3, config.image, config.image), &Device::Cpu)?;
    // (frames, heads, patches)
    let weights = match args.layer {
        Some(layer) => model.encoder_attention(&frames, layer)?,
        None => {
            let weights = model.temporal_attention(&frames.unsqueeze(0)?)?.get(0)?; // (heads, T, P)
            weights.transpose(0, 1)?.narrow(2, 1, config.tokens() - 1)?
        }
    };
    let heads = weights.dim(1)?;
    let weights = match args.head {
        Some(head) => {
            ensure!(head < heads, "--head: expected 0 to {}, got {head}", heads - 1);
            weights.narrow(1, head, 1)?.squeeze(1)?
        }
        None => weights.mean(1)?,
    };
    let weights = weights.contiguous()?.to_vec2::<f32>()?;
    let largest = weights.iter().flatten().fold(0.0f32, |largest, weight| largest.max(*weight));
    let mut out = RgbImage::new(SIDE * horizon as u32, SIDE);
    for (i, (picture, weights)) in pictures.iter().zip(&weights).enumerate() {
        let square = image::resize(picture, config.image, metadata.resize, metadata.filter)?;
        let drawn = overlay(&square, weights, config.grid() as u32, largest);
        imageops::replace(&mut out, &drawn, i64::from(SIDE) * i as i64, 0);
        println!("image {i}: {:.1} % of the attention on patches", 100.0 * weights.iter().sum::<f32>());
    }
    file::write_png(&args.out, &out)?;
    println!("largest weight of a patch {:.2} %; written to {}", 100.0 * largest, args.out.display());
    Ok(())
}

/// The image, darker where there is little attention, and redder where there is much.
fn overlay(image: &RgbImage, weights: &[f32], grid: u32, largest: f32) -> RgbImage {
    let share = |weight: f32| if largest > 0.0 { weight / largest } else { 0.0 };
    let map = ::image::ImageBuffer::<::image::Luma<f32>, Vec<f32>>::from_fn(grid, grid, |x, y| {
        ::image::Luma([share(weights[(y * grid + x) as usize])])
    });
    let map = imageops::resize(&map, SIDE, SIDE, imageops::FilterType::Triangle);
    let image = imageops::resize(image, SIDE, SIDE, imageops::FilterType::Triangle);
    RgbImage::from_fn(SIDE, SIDE, |x, y| {
        let heat = map.get_pixel(x, y).0[0].clamp(0.0, 1.0).sqrt();
        let Rgb(pixel) = *image.get_pixel(x, y);
        let color = [255.0, 200.0 * heat, 0.0];
        Rgb(std::array::from_fn(|channel| {
            let dark = f32::from(pixel[channel]) * 0.55;
            (dark + 0.7 * heat * (color[channel] - dark)) as u8
        }))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_patch_with_the_most_attention_is_the_reddest() {
        let image = RgbImage::from_pixel(28, 28, Rgb([80, 80, 80]));
        let picture = overlay(&image, &[0.0, 0.1, 0.0, 0.0], 2, 0.1);
        let red = |x: u32, y: u32| i32::from(picture.get_pixel(x, y).0[0]) - i32::from(picture.get_pixel(x, y).0[2]);
        assert!(red(3 * SIDE / 4, SIDE / 4) > 100 && red(SIDE / 4, 3 * SIDE / 4) < 40);
    }
}
