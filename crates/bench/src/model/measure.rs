//! Time and memory of one configuration, measured in this process.

use std::path::Path;
use std::time::Instant;

use candle_core::{Device, Tensor};
use candle_nn::{VarBuilder, VarMap};
use egotac::dataset::zarr::ZarrReader;
use egotac::error::{Error, Result};
use egotac::model::predictor::{Options, Predictor};
use egotac::model::{Checkpoint, Config, EgoTac, Metadata, Precision, checkpoint, init};
use egotac::score::metrics::{self, EvalOptions};
use egotac::statistics::percentile;
use egotac::train::data::Dataset;
use egotac::train::predict;
use serde::{Deserialize, Serialize};

use super::image::jpeg;

/// Seconds between frames of a stream.
const FRAME_DT: f64 = 0.04;

/// Configuration to measure.
#[derive(Debug, Clone)]
pub struct Setup {
    /// Name of the preset or checkpoint, for the table.
    pub name: String,
    /// Geometry.
    pub config: Config,
    /// Number format.
    pub precision: Precision,
    /// Threads of the pool.
    pub threads: usize,
    /// Timed runs of each kind, after one that does not count.
    pub runs: usize,
    /// Clips of a batch whose throughput is timed; up to 1 = none.
    pub batch: usize,
    /// Device that the network runs on.
    pub device: Device,
}

/// Times of repeated runs, ms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Least.
    pub min: f64,
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
}

/// Accuracy on held-out frames; `None` if a score is undefined.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Accuracy {
    /// Mean absolute error of the force, N.
    pub force_mae: Option<f64>,
    /// Mean absolute error where the true force is above 0.05 N, N.
    pub active_mae: Option<f64>,
    /// F1 of contact, mean over frames with contact.
    pub frame_mean_f1: Option<f64>,
    /// Pooled F1 of contact.
    pub contact_f1: Option<f64>,
    /// Pooled AUROC of contact.
    pub auroc: Option<f64>,
    /// Frames.
    pub frames: usize,
}

/// Results of one configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the preset or checkpoint.
    pub preset: String,
    /// Frames of the observation window (T).
    pub horizon: usize,
    /// Side of the input image, pixels.
    pub image: usize,
    /// Number format.
    pub precision: Precision,
    /// Threads.
    pub threads: usize,
    /// `cpu` or `cuda`.
    pub device: String,
    /// Parameters of the network.
    pub parameters: usize,
    /// Median time of the encoder on one frame, ms.
    pub encoder_ms: f64,
    /// Median time of one more frame of a stream whose other frames are cached, ms.
    pub streaming_ms: f64,
    /// Median time of the whole window, ms.
    pub clip_ms: f64,
    /// Median time from a JPEG of 640 x 480 pixels to touch, ms: decoding, resizing, streaming.
    pub picture_ms: f64,
    /// Times of the encoder.
    pub encoder: Spread,
    /// Times of the stream.
    pub streaming: Spread,
    /// Times of the window.
    pub clip: Spread,
    /// Times from picture to touch.
    pub picture: Spread,
    /// Clips in a batch, and times of whole batches.
    pub batch: Option<(usize, Spread)>,
    /// Size of the compiled weights, MB (2²⁰); `None` on a GPU.
    pub weights_mb: Option<f64>,
    /// Largest resident memory of the process, MB (2²⁰).
    pub peak_memory_mb: f64,
    /// Accuracy of trained weights on held-out frames.
    pub accuracy: Option<Accuracy>,
}

/// Times a configuration with random weights.
///
/// # Errors
/// If the configuration is impossible, or the device has no such precision.
pub fn random(setup: &Setup) -> Result<Row> {
    let metadata = Metadata::new(&setup.name, 1.0, FRAME_DT);
    let model = random_network(&setup.config, setup.precision, &setup.device)?;
    let checkpoint = Checkpoint::new(model.compile(setup.precision)?, metadata);
    run(setup, checkpoint, None)
}

/// Creates a network with random weights, as if it were loaded: nothing in it learns.
///
/// # Errors
/// If the geometry is impossible, or the device is out of memory.
pub fn random_network(config: &Config, precision: Precision, device: &Device) -> Result<EgoTac> {
    let vars = VarMap::new();
    EgoTac::new(config, init::var_builder(&vars, 0, &Device::Cpu))?;
    let drawn = vars
        .data()
        .lock()
        .map_err(|_| Error::value("variables", "unlocked ones", "a thread died while it held them"))?;
    let tensors = drawn.iter().map(|(name, var)| (name.clone(), var.as_detached_tensor())).collect();
    EgoTac::new(config, VarBuilder::from_tensors(tensors, precision.dtype(device), device))
}

/// Times a checkpoint's weights and scores them on stores.
///
/// # Errors
/// If the checkpoint or a store can't be read, or they name vertices differently.
pub fn trained(setup: &Setup, path: &Path, stores: Vec<ZarrReader>) -> Result<Row> {
    let checkpoint = Checkpoint::load_as(path, &setup.device, setup.precision)?;
    let accuracy = match stores.is_empty() {
        true => None,
        false => Some(accuracy(&checkpoint, stores, &setup.device)?),
    };
    run(setup, checkpoint, accuracy)
}

