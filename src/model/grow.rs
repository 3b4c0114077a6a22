//! Growth of a trained network: wider fusion and decoder, more layers, the same function at first.
//!
//! Width grows as in Net2Net (Chen et al., 2016): channels are copied, and each weight that reads a channel is divided among
//! its copies. The shares are uneven, so that the copies learn different things. Depth grows by copies of layers whose
//! contribution starts at zero.

use std::collections::BTreeMap;
use std::path::Path;

use candle_core::{Device, Tensor};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::attention::Mlp;
use super::checkpoint::{self, ENCODER};
use super::config::Config;
use super::shapes;
use crate::error::{Error, Result};

/// Unevenness of the shares of a weight: standard deviation of a copy's difference from an equal share, relative to that of
/// the layer's weights.
const UNEVEN: f32 = 0.5;

/// Sizes of the grown network; none may be less than that of the original.
#[derive(Debug, Clone)]
pub struct Growth {
    /// d: width of temporal fusion and decoder. Attention heads keep their channels; their number grows.
    pub width: usize,
    /// Layers of the vision encoder.
    pub vision_depth: usize,
    /// Layers of the decoder.
    pub depth: usize,
    /// Seed of the choice of copied channels, where not all are copied, and of the shares of weights.
    pub seed: u64,
}

/// Grows a network. Returns its new geometry and tensors. `path` is the file that errors name.
///
/// If `width` is a multiple of the old width, the new network is the same function up to rounding. Otherwise some channels
/// have one copy more than others, which changes the statistics of layer norms, and the function is only close to the old.
///
/// # Errors
/// If a size is less than the original, the width does not fit the heads, or the tensors are not those of `config`.
pub fn grow(
    path: &Path,
    config: &Config,
    tensors: &BTreeMap<String, Tensor>,
    growth: &Growth,
) -> Result<(Config, BTreeMap<String, Tensor>)> {
    let head = config.width / config.heads;
    let sizes = [
        ("width", config.width, growth.width),
        ("vision_depth", config.vision_depth, growth.vision_depth),
        ("depth", config.depth, growth.depth),
    ];
    for (name, own, wanted) in sizes {
        if wanted < own {
            return Err(Error::value(name, format!("at least the {own} of {}", path.display()), wanted));
        }
    }
    if !growth.width.is_multiple_of(head) {
        return Err(Error::value("width", format!("a multiple of the heads' {head} channels"), growth.width));
    }
    let grown = Config {
        width: growth.width,
        heads: growth.width / head,
        vision_depth: growth.vision_depth,
        depth: growth.depth,
        ..config.clone()
    };
    grown.check()?;
    checkpoint::check(path, config, tensors)?;

    let mut random = ChaCha8Rng::seed_from_u64(growth.seed);
    let copies = Copies::new(config, &grown, &mut random);
    let mut wide = BTreeMap::new();
    // The features that optional tensors are about are those of the encoder, whose width stays.
    let keeps = |name: &str| name.starts_with(ENCODER) || shapes::is_optional(name);
    for (name, tensor) in tensors {
        let tensor = if keeps(name) { tensor.clone() } else { copies.widen(name, tensor, &mut random)? };
        wide.insert(name.clone(), tensor);
    }
    let scales = |name: &str| name.contains(".layer_scale");
    let outputs = |name: &str| name.contains(".attn.out.") || name.contains(".mlp.fc2.");
    let deep = deepen(wide, &format!("{ENCODER}encoder.layer."), config.vision_depth, grown.vision_depth, scales)?;
    let deep = deepen(deep, "decoder.", config.depth, grown.depth, outputs)?;
    checkpoint::check(path, &grown, &deep)?;
    Ok((grown, deep))
}

/// For each index along an axis of the grown network, the index in the original that it copies.
struct Copies {
    /// Channels of the residual stream.
    width: Vec<usize>,
    /// Channels inside attention, by whole heads.
    heads: Vec<usize>,
    /// Channels of the hidden layer of an MLP.
    hidden: Vec<usize>,
    /// Outputs of AdaLN: scales, then shifts.
    pairs: Vec<usize>,
}

impl Copies {
    fn new(config: &Config, grown: &Config, random: &mut impl Rng) -> Self {
        let head = config.width / config.heads;
        let width = cycle(config.width, grown.width, random);
        let heads = cycle(config.heads, grown.heads, random);
        Self {
            heads: heads.iter().flat_map(|h| h * head..(h + 1) * head).collect(),
            hidden: cycle(Mlp::EXPANSION * config.width, Mlp::EXPANSION * grown.width, random),
            pairs: width.iter().copied().chain(width.iter().map(|i| config.width + i)).collect(),
            width,
        }
    }

