//! YAML files: training, import tables, scenes, robots, the metadata of bags.

use std::collections::BTreeMap;
use std::path::Path;

#[cfg(feature = "sim")]
use egotac::Error;
use egotac::Result;
use egotac::dataset::mcap::BagWriter;
use egotac::message::{Header, Image, Message};
use egotac::model::import::Mapping;
use egotac::train::Config;
use image::RgbImage;

use super::{repository, seed};
use crate::case::Case;
use crate::mutate::{Rng, below, chance, pick, text};

/// Table of an import, after the example of its module.
const IMPORT: &str = "\
config: { vision_width: 64, vision_depth: 1, vision_heads: 1, width: 64, depth: 1, heads: 1, image: 28, patch: 14, pretrain_image: 28, horizon: 2, predict: 1 }
sidecar:
  name: theirs
  topology: mano
  force_scale: 1.7
  hand_order: right_left
  mean: [0.485, 0.456, 0.406]
  resize: crop
  fps: 30
  frame_stride: 4
tensors:
  queries: decoder.tactile_queries
  encoder.encoder.layer.{i}.norm1.weight: backbone.blocks.{i}.norm1.weight
  encoder.encoder.layer.{i}.attention.attention.query.weight: { from: backbone.blocks.{i}.attn.qkv.weight, part: [0, 3] }
same: true
ignore: [optimizer.]
";

fn changed(rng: &mut Rng, original: &str) -> Case {
    let mut changed = original.to_string();
    for _ in 0..1 + below(rng, 3) {
        changed = text::change(rng, &changed);
    }
    if chance(rng, 0.03) {
        changed = "[".repeat(*pick(rng, &[100, 10_000, 1_000_000]));
    }
    Case::File(changed.into_bytes())
}

fn file_of(rng: &mut Rng, folder: &str, end: &str) -> Case {
    let mut names: Vec<String> = std::fs::read_dir(repository(folder))
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .filter(|name| name.ends_with(end))
        .collect();
    names.sort();
    let original = seed(&format!("{folder}/{}", pick(rng, &names)));
    changed(rng, &String::from_utf8_lossy(&original))
}

/// Changes a training configuration.
pub fn train(rng: &mut Rng) -> Case {
    file_of(rng, "models", ".yaml")
}

/// Reads a training configuration and derives its geometry.
pub fn read_train(path: &Path, _scratch: &Path) -> Result<()> {
    let config = Config::read_unchecked(path)?;
    let checked = config.check();
    config.geometry()?;
    checked
}

/// Changes the table of an import.
pub fn import(rng: &mut Rng) -> Case {
    changed(rng, IMPORT)
}

/// Reads the table of an import, and applies it to a file of tensors.
pub fn read_import(path: &Path, _scratch: &Path) -> Result<()> {
    let mapping = Mapping::read(path)?;
    mapping.apply(&repository("tests/data/model/toy_0_weights.safetensors")).map(drop)
}

/// Changes `metadata.yaml` of a bag.
pub fn bag(rng: &mut Rng) -> Case {
    let mut files = bag_files().unwrap_or_else(|error| panic!("seed bag: {error}"));
    let name = "metadata.yaml".to_string();
    let original = String::from_utf8_lossy(&files[&name]).into_owned();
    if let Case::File(new) = changed(rng, &original) {
        files.insert(name, new);
    }
    Case::Folder(files)
}

fn bag_files() -> anyhow::Result<BTreeMap<String, Vec<u8>>> {
    let temp = tempfile::tempdir()?;
    let folder = temp.path().join("bag");
    let mut writer = BagWriter::create(&folder)?;
    writer.add_topic("/image", Image::TYPE, &Image::schema(), false)?;
    for index in 0..3 {
        let image = Image::from_rgb(Header::default(), &RgbImage::new(8, 8));
        writer.write("/image", &image.to_cdr(), index, index)?;
    }
    writer.finish()?;
    match Case::read(&folder)? {
        Case::Folder(files) => Ok(files),
        Case::File(_) => anyhow::bail!("a bag is a folder"),
    }
}

/// Changes a scene.
#[cfg(feature = "sim")]
pub fn scene(rng: &mut Rng) -> Case {
    file_of(rng, "sim/scenes", ".yaml")
}

/// Reads a scene.
#[cfg(feature = "sim")]
pub fn read_scene(path: &Path, _scratch: &Path) -> Result<()> {
    let path = path.to_str().ok_or_else(|| Error::file(path, "expected a path in UTF-8"))?;
    egotac::Scene::load(path).map(drop)
}

/// Changes a robot file.
#[cfg(feature = "sim")]
pub fn robot(rng: &mut Rng) -> Case {
    let name = *pick(rng, &["four_finger", "gripper", "tendon_hand"]);
    let original = seed(&format!("sim/robots/{name}.yaml"));
    changed(rng, &String::from_utf8_lossy(&original))
}

/// Reads a robot file, and derives the robot from a shipped model.
#[cfg(feature = "sim")]
pub fn read_robot(path: &Path, _scratch: &Path) -> Result<()> {
    let name = path.to_str().ok_or_else(|| Error::file(path, "expected a path in UTF-8"))?;
    egotac::retarget::Robot::load(name, Some(&repository("sim/robots/four_finger.xml"))).map(drop)
}