fn accuracy(checkpoint: &Checkpoint, stores: Vec<ZarrReader>, device: &Device) -> Result<Accuracy> {
    let data = Dataset::new(stores, checkpoint.metadata.preparation(checkpoint.model.config()), false)?;
    data.topology().must_match(checkpoint.metadata.topology)?;
    let predicted = predict(&checkpoint.model, &checkpoint.metadata, &data, device, |_| {})?;
    let labels = data.labels()?;
    let report = metrics::evaluate(&predicted, &labels, &EvalOptions::default())?;
    Ok(Accuracy {
        force_mae: report.mae,
        active_mae: report.active_mae,
        frame_mean_f1: report.frame_mean.f1,
        contact_f1: report.pooled.f1,
        auroc: report.pooled.auroc,
        frames: data.n_frames(),
    })
}

fn run(setup: &Setup, checkpoint: Checkpoint, accuracy: Option<Accuracy>) -> Result<Row> {
    let (runs, device) = (setup.runs, &setup.device);
    let frame_dt = checkpoint.metadata.frame_dt;
    let mut predictor = Predictor::new(checkpoint, Options { device: device.clone(), ..Options::default() })?;
    let model = predictor.model().clone();
    let config = model.config().clone();
    let (side, horizon) = (config.image, config.horizon);
    let frame = Tensor::randn(0f32, 1.0, (1, 3, side, side), device)?;
    let clip = frame.unsqueeze(1)?.expand((1, horizon, 3, side, side))?.contiguous()?;
    let kept = model.project(&model.encode(&frame)?)?;
    let synchronise = || -> Result<()> { Ok(device.synchronize()?) };
    let encoder = time(runs, || {
        model.encode(&frame)?;
        synchronise()
    })?;
    let streaming = time(runs, || {
        let new = model.project(&model.encode(&frame)?)?;
        let mut window = vec![&kept; horizon - 1];
        window.push(&new);
        model.decode_frames(&window)?;
        synchronise()
    })?;
    let clip = time(runs, || {
        model.forward(&clip)?;
        synchronise()
    })?;
    let batch = match setup.batch {
        0 | 1 => None,
        batch => {
            let clips = Tensor::randn(0f32, 1.0, (batch, horizon, 3, side, side), device)?;
            let spread = time(runs, || {
                model.forward(&clips)?;
                synchronise()
            })?;
            Some((batch, spread))
        }
    };
    let weights_mb = model.compiled_bytes().map(|bytes| bytes as f64 / f64::from(1 << 20));
    let file = jpeg()?;
    let mut stamp = 0.0;
    let picture = time(runs, || {
        stamp += frame_dt;
        predictor.push(&egotac::image::decode(&file)?, stamp).map(drop)
    })?;
    Ok(Row {
        preset: setup.name.clone(),
        horizon,
        image: side,
        precision: setup.precision,
        threads: setup.threads,
        device: if device.is_cpu() { "cpu" } else { "cuda" }.into(),
        parameters: checkpoint::parameter_count(&config)?,
        encoder_ms: encoder.p50,
        streaming_ms: streaming.p50,
        clip_ms: clip.p50,
        picture_ms: picture.p50,
        encoder,
        streaming,
        clip,
        picture,
        batch,
        weights_mb,
        peak_memory_mb: memory_mb("VmHWM:")?,
        accuracy,
    })
}

/// Times `runs` runs after one that does not count, ms.
fn time(runs: usize, mut run: impl FnMut() -> Result<()>) -> Result<Spread> {
    run()?;
    let mut times = Vec::with_capacity(runs.max(1));
    for _ in 0..runs.max(1) {
        let begun = Instant::now();
        run()?;
        times.push(begun.elapsed().as_secs_f64() * 1e3);
    }
    Ok(Spread {
        min: percentile(times.iter().copied(), 0.0),
        p50: percentile(times.iter().copied(), 0.5),
        p95: percentile(times, 0.95),
    })
}

/// Reads a line of `/proc/self/status`, MB (2²⁰): `VmHWM:` is the largest resident memory so far, `VmRSS:` the present one.
///
/// # Errors
/// If the system does not report it.
pub fn memory_mb(line: &str) -> Result<f64> {
    let path = Path::new("/proc/self/status");
    let status = std::fs::read_to_string(path).map_err(Error::io(path))?;
    let value = status.lines().find_map(|text| text.strip_prefix(line));
    let kib = value.and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok());
    kib.map(|kib| kib / 1024.0).ok_or_else(|| Error::file(path, format!("has no line {line}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_run_does_not_count() {
        let mut calls = 0;
        let spread = time(4, || {
            calls += 1;
            Ok(())
        });
        let spread = spread.unwrap();
        assert_eq!(calls, 5);
        assert!(0.0 <= spread.min && spread.min <= spread.p50 && spread.p50 <= spread.p95, "{spread:?}");
    }
}
