//! Growing a trained network: a wider fusion and decoder, more layers, and at first the same function.
//!
//! Wider as in Net2Net (Chen et al., 2016): channels are copied, and what reads them shares its weights out among the
//! copies, unevenly, so that the copies learn apart. Deeper: a copied layer whose contribution begins at zero.

use std::collections::BTreeMap;
use std::path::Path;

use candle_core::{Device, Tensor};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::attention::Mlp;
use super::checkpoint::{self, ENCODER};
use super::config::Config;
use crate::error::{Error, Result};

/// How unevenly copies share a weight: standard deviation of what one has beyond its share, over that of the layer's weights.
const UNEVEN: f32 = 0.5;

/// What a network grows to; none of it may be less than what the network has.
#[derive(Debug, Clone)]
pub struct Growth {
    /// d: width of temporal fusion and decoder. Heads keep their channels, so that there are more of them.
    pub width: usize,
    /// Layers of the vision encoder.
    pub vision_depth: usize,
    /// Layers of the decoder.
    pub depth: usize,
    /// Seed of which channels are copied where not all are, and of how the copies share weights.
    pub seed: u64,
}

/// The grown geometry and tensors of a network, `path` being its home in errors.
///
/// The new network is the same function up to rounding where `width` is a multiple of the old one. Elsewhere some channels
/// have one copy more than others, which shifts what layer normalisation sees, and the function is close to the old one only.
///
/// # Errors
/// If `growth` is less than the network in anything, its width does not fit the heads, or the tensors are not those of
/// `config`.
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
    for (name, tensor) in tensors {
        let tensor =
            if name.starts_with(ENCODER) { tensor.clone() } else { copies.widen(name, tensor, &mut random)? };
        wide.insert(name.clone(), tensor);
    }
    let scales = |name: &str| name.contains(".layer_scale");
    let outputs = |name: &str| name.contains(".attn.out.") || name.contains(".mlp.fc2.");
    let deep = deepen(wide, &format!("{ENCODER}encoder.layer."), config.vision_depth, grown.vision_depth, scales)?;
    let deep = deepen(deep, "decoder.", config.depth, grown.depth, outputs)?;
    checkpoint::check(path, &grown, &deep)?;
    Ok((grown, deep))
}

/// For each place along an axis of the grown network, the place in the old one that it is a copy of.
struct Copies {
    /// Of the residual stream.
    width: Vec<usize>,
    /// Of the channels inside of attention: whole heads.
    heads: Vec<usize>,
    /// Of the hidden layer of a perceptron.
    hidden: Vec<usize>,
    /// Of AdaLN's scales, then shifts.
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

    /// A tensor outside of the encoder, as the grown network has it.
    fn widen(&self, name: &str, tensor: &Tensor, random: &mut impl Rng) -> Result<Tensor> {
        let has = |parts: &[&str]| parts.iter().any(|part| name.contains(part));
        // Places that a linear layer writes, and those that it reads; none where they do not grow.
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
            // What is added to the stream or multiplies it, channel by channel.
            return select(tensor, tensor.rank() - 1, &self.width);
        };
        let rows = writes.map_or(Ok(tensor.clone()), |places| select(tensor, 0, places))?;
        match reads {
            Some(places) if tensor.rank() == 2 => share(&rows, places, random),
            _ => Ok(rows),
        }
    }
}

/// Copies of `own` places up to `wanted`: all of them as often as they fit, and as many others, drawn at random, as are left.
fn cycle(own: usize, wanted: usize, random: &mut impl Rng) -> Vec<usize> {
    let mut rest = rand::seq::index::sample(random, own, wanted % own).into_vec();
    rest.sort_unstable();
    (0..wanted / own).flat_map(|_| 0..own).chain(rest).collect()
}

fn select(tensor: &Tensor, dim: usize, places: &[usize]) -> Result<Tensor> {
    let places: Vec<u32> = places.iter().map(|place| *place as u32).collect();
    Ok(tensor.index_select(&Tensor::new(places, &Device::Cpu)?, dim)?)
}

/// The weight (out, in) of a linear layer whose inputs are copies: the copies' weights add up to the old one's.
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

/// Layers `PREFIX0.` to `PREFIX(own - 1).` with as many copies between them as are wanted, evenly spread, each after the layer
/// that it is a copy of; a copy's tensors for which `silent` holds are zero, so that it adds nothing yet.
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
