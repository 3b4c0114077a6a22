//! Names and shapes of a network's tensors, known before anything is allocated.

use std::collections::BTreeMap;
use std::path::Path;

use candle_core::Tensor;

use super::attention::Mlp;
use super::config::Config;
use super::familiarity::{self, Familiarity};
use super::presence::{self, Presence};
use super::spread::{self, Spread};
use crate::error::{Error, Result};
use crate::tactile::N_FIELD;

/// Mismatches listed in one message.
const MAX_NAMED: usize = 8;

/// Shapes of tensors by name.
pub type Shapes = BTreeMap<String, Vec<usize>>;

/// Returns the tensors of a network, under the names that its constructors ask for.
pub fn of_network(config: &Config) -> Shapes {
    let mut list = List::default();
    list.encoder(config);
    list.temporal(config);
    list.decoder(config);
    list.0
}

/// True for the name of a tensor that a checkpoint may lack, and that the network itself does not use.
pub fn is_optional(name: &str) -> bool {
    [familiarity::PREFIX, presence::PREFIX, spread::PREFIX].iter().any(|prefix| name.starts_with(prefix))
}

/// Returns the tensors of a checkpoint that has `found`: those of the network, and each group of optional tensors of which
/// one is there.
pub fn of_checkpoint(config: &Config, found: &Shapes) -> Shapes {
    let mut expected = of_network(config);
    let groups = [
        (familiarity::PREFIX, Familiarity::shapes(config.vision_width)),
        (presence::PREFIX, Presence::shapes(config.vision_width)),
        (spread::PREFIX, Spread::shapes()),
    ];
    for (prefix, shapes) in groups {
        if found.keys().any(|name| name.starts_with(prefix)) {
            expected.extend(shapes);
        }
    }
    expected
}

/// Returns the shapes of tensors.
pub fn of_tensors(tensors: &BTreeMap<String, Tensor>) -> Shapes {
    tensors.iter().map(|(name, tensor)| (name.clone(), tensor.dims().to_vec())).collect()
}

/// Returns the number of elements of all tensors.
pub fn count(shapes: &Shapes) -> u64 {
    let elements = |shape: &Vec<usize>| shape.iter().fold(1, |count: u64, size| count.saturating_mul(*size as u64));
    shapes.values().fold(0, |sum, shape| sum.saturating_add(elements(shape)))
}

/// Checks that a file has exactly the expected tensors.
///
/// # Errors
/// Lists the tensors that are missing, unexpected or of another shape, and `path` as the file.
pub fn check(path: &Path, expected: &Shapes, found: &Shapes) -> Result<()> {
    let mut mismatches = Vec::new();
    for (name, shape) in expected {
        match found.get(name) {
            Some(there) if there == shape => {}
            Some(there) => mismatches.push(format!("{name}: expected {shape:?}, found {there:?}")),
            None => mismatches.push(format!("{name}: expected {shape:?}, found none")),
        }
    }
    let unexpected = found.iter().filter(|(name, _)| !expected.contains_key(*name));
    mismatches.extend(unexpected.map(|(name, shape)| format!("{name}: expected no such tensor, found {shape:?}")));
    match mismatches.len() {
        0 => Ok(()),
        n => Err(Error::file(path, format!("{n} of the network's tensors do not fit: {}", first(&mismatches)))),
    }
}

/// Joins the first problems of a list for a message, and counts the others.
pub fn first(problems: &[String]) -> String {
    let more = match problems.len() {
        n if n > MAX_NAMED => format!("; and {} more", n - MAX_NAMED),
        _ => String::new(),
    };
    problems[..problems.len().min(MAX_NAMED)].join("; ") + &more
}

#[derive(Default)]
struct List(Shapes);

