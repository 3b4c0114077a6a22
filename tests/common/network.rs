//! Small networks with random weights, saved as checkpoints.

use std::collections::BTreeMap;
use std::path::Path;

use candle_core::{Device, Tensor};
use candle_nn::VarMap;
use egotac::model::{Checkpoint, Config, EgoTac, Metadata, checkpoint, init};

/// Saves a network of this geometry with random weights, beside them `further` tensors; returns all its tensors. Without them it is
/// at `path` with the extension `bare`.
pub fn save(path: &Path, config: &Config, further: BTreeMap<String, Tensor>) -> BTreeMap<String, Tensor> {
    let vars = VarMap::new();
    EgoTac::new(config, init::var_builder(&vars, 3, &Device::Cpu)).unwrap();
    let metadata = Metadata::new("toy", 1.0, 0.04);
    let bare = path.with_extension("bare");
    Checkpoint::save(&bare, config, &metadata, &vars).unwrap();
    let (_, _, mut tensors) = checkpoint::load_tensors(&bare).unwrap();
    tensors.extend(further);
    Checkpoint::save_tensors(path, config, &metadata, &tensors).unwrap();
    tensors
}
