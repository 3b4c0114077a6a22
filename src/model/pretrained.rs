//! Networks that start at a published DINOv2 encoder (safetensors under the names of the Hugging Face hub).

use std::collections::BTreeMap;
use std::path::Path;

use candle_core::{Device, Tensor};
use candle_nn::VarMap;

use super::checkpoint::{self, ENCODER};
use super::config::Config;
use super::metadata::Metadata;
use super::{EgoTac, init, shapes};
use crate::error::{Error, Result};
use crate::image::{Filter, Resize};

/// Channels of an attention head; the same in every published DINOv2.
const HEAD: usize = 64;
/// Tensor of published checkpoints that only their own training uses.
const MASK_TOKEN: &str = "embeddings.mask_token";

/// Geometry and seed of the rest of the network, which the encoder does not determine.
#[derive(Debug, Clone)]
pub struct InitOptions {
    /// Side of the input image, pixels.
    pub image: usize,
    /// T: frames in the observation window.
    pub horizon: usize,
    /// K: tactile steps predicted.
    pub predict: usize,
    /// Layers of the decoder.
    pub depth: usize,
    /// Seed of all parameters outside the encoder.
    pub seed: u64,
}

impl Default for InitOptions {
    fn default() -> Self {
        let Config { image, horizon, predict, depth, .. } = Config::base();
        Self { image, horizon, predict, depth, seed: 0 }
    }
}

/// Creates a network with the encoder of a published checkpoint and random parameters elsewhere. Returns geometry, metadata
/// (images prepared as the encoder was trained) and tensors.
///
/// # Errors
/// If the file can't be read, or a tensor is missing, unexpected or of a wrong shape; names each with expected and found
/// shape.
pub fn init(path: &Path, options: &InitOptions) -> Result<(Config, Metadata, BTreeMap<String, Tensor>)> {
    let mut published = checkpoint::read_tensors(path)?;
    published.remove(MASK_TOKEN);
    let config = config(path, &published, options)?;
    let encoder = |(name, shape): (String, _)| Some((name.strip_prefix(ENCODER)?.to_string(), shape));
    let expected = shapes::of_network(&config).into_iter().filter_map(encoder).collect();
    shapes::check(path, &expected, &shapes::of_tensors(&published))?;
    let vars = VarMap::new();
    EgoTac::new(&config, init::var_builder(&vars, options.seed, &Device::Cpu))?;
    let mut tensors = checkpoint::variables(&vars)?;
    tensors.retain(|name, _| !name.starts_with(ENCODER));
    tensors.extend(published.into_iter().map(|(name, tensor)| (format!("{ENCODER}{name}"), tensor)));
    let name = path.file_stem().map_or("dinov2".into(), |stem| stem.to_string_lossy().into_owned());
    let mut metadata = Metadata::new(format!("{name}, untrained around it"), 1.0, 0.04);
    metadata.resize = Resize::Centre;
    metadata.filter = Filter::Bicubic;
    metadata.has_force = false;
    metadata.training = format!("encoder of {name}; all else at its random start, seed {}", options.seed);
    Ok((config, metadata, tensors))
}

/// Derives the geometry from the shapes of the tensors.
fn config(path: &Path, tensors: &BTreeMap<String, Tensor>, options: &InitOptions) -> Result<Config> {
    let dims = |name: &str, expected: &str, rank: usize| -> Result<&[usize]> {
        let found = tensors.get(name).map(|tensor| tensor.dims());
        match found {
            Some(dims) if dims.len() == rank => Ok(dims),
            Some(dims) => Err(Error::file(path, format!("{name}: expected {expected}, found {dims:?}"))),
            None => Err(Error::file(path, format!("{name}: expected {expected}, found none"))),
        }
    };
    let vision_width = dims("embeddings.cls_token", "[1, 1, width]", 3)?[2];
    let patch = dims("embeddings.patch_embeddings.projection.weight", "[width, 3, patch, patch]", 4)?[3];
    let positions = dims("embeddings.position_embeddings", "[1, 1 + patches, width]", 3)?[1];
    let grid = positions.saturating_sub(1).isqrt();
    if grid * grid + 1 != positions {
        let found =
            format!("embeddings.position_embeddings: expected [1, 1 + a square, width], found {positions} places");
        return Err(Error::file(path, found));
    }
    let registers = match tensors.contains_key("embeddings.register_tokens") {
        true => dims("embeddings.register_tokens", "[1, registers, width]", 3)?[1],
        false => 0,
    };
    let layer = |i: usize| tensors.keys().any(|name| name.starts_with(&format!("encoder.layer.{i}.")));
    let vision_depth = (0..).take_while(|i| layer(*i)).count();
    let heads = (vision_width / HEAD).max(1);
    let config = Config {
        vision_width,
        vision_depth,
        vision_heads: heads,
        width: vision_width,
        depth: options.depth,
        heads,
        image: options.image,
        patch,
        pretrain_image: grid * patch,
        horizon: options.horizon,
        predict: options.predict,
        registers,
    };
    config.check().map_err(|error| Error::file(path, error))?;
    Ok(config)
}
