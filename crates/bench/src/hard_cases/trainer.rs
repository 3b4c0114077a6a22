//! Training: non-finite values in its inputs and in a step.

use std::path::Path;

use ::image::RgbImage;
use candle_core::{Device, Tensor, Var};
use candle_nn::VarMap;
use egotac::dataset::zarr::{Compression, Contact, ZarrReader, ZarrWriter};
use egotac::dataset::{Attributes, EpisodeWriter, Frame};
use egotac::error::{Error, Result};
use egotac::hand::Topology;
use egotac::model::{Config as Geometry, Metadata};
use egotac::tactile::{N_FIELD, TactileField, Validity};
use egotac::train::{self, data::Dataset, loss, optimizer::AdamW};

use super::{Family, HardCase, Outcome, accepted};

pub(super) const CASES: &[HardCase] = &[
    Family::Training.case(
        "training_config",
        "a configuration with .nan or .inf in any number",
        "numbers within the ranges that the error names",
        config,
    ),
    Family::Training.case(
        "training_store",
        "a store with NaN, infinity or two equal values among its timestamps",
        "increasing seconds",
        store,
    ),
    Family::Training.case(
        "store_writer",
        "frames with a non-finite stamp, or infinite or negative force, written to a store",
        "numbers",
        writer,
    ),
    Family::Training.case("logit_1e30", "contact logits from -1e30 to 1e30 in the loss", "none needed", logits),
    Family::Training.case(
        "gradient_not_finite",
        "a batch whose gradient is NaN or infinite",
        "a finite gradient",
        gradient,
    ),
];

/// Training configuration whose numbers are replaced in turn.
const YAML: &str = include_str!("../../../../models/egotac.yaml");

fn config() -> Result<Outcome> {
    let folder = tempfile::tempdir().map_err(Error::io(std::env::temp_dir()))?;
    let store = folder.path().join("a.zarr");
    std::fs::create_dir(&store).map_err(Error::io(&store))?;
    let named = YAML.replace("train.zarr", &store.to_string_lossy()).replace("val.zarr", &store.to_string_lossy());
    let file = folder.path().join("config.yaml");
    let read = |text: &str| {
        std::fs::write(&file, text).map_err(Error::io(&file))?;
        train::Config::read(&file)
    };
    let mut bad = Vec::new();
    for (at, line) in named.lines().enumerate() {
        for (from, number) in numbers(line) {
            for word in [".nan", ".inf"] {
                let spoilt = format!("{}{word}{}", &line[..from], &line[from + number.len()..]);
                let text = named.lines().enumerate().map(|(n, old)| if n == at { &spoilt } else { old });
                bad.push(read(&text.collect::<Vec<_>>().join("\n")));
            }
        }
    }
    if bad.len() < 20 {
        return Err(Error::value("numbers in the configuration", "a dozen", bad.len() / 2));
    }
    Ok(Outcome::of_refusals("non-finite values accepted", accepted(bad), read(&named)))
}

/// Finds the numbers of a line of YAML, each after `: `, with their positions.
fn numbers(line: &str) -> Vec<(usize, &str)> {
    let starts = line.match_indices(": ").map(|(at, _)| at + 2);
    starts
        .filter_map(|from| {
            let word = line[from..].split([',', ' ', '}']).next()?;
            word.parse::<f64>().is_ok().then_some((from, word))
        })
        .collect()
}

fn frame(timestamp: f64, force: f32) -> Frame {
    let mut field = TactileField::zeros(Topology::EgotacHand1);
    field.force[7] = force;
    Frame {
        timestamp,
        camera_ego_rgb: RgbImage::new(8, 8),
        field,
        force_valid: vec![1; N_FIELD],
        contact_valid: vec![1; N_FIELD],
        validity: Validity::Valid,
        left_hand_pose: None,
        right_hand_pose: None,
    }
}

fn empty_store(path: &Path) -> Result<ZarrWriter> {
    let attributes = Attributes {
        topology: Topology::EgotacHand1,
        sigma: 0.0,
        contact_force: 0.05,
        producer: String::new(),
        version: String::new(),
        scene: String::new(),
        seed: 0,
    };
    Ok(ZarrWriter::create(path, attributes, Contact::Truth, vec![])?.with_compression(Compression::None))
}

