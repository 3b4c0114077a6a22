//! Helpers shared by several test files; each file uses a part of them.
#![allow(dead_code)]

pub mod network;
pub mod store;

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use candle_core::{DType, Device, Tensor};
use candle_nn::VarMap;
use egotac::hand::Topology;
use egotac::model::{Checkpoint, Config, EgoTac, Metadata, Presence, checkpoint, init};
use egotac::tactile::TactileField;
use image::{Rgb, RgbImage};

/// Runs `egotac` with these arguments.
pub fn egotac(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_egotac")).args(arguments).output().unwrap()
}

/// Runs `egotac` with 1.5 GB of address space, and a minute as a guard against hangs.
pub fn egotac_bounded(arguments: &[&str]) -> Output {
    let limited = "ulimit -v 1500000; exec timeout -k 5 60 \"$@\"";
    Command::new("sh").args(["-c", limited, "sh", env!("CARGO_BIN_EXE_egotac")]).args(arguments).output().unwrap()
}

/// Checks that `egotac`, within the bounds of [`egotac_bounded`], ends with status 1 and one line that contains `word`: no
/// signal, no panic, no time-out. Returns the line.
pub fn refused(arguments: &[&str], word: &str) -> String {
    let output = egotac_bounded(arguments);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    // A warning may come first.
    let error: String = error.split_inclusive('\n').filter(|line| !line.starts_with("warning: ")).collect();
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {:?} {error}", output.status);
    assert!(error.contains(word) && error.lines().count() == 1, "{arguments:?}: {word:?} is not in: {error}");
    assert!(error.len() < 4000, "{arguments:?}: a message of {} bytes", error.len());
    error
}

/// Saves a toy network at `path` whose presence is 1 for each hand that `present` names, and 0 for the other, whatever the image.
/// Positions of keypoints depend on the image; touch does not, because the heads of a new network are zero.
pub fn save_network_with_presence(path: &Path, present: [bool; 2]) {
    let config = Config::toy();
    let vars = VarMap::new();
    EgoTac::new(&config, init::var_builder(&vars, 3, &Device::Cpu)).unwrap();
    let metadata = Metadata::new("toy", 1.0, 0.04);
    Checkpoint::save(path, &config, &metadata, &vars).unwrap();
    let (_, _, mut tensors) = checkpoint::load_tensors(path).unwrap();
    for (name, shape) in Presence::shapes(config.vision_width) {
        let tensor = match name.as_str() {
            "presence.hand.bias" => {
                Tensor::new(&present.map(|present| if present { 100f32 } else { -100.0 }), &Device::Cpu)
            }
            "presence.hand.weight" => Tensor::zeros(shape, DType::F32, &Device::Cpu),
            _ => Tensor::randn(0f32, 0.2, shape, &Device::Cpu),
        };
        tensors.insert(name, tensor.unwrap());
    }
    Checkpoint::save_tensors(path, &config, &metadata, &tensors).unwrap();
}

/// Returns the path of a file of `tests/data/hand`.
pub fn hand_data(name: &str) -> PathBuf {
    data("hand", name.as_ref())
}

/// Returns the path of a file of `tests/data/model`.
pub fn model_data(name: impl AsRef<Path>) -> PathBuf {
    data("model", name.as_ref())
}

fn data(folder: &str, name: &Path) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(folder).join(name)
}

/// Returns the relative L2 error of a tensor.
pub fn relative_error(got: &Tensor, want: &Tensor) -> f64 {
    assert_eq!(got.dims(), want.dims());
    let norm = |tensor: &Tensor| -> f64 {
        let values = tensor.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        values.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt()
    };
    norm(&(got - want).unwrap()) / norm(want)
}

/// Largest memory of a command, kB: 1 GB beyond what it needs for its work.
pub const MEMORY_KB: u64 = 1_300_000;
/// Time after which a command counts as hung; no measure of its speed.
const HUNG: Duration = Duration::from_secs(120);

/// Result of a command: status (None = killed by a signal), both outputs, and its largest memory, kB.
pub struct Ran {
    pub status: Option<i32>,
    pub text: String,
    pub memory_kb: u64,
}

/// Runs `egotac` and measures its memory.
pub fn measured(arguments: &[&str]) -> Ran {
    let folder = tempfile::tempdir().unwrap();
    let to = folder.path().join("text");
    let out = File::create(&to).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_egotac"));
    command.args(arguments).stdin(Stdio::null()).stdout(out.try_clone().unwrap()).stderr(out);
    let mut child = command.spawn().unwrap();
    let (started, mut memory_kb) = (Instant::now(), 0);
    let status = loop {
        let status = fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
        let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        memory_kb = memory_kb.max(peak.map_or(0, |kb| kb.trim().trim_end_matches(" kB").parse().unwrap()));
        if let Some(status) = child.try_wait().unwrap() {
            break status.code();
        }
        if started.elapsed() > HUNG || memory_kb > 4 * MEMORY_KB {
            child.kill().unwrap();
            child.wait().unwrap();
            break None;
        }
        std::thread::sleep(Duration::from_millis(2));
    };
    Ran { status, text: fs::read_to_string(&to).unwrap(), memory_kb }
}

/// Checks that a command fails by itself, names `word` and stays small.
pub fn refused_small(arguments: &[&str], word: &str) {
    let Ran { status, text, memory_kb } = measured(arguments);
    assert!(matches!(status, Some(1 | 3)), "{arguments:?}: {status:?} {text}");
    assert!(text.contains(word) && !text.contains("panicked"), "{word} is not in: {text}");
    assert!(memory_kb < MEMORY_KB, "{arguments:?}: {memory_kb} kB");
}

/// Writes an intact store of four frames.
pub fn small_store(path: &Path) {
    store::write_plain_store(path, &[4], 0.04, |index| {
        let image = RgbImage::from_fn(60, 40, |x, y| Rgb([10 * index as u8 + x as u8, y as u8, 200 - x as u8]));
        (image, TactileField::zeros(Topology::EgotacHand1))
    });
}