impl List {
    fn encoder(&mut self, config: &Config) {
        let (dv, patch, grid) = (config.vision_width, config.patch, config.pretrain_grid());
        self.add("encoder.embeddings.cls_token", &[1, 1, dv]);
        self.add("encoder.embeddings.position_embeddings", &[1, 1 + grid * grid, dv]);
        if config.registers > 0 {
            self.add("encoder.embeddings.register_tokens", &[1, config.registers, dv]);
        }
        self.add("encoder.embeddings.patch_embeddings.projection.weight", &[dv, 3, patch, patch]);
        self.add("encoder.embeddings.patch_embeddings.projection.bias", &[dv]);
        for layer in 0..config.vision_depth {
            let name = |part: &str| format!("encoder.encoder.layer.{layer}.{part}");
            self.norms(&["norm1", "norm2"].map(name), dv);
            let parts = ["attention.query", "attention.key", "attention.value", "output.dense"];
            self.squares(&parts.map(|part| name(&format!("attention.{part}"))), dv);
            self.mlp(&name("mlp"), dv);
            self.add(&name("layer_scale1.lambda1"), &[dv]);
            self.add(&name("layer_scale2.lambda1"), &[dv]);
        }
        self.norms(&["encoder.layernorm".into()], dv);
    }

    fn temporal(&mut self, config: &Config) {
        let d = config.width;
        let name = |part: &str| format!("temporal.{part}");
        self.linear(&name("proj"), config.vision_width, d);
        self.add(&name("step_embedding"), &[config.horizon, d]);
        self.add(&name("token"), &[1, 1, d]);
        self.norms(&["norm_q", "norm_kv", "norm_mlp", "norm_out"].map(name), d);
        self.squares(&["attn.q", "attn.k", "attn.v", "attn.out"].map(name), d);
        self.mlp(&name("mlp"), d);
    }

    fn decoder(&mut self, config: &Config) {
        let d = config.width;
        self.add("queries", &[config.predict, d]);
        for layer in 0..config.depth {
            let name = |part: &str| format!("decoder.{layer}.{part}");
            self.linear(&name("ada_attn.linear"), d, 2 * d);
            self.linear(&name("ada_mlp.linear"), d, 2 * d);
            self.squares(&["attn.q", "attn.k", "attn.v", "attn.out"].map(name), d);
            self.mlp(&name("mlp"), d);
        }
        self.norms(&["norm".into()], d);
        self.linear("force_head", d, N_FIELD);
        self.linear("contact_head", d, N_FIELD);
    }

    fn mlp(&mut self, name: &str, d: usize) {
        self.linear(&format!("{name}.fc1"), d, Mlp::EXPANSION * d);
        self.linear(&format!("{name}.fc2"), Mlp::EXPANSION * d, d);
    }

    fn squares(&mut self, names: &[String], d: usize) {
        names.iter().for_each(|name| self.linear(name, d, d));
    }

    fn norms(&mut self, names: &[String], d: usize) {
        for name in names {
            self.add(&format!("{name}.weight"), &[d]);
            self.add(&format!("{name}.bias"), &[d]);
        }
    }

    /// Adds weight and bias of a linear layer from `k` inputs to `n` outputs.
    fn linear(&mut self, name: &str, k: usize, n: usize) {
        self.add(&format!("{name}.weight"), &[n, k]);
        self.add(&format!("{name}.bias"), &[n]);
    }

    fn add(&mut self, name: &str, shape: &[usize]) {
        self.0.insert(name.to_string(), shape.to_vec());
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;
    use candle_nn::VarMap;

    use super::*;
    use crate::model::{EgoTac, init};

    #[test]
    fn the_constructors_ask_for_exactly_these_tensors() {
        let toy = Config::toy();
        let registers = Config { registers: 4, vision_width: 24, width: 40, predict: 3, ..Config::toy() };
        for config in [toy, registers, Config::pocket()] {
            let vars = VarMap::new();
            EgoTac::new(&config, init::var_builder(&vars, 0, &Device::Cpu)).unwrap();
            let vars = vars.data().lock().unwrap();
            let asked: Shapes = vars.iter().map(|(name, var)| (name.clone(), var.dims().to_vec())).collect();
            assert_eq!(asked, of_network(&config));
        }
    }
}
