//! Readers that take hostile inputs, each with the generator of its inputs.

mod cdr;
mod hand;
mod image;
mod lerobot;
mod mcap;
#[cfg(feature = "sim")]
mod model;
mod weights;
mod yaml;
mod zarr;

use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock};

use candle_core::Device;
use candle_nn::VarMap;
use egotac::dataset::{Labelled, Provenance};
use egotac::label::{FormatOptions, Job, LabelTiming, Outcome, Shard, find_tasks};
use egotac::model::predictor::Options;
use egotac::model::{Checkpoint, Config, EgoTac, Metadata, Precision, init};
use egotac::{Error, Predictor, Result};

use crate::case::Case;
use crate::mutate::Rng;

/// A reader under test.
pub struct Target {
    /// Name, also of its folder of regressions.
    pub name: &'static str,
    /// Name of the input's file or folder; readers choose the format by its ending.
    pub file: &'static str,
    /// Makes an input.
    pub make: fn(&mut Rng) -> Case,
    /// Reads the input as the commands do; the second path is a folder for output.
    pub read: fn(&Path, &Path) -> Result<()>,
    /// Number of inputs of the short form: six seconds of a 2.8 GHz core at most.
    pub short: u64,
}

/// All targets of this build.
pub const TARGETS: &[Target] = &[
    Target { name: "pickle", file: "hand.pkl", make: hand::pickle, read: hand::read, short: 400 },
    Target { name: "npz", file: "hand.npz", make: hand::npz, read: hand::read, short: 100 },
    Target { name: "safetensors", file: "a.safetensors", make: weights::safetensors, read: weights::read, short: 4000 },
    Target { name: "pt", file: "a.pt", make: weights::pt, read: weights::read, short: 2000 },
    Target { name: "mcap", file: "a.mcap", make: mcap::file, read: label, short: 400 },
    Target { name: "cdr", file: "a.cdr", make: cdr::make, read: cdr::read, short: 10000 },
    Target { name: "image_raw", file: "a.raw", make: image::raw, read: image::read_raw, short: 8000 },
    Target { name: "image_file", file: "a.img", make: image::file, read: image::read_file, short: 1500 },
    Target { name: "zarr", file: "a.zarr", make: zarr::make, read: zarr::read, short: 80 },
    Target { name: "lerobot", file: "a", make: lerobot::make, read: lerobot::read, short: 150 },
    Target { name: "yaml_train", file: "train.yaml", make: yaml::train, read: yaml::read_train, short: 400 },
    Target { name: "yaml_import", file: "import.yaml", make: yaml::import, read: yaml::read_import, short: 400 },
    Target { name: "yaml_bag", file: "bag", make: yaml::bag, read: label, short: 200 },
    #[cfg(feature = "sim")]
    Target { name: "yaml_scene", file: "scene.yaml", make: yaml::scene, read: yaml::read_scene, short: 4000 },
    #[cfg(feature = "sim")]
    Target { name: "yaml_robot", file: "robot.yaml", make: yaml::robot, read: yaml::read_robot, short: 100 },
    #[cfg(feature = "sim")]
    Target { name: "mjcf", file: "robot.xml", make: model::mjcf, read: model::read, short: 80 },
    #[cfg(feature = "sim")]
    Target { name: "urdf", file: "robot.urdf", make: model::urdf, read: model::read, short: 200 },
];

/// Returns the path of a file of the repository.
fn repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(path)
}

/// Reads a file of the repository; generators start from it.
///
/// # Panics
/// If it is missing: the program runs in the repository that it was built from.
fn seed(path: &str) -> Vec<u8> {
    let path = repository(path);
    std::fs::read(&path).unwrap_or_else(|error| panic!("seed {}: {error}", path.display()))
}

/// Labels a recording with a small network, as `egotac label` does, and reads the result back.
///
/// # Panics
/// If a finished output can't be read although its summary names no damage of the input: an output must be valid or absent.
fn label(input: &Path, scratch: &Path) -> Result<()> {
    label_camera(input, scratch, None)
}

/// As [`label`], with the images of this camera.
fn label_camera(input: &Path, scratch: &Path, camera: Option<&str>) -> Result<()> {
    let mut predictor = predictor().lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    let frame_dt = predictor.metadata().frame_dt;
    let options = FormatOptions {
        frame_dt,
        side: Some(32),
        camera: camera.map(str::to_string),
        prefix: Some("tactile".into()),
        labels_topic: Some("/tactile".into()),
        ..FormatOptions::default()
    };
    let mut found = find_tasks(input, &scratch.join("out"), &options)?;
    if let Some((_, error)) = found.unreadable.pop() {
        return Err(error);
    }
    for task in &found.tasks {
        let job = Job {
            source: task.source.as_ref(),
            output: task.output.as_ref(),
            out: task.out.clone(),
            provenance: Provenance::of(&predictor, Precision::F32, task.description.clone()),
            decoders: 1,
        };
        let shard = Shard { index: 0, of: 1 };
        match job.run(&mut predictor, shard, 0, &mut LabelTiming::default(), &mut || {}) {
            Ok(Outcome::Done(info)) if info.summary.counts.frames > 0 => {
                let back = Labelled::read(&task.out).map(drop).map_err(|error| error.to_string());
                let is_named = !info.summary.lost.is_empty();
                assert!(is_named || back.is_ok(), "the finished output can't be read back: {back:?}");
            }
            Ok(_) => {}
            Err(error) => {
                assert!(!task.out.exists(), "a failed job left an output: {error}");
                return Err(error);
            }
        }
    }
    Ok(())
}

/// Returns a network of the smallest preset with random weights.
fn predictor() -> &'static Mutex<Predictor> {
    static PREDICTOR: OnceLock<Mutex<Predictor>> = OnceLock::new();
    PREDICTOR.get_or_init(|| {
        let create = || -> Result<Predictor> {
            let folder = tempfile::tempdir().map_err(Error::io("temporary folder"))?;
            let path = folder.path().join("toy.safetensors");
            let (config, vars) = (Config::toy(), VarMap::new());
            EgoTac::new(&config, init::var_builder(&vars, 1, &Device::Cpu))?;
            Checkpoint::save(&path, &config, &Metadata::new("toy", 1.0, 0.04), &vars)?;
            Predictor::load(&path, Options::default())
        };
        Mutex::new(create().unwrap_or_else(|error| panic!("the network of the fuzz targets: {error}")))
    })
}
