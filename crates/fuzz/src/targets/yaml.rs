//! YAML files: training, import tables, scenes, robots, the metadata of bags.

use std::collections::BTreeMap;
use std::path::Path;

use candle_core::Device;
#[cfg(feature = "sim")]
use egotac::Error;
use egotac::Result;
use egotac::dataset::mcap::BagWriter;
use egotac::message::{Header, Image, Message};
use egotac::model;
use egotac::model::import::Mapping;
use egotac::train::{Config, Control, Event};
use image::RgbImage;

use super::{repository, seed};
use crate::case::Case;
use crate::mutate::{Rng, below, chance, pick, text};

/// Training configuration with all keys; STORE and OUT stand for a store of the tests and an output.
const TRAIN: &str = "\
name: fuzz
data:
- STORE
- { stores: [STORE], quota: 0.25, mirror: true, labels: contact }
sampling: { temperature: 0.5, epoch: 16 }
validation: [STORE]
out: OUT
model: { vision_width: 16, vision_depth: 1, vision_heads: 2, width: 16, depth: 1, heads: 2, image: 28, patch: 14, pretrain_image: 28, horizon: 2, predict: 1 }
seed: 3
frame_dt: 0.04
precision: f32
steps: 2
batch: { clips: 2, windows: 2, accumulate: 1 }
optimizer: { learning_rate: 1e-3, final_learning_rate: 1e-5, encoder_factor: 0.5, warmup: 0.05, weight_decay: 1e-5, max_grad_norm: 5.0 }
loss: { force: 1.0, contact: 1.0, active: 0.2, consistency: 0.05, keypoints: 0.0, positive_weight: 2.0 }
augment: { brightness: 0.2, contrast: 0.2, saturation: 0.2, hue: 0.1, crop: 0.1, view_scale: 0.1, view_scale_probability: 0.8, mirror: 0.5 }
ema: 0.9
save_every: 1
validate_every: 1
threads: 1
in_memory: true
";
/// Largest geometry that is trained: the preset `toy` of the library has a side of 56 pixels.
const LARGEST_SIDE: usize = 56;
/// Largest number of channels and layers that is trained.
const LARGEST_WIDTH: usize = 64;

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

/// Changes a training configuration: one with all keys, or one of the shipped ones.
pub fn train(rng: &mut Rng) -> Case {
    match chance(rng, 0.8) {
        true => changed(rng, TRAIN),
        false => file_of(rng, "models", ".yaml"),
    }
}

/// Reads a training configuration, checks it, and takes a step if it asks for a small network and batch.
pub fn read_train(path: &Path, scratch: &Path) -> Result<()> {
    let mut config = Config::read_unchecked(path)?;
    for store in config.data.iter_mut().flat_map(|source| &mut source.stores).chain(&mut config.validation) {
        if store.as_os_str() == "STORE" {
            *store = repository("tests/data/zarr/python.zarr");
        }
    }
    let checked = config.check();
    let geometry = config.geometry()?;
    checked?;
    let model::Config { vision_width, vision_depth, width, depth, image, horizon, .. } = geometry;
    let is_small = [vision_width, vision_depth, width, depth].iter().all(|size| *size <= LARGEST_WIDTH)
        && image <= LARGEST_SIDE
        && horizon <= 8
        && config.batch.clips * config.batch.windows * config.batch.accumulate <= 64
        && config.threads <= 4;
    if !is_small {
        return Ok(());
    }
    config.out = scratch.join("run");
    let mut stop = |event: Event| if matches!(event, Event::Stepped(_)) { Control::Stop } else { Control::Continue };
    egotac::train::train(&config, false, &Device::Cpu, &mut stop).map(drop)
}

/// Changes the table of an import.
pub fn import(rng: &mut Rng) -> Case {
    let original = seed("tests/data/model/foreign.yaml");
    changed(rng, &String::from_utf8_lossy(&original))
}

/// Reads the table of an import, and applies it to another program's network.
pub fn read_import(path: &Path, _scratch: &Path) -> Result<()> {
    let mapping = Mapping::read(path)?;
    mapping.apply(&repository("tests/data/model/foreign.pth")).map(drop)
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