/// Opens stores as another program may write them: the file of the timestamps is replaced.
fn store() -> Result<Outcome> {
    let folder = tempfile::tempdir().map_err(Error::io(std::env::temp_dir()))?;
    let with = |name: &str, stamps: [f64; 3]| {
        let path = folder.path().join(name);
        let mut writer = empty_store(&path)?;
        (0..3).try_for_each(|at| writer.push(frame(f64::from(at), 0.0)))?;
        writer.end_episode()?;
        writer.finish()?;
        let chunk = path.join("data/timestamps/0");
        let bytes: Vec<u8> = stamps.iter().flat_map(|stamp| stamp.to_le_bytes()).collect();
        std::fs::write(&chunk, bytes).map_err(Error::io(&chunk))?;
        let preparation = Metadata::new("toy", 1.0, 0.1).preparation(&Geometry::toy());
        Dataset::new(vec![ZarrReader::open(&path)?], preparation, false)
    };
    let bad = [
        with("nan", [0.0, f64::NAN, 2.0]),
        with("first", [f64::NAN, 1.0, 2.0]),
        with("infinite", [0.0, 1.0, f64::INFINITY]),
        with("standstill", [0.0, 1.0, 1.0]),
    ];
    Ok(Outcome::of_refusals("stores accepted", accepted(bad), with("good", [0.0, 1.0, 2.0])))
}

fn writer() -> Result<Outcome> {
    let folder = tempfile::tempdir().map_err(Error::io(std::env::temp_dir()))?;
    let with = |timestamp: f64, force: f32| empty_store(&folder.path().join("a"))?.push(frame(timestamp, force));
    let bad = [(f64::NAN, 0.0), (f64::INFINITY, 0.0), (0.0, f32::INFINITY), (0.0, -1.0)];
    Ok(Outcome::of_refusals("frames accepted", accepted(bad.map(|(stamp, force)| with(stamp, force))), with(0.0, 1.0)))
}

/// Compares loss and slope with the same formulas in f64.
fn logits() -> Result<Outcome> {
    const WEIGHT: f64 = 2.0;
    let sizes = [0.0, 1e-30, 1.0, 20.0, 80.0, 90.0, 1e3, 1e30f32];
    let logits: Vec<f32> = sizes.iter().flat_map(|x| [*x, -x]).collect();
    let var = Var::from_slice(&logits, logits.len(), &Device::Cpu)?;
    let mut worst: f64 = 0.0;
    for label in [0.0f32, 1.0] {
        let target = Tensor::full(label, logits.len(), &Device::Cpu)?;
        let each = loss::bce_with_logits(var.as_tensor(), &target, WEIGHT)?;
        let gradient = each.sum_all()?.backward()?;
        let gradient = gradient.get(&var).map(|g| g.to_vec1::<f32>()).transpose()?.unwrap_or_default();
        for ((got, slope), x) in each.to_vec1::<f32>()?.iter().zip(gradient).zip(&logits) {
            let x = f64::from(*x);
            // -ln sigmoid(x) and its slope
            let (positive, sigmoid) = ((-x).max(0.0) + (-x.abs()).exp().ln_1p(), 1.0 / (1.0 + (-x).exp()));
            let (exact, exact_slope) = match label {
                1.0 => (WEIGHT * positive, WEIGHT * (sigmoid - 1.0)),
                _ => (positive + x, sigmoid),
            };
            worst = worst.max((f64::from(*got) - exact).abs() / exact.abs().max(1.0));
            worst = worst.max((f64::from(slope) - exact_slope).abs());
            if !(got.is_finite() && slope.is_finite()) {
                worst = f64::NAN;
            }
        }
    }
    Ok(Outcome {
        error_of: "loss and its slope, relative",
        tolerance: 1e-6,
        unguarded: Some(worst),
        guard: String::new(),
        remedied: worst,
        remedied_guard: String::new(),
    })
}

/// Checks that an optimizer skips the step of a non-finite gradient.
fn gradient() -> Result<Outcome> {
    let config: train::Config =
        serde_yaml::from_str(YAML).map_err(|e| Error::value("models/egotac.yaml", "a configuration", e))?;
    let vars = VarMap::new();
    let weight = vars.get(4, "weight", candle_nn::Init::Const(1.0), candle_core::DType::F32, &Device::Cpu)?;
    let mut optimizer = AdamW::new(&vars, &config)?;
    let mut step = |factor: f64| -> Result<(f64, f64)> {
        let gradients = (&weight * factor)?.sum_all()?.backward()?;
        let norm = optimizer.step(&gradients, 1e-3)?;
        let now = vars.all_vars()[0].to_vec1::<f32>()?;
        // NaN counts as an infinite change.
        let changed = now.iter().map(|w| f64::from((w - 1.0).abs())).sum::<f64>();
        Ok((if changed.is_nan() { f64::INFINITY } else { changed }, norm))
    };
    let broken = [step(f64::NAN)?, step(f64::INFINITY)?];
    let (changed, norm) = (broken[0].0.max(broken[1].0), broken[0].1);
    let (moved, good_norm) = step(1.0)?;
    Ok(Outcome {
        error_of: "weights changed by a step that must be skipped, or unchanged by one that must not",
        tolerance: 0.0,
        unguarded: Some(changed),
        guard: if norm.is_finite() { String::new() } else { format!("step skipped, its gradient's norm is {norm}") },
        remedied: if moved > 0.0 { 0.0 } else { f64::NAN },
        remedied_guard: if good_norm.is_finite() { String::new() } else { format!("norm {good_norm}") },
    })
}