    /// Widens a tensor outside the encoder.
    fn widen(&self, name: &str, tensor: &Tensor, random: &mut impl Rng) -> Result<Tensor> {
        let has = |parts: &[&str]| parts.iter().any(|part| name.contains(part));
        // Indices of the outputs and of the inputs of a linear layer; None where they do not grow.
        let (writes, reads) = if has(&[".ada_attn.", ".ada_mlp."]) {
            (Some(&self.pairs), Some(&self.width))
        } else if has(&[".attn.q.", ".attn.k.", ".attn.v."]) {
            (Some(&self.heads), Some(&self.width))
        } else if has(&[".attn.out."]) {
            (Some(&self.width), Some(&self.heads))
        } else if has(&[".mlp.fc1."]) {
            (Some(&self.hidden), Some(&self.width))
        } else if has(&[".mlp.fc2."]) {
            (Some(&self.width), Some(&self.hidden))
        } else if has(&["force_head.", "contact_head."]) {
            (None, Some(&self.width))
        } else if has(&["temporal.proj."]) {
            (Some(&self.width), None)
        } else {
            // Tensors that are added to the residual stream, or multiply it, channel by channel.
            return select(tensor, tensor.rank() - 1, &self.width);
        };
        let rows = writes.map_or(Ok(tensor.clone()), |places| select(tensor, 0, places))?;
        match reads {
            Some(places) if tensor.rank() == 2 => share(&rows, places, random),
            _ => Ok(rows),
        }
    }
}

/// Repeats indices 0 .. `own` up to `wanted`: all of them as often as they fit, then a random sample of them.
fn cycle(own: usize, wanted: usize, random: &mut impl Rng) -> Vec<usize> {
    let mut rest = rand::seq::index::sample(random, own, wanted % own).into_vec();
    rest.sort_unstable();
    (0..wanted / own).flat_map(|_| 0..own).chain(rest).collect()
}

fn select(tensor: &Tensor, dim: usize, places: &[usize]) -> Result<Tensor> {
    let places: Vec<u32> = places.iter().map(|place| *place as u32).collect();
    Ok(tensor.index_select(&Tensor::new(places, &Device::Cpu)?, dim)?)
}

/// Divides the weight (out, in) of a linear layer among copies of its inputs: the weights of all copies add up to the old.
fn share(weight: &Tensor, places: &[usize], random: &mut impl Rng) -> Result<Tensor> {
    let rows = weight.to_vec2::<f32>()?;
    let (out, own) = weight.dims2()?;
    let spread = UNEVEN * (weight.sqr()?.mean_all()?.to_scalar::<f32>()?).sqrt();
    let mut count = vec![0_f32; own];
    places.iter().for_each(|place| count[*place] += 1.0);
    let mut values = Vec::with_capacity(out * places.len());
    for row in rows {
        let mut draw = || -> f32 { StandardNormal.sample(random) };
        let uneven: Vec<f32> = places.iter().map(|_| spread * draw()).collect();
        let mut mean = vec![0_f32; own];
        places.iter().zip(&uneven).for_each(|(place, value)| mean[*place] += value / count[*place]);
        values.extend(places.iter().zip(&uneven).map(|(i, value)| row[*i] / count[*i] + (value - mean[*i])));
    }
    Ok(Tensor::from_vec(values, (out, places.len()), &Device::Cpu)?)
}

/// Inserts copies of layers `PREFIX0.` to `PREFIX(own - 1).`, evenly spread, each after its original, until there are
/// `wanted`. Tensors of a copy for which `silent` is true are zero, so that the copy adds nothing yet.
fn deepen(
    tensors: BTreeMap<String, Tensor>,
    prefix: &str,
    own: usize,
    wanted: usize,
    silent: impl Fn(&str) -> bool,
) -> Result<BTreeMap<String, Tensor>> {
    let added = wanted - own;
    let after: Vec<usize> = (1..=added).map(|k| (k * own).div_ceil(added) - 1).collect();
    let mut sources = Vec::new();
    for layer in 0..own {
        sources.push((layer, false));
        sources.extend(after.iter().filter(|place| **place == layer).map(|_| (layer, true)));
    }
    let mut deep = BTreeMap::new();
    for (name, tensor) in tensors {
        let parts = name.strip_prefix(prefix).and_then(|rest| rest.split_once('.'));
        let Some((layer, rest)) = parts.and_then(|(layer, rest)| Some((layer.parse::<usize>().ok()?, rest))) else {
            deep.insert(name, tensor);
            continue;
        };
        for (place, (_, copy)) in sources.iter().enumerate().filter(|(_, (source, _))| *source == layer) {
            let tensor = if *copy && silent(&name) { tensor.zeros_like()? } else { tensor.clone() };
            deep.insert(format!("{prefix}{place}.{rest}"), tensor);
        }
    }
    Ok(deep)
}
