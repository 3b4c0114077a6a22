//! Time of each step of the vision encoder, beside what the processor can compute and read (a roofline), and beside one thread.

mod table;

use std::hint::black_box;
use std::time::Instant;

use egotac::error::{Error, Result};
use egotac::machine::Machine;
use egotac::model::{Config, Precision};
use egotac::statistics::median;
use egotac_kernels::activations::{Activations, Form};
use egotac_kernels::attention::Attention;
use egotac_kernels::norm::Norm;
use egotac_kernels::packed::{Format, Packed, Then};
use egotac_kernels::rows::Rows;
use egotac_kernels::{peak, team};
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde::Serialize;

/// Values that are read to measure the memory: 512 MB, more than most caches hold.
const READ: usize = 1 << 27;
/// Epsilon of the norms.
const EPS: f32 = 1e-6;

/// The roofs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Peaks {
    /// Operations per second in registers, 10⁹/s.
    pub gflops: f64,
    /// Those of one thread.
    pub gflops_of_one: f64,
    /// Bytes read per second from memory, 10⁹/s.
    pub gbytes: f64,
}

/// One step of the encoder, over all its layers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Step {
    /// Name.
    pub name: &'static str,
    /// Median time in a frame, ms.
    pub ms: f64,
    /// That on one thread.
    pub ms_on_one: f64,
    /// Operations in a frame, 10⁹.
    pub gflop: f64,
    /// Least bytes to move in a frame, 10⁶: weights, inputs and outputs once each.
    pub mbytes: f64,
}

impl Step {
    /// Least time that the roofs allow, ms, and true if memory sets it.
    pub fn bound(&self, peaks: &Peaks) -> (f64, bool) {
        let (compute, memory) = (1e3 * self.gflop / peaks.gflops, self.mbytes / peaks.gbytes);
        (compute.max(memory), memory > compute)
    }
}

/// The encoder of one preset in one precision.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Preset.
    pub preset: String,
    /// Precision.
    pub precision: Precision,
    /// Roofs of this precision.
    pub peaks: Peaks,
    /// Steps in order.
    pub steps: Vec<Step>,
}

/// Results.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LayersReport {
    /// The command that measures the same again.
    pub command: String,
    /// Version of egotac.
    pub egotac: &'static str,
    /// The machine.
    pub machine: Machine,
    /// Threads.
    pub threads: usize,
    /// Frames that each median is of.
    pub runs: usize,
    /// One row per preset and precision.
    pub rows: Vec<Row>,
}

/// Frames on many threads and on one.
struct Pools {
    all: ThreadPool,
    one: ThreadPool,
}

/// Measures the encoders of presets, frame by frame in turn on `threads` threads and on one; `progress(preset, precision)` is called
/// before each.
///
/// # Errors
/// If a preset does not exist, or the system refuses the threads.
pub fn measure(
    command: String,
    presets: &[String],
    precisions: &[Precision],
    (threads, runs): (usize, usize),
    mut progress: impl FnMut(&str, Precision),
) -> Result<LayersReport> {
    let pool = |threads: usize| {
        let pool = ThreadPoolBuilder::new().num_threads(threads).build();
        pool.map_err(|error| Error::value("threads", "a number that the system grants", format!("{threads}: {error}")))
    };
    let pools = Pools { all: pool(threads)?, one: pool(1)? };
    let gbytes = pools.all.install(read_rate);
    let mut rows = Vec::new();
    for preset in presets {
        let config = Config::preset(preset)?;
        for precision in precisions {
            progress(preset, *precision);
            let rate = |pool: &ThreadPool| pool.install(|| operation_rate(precision.format()));
            let peaks = Peaks { gflops: rate(&pools.all), gflops_of_one: rate(&pools.one), gbytes };
            rows.push(Row {
                preset: preset.clone(),
                precision: *precision,
                peaks,
                steps: steps(&config, *precision, &pools, runs),
            });
        }
    }
    let egotac = egotac::VERSION;
    Ok(LayersReport { command, egotac, machine: Machine::this(), threads, runs, rows })
}

/// Operations per second of all threads, 10⁹/s: the best of many tries, since other load only lowers it, and the system may need a
/// while to give each thread a core of its own.
fn operation_rate(format: Format) -> f64 {
    let rounds = 200_000_000 / (peak::multiply_add(format, 1) as usize).max(1);
    let rate = || {
        let begun = Instant::now();
        let operations: f64 = rayon::broadcast(|_| peak::multiply_add(format, rounds)).iter().sum();
        operations / begun.elapsed().as_secs_f64() / 1e9
    };
    (0..200).map(|_| rate()).fold(0.0, f64::max)
}

/// Bytes that all threads read per second, 10⁹/s.
fn read_rate() -> f64 {
    let values = vec![1.0f32; READ];
    let part = READ / rayon::current_num_threads();
    let rate = || {
        let begun = Instant::now();
        rayon::broadcast(|thread| black_box(peak::read(&values[thread.index() * part..][..part])));
        (size_of::<f32>() * READ) as f64 / begun.elapsed().as_secs_f64() / 1e9
    };
    (0..5).map(|_| rate()).fold(0.0, f64::max)
}

/// Weights of one layer.
struct Layer {
    qkv: Packed,
    out: Packed,
    fc1: Packed,
    fc2: Packed,
}

/// Measures each step with weights and activations of the encoder's sizes. Each layer has weights of its own, so that they come
/// from where they would come from in the network.
fn steps(config: &Config, precision: Precision, pools: &Pools, runs: usize) -> Vec<Step> {
    let format = precision.format();
    let (d, n, depth) = (config.vision_width, config.tokens() + config.registers, config.vision_depth);
    let patch = 3 * config.patch * config.patch;
    let value = |i: usize| ((i * 7919 % 1013) as f32 / 1013.0) - 0.5;
    let values = |count: usize| -> Vec<f32> { (0..count).map(value).collect() };
    let packed = |k: usize, n: usize, format| Packed::new(&values(n * k), values(n), format);
    let layer = |_| Layer {
        qkv: packed(d, 3 * d, format),
        out: packed(d, d, format),
        fc1: packed(d, 4 * d, format),
        fc2: packed(4 * d, d, format),
    };
    let layers: Vec<Layer> = (0..depth).map(layer).collect();
    let first = packed(patch, d, precision.of_small_layers().format());
    let (norm, mut attention) =
        (Norm::new(values(d), values(d), EPS), Attention::new(n, d, config.vision_heads, format));
    let (patches, h) = (values((n - 1) * patch), values(n * d));
    let [mut x, mut qkv, mut hidden] = std::array::from_fn(|_| Activations::default());
    let mut sum = values(n * d);
    let mut frame = || {
        let mut of_frame = [0.0; 7];
        team::lead(|| {
            let mut timed = |step: usize, run: &mut dyn FnMut()| {
                let begun = Instant::now();
                run();
                of_frame[step] += 1e3 * begun.elapsed().as_secs_f64();
            };
            let rows = Rows::new(&patches, patch);
            timed(0, &mut || first.forward(rows, &mut sum[d..], d, Then::Add, &mut x));
            for layer in &layers {
                timed(1, &mut || norm.apply_into(Rows::new(&h, d), &mut x, layer.qkv.form()));
                timed(2, &mut || layer.qkv.apply_into(&x, &mut qkv, attention.form(), Then::Store));
                timed(3, &mut || attention.apply_into(&qkv, &mut x, layer.out.form()));
                timed(4, &mut || layer.out.apply(&x, &mut sum, d, Then::Add));
                timed(1, &mut || norm.apply_into(Rows::new(&h, d), &mut x, layer.fc1.form()));
                timed(5, &mut || layer.fc1.apply_into(&x, &mut hidden, layer.fc2.form(), Then::Gelu));
                timed(6, &mut || layer.fc2.apply(&hidden, &mut sum, d, Then::Add));
            }
            black_box(&sum);
        });
        of_frame
    };
    // The first frame fills caches and is left out.
    pools.all.install(&mut frame);
    let mut times: [[Vec<f64>; 7]; 2] = Default::default();
    for _ in 0..runs {
        for (pool, times) in [&pools.all, &pools.one].into_iter().zip(&mut times) {
            let of_frame = pool.install(&mut frame);
            times.iter_mut().zip(of_frame).for_each(|(times, ms)| times.push(ms));
        }
    }
    let product = |k: usize, n_out: usize, rows: usize| 2.0 * (k * n_out * rows) as f64;
    let bytes = |form: Form| match form {
        Form::Floats => 4,
        Form::Halves => 2,
        Form::Bytes => 1,
    };
    // A layer reads its input in a form of its own, and writes its output in that of the next one; None: the sum, in f32.
    let moved = |layer: &Packed, k: usize, next: Option<Form>, rows: usize| {
        let (inputs, outputs) = (k * bytes(layer.form()), layer.n() * bytes(next.unwrap_or_default()));
        (layer.bytes() + rows * (inputs + outputs)) as f64
    };
    let of_layers = |operations: f64, bytes: f64| (depth as f64 * operations, depth as f64 * bytes);
    let sample = &layers[0];
    let work = [
        ("patch projection", (product(patch, d, n - 1), moved(&first, patch, None, n - 1))),
        ("layer norms", of_layers(2.0 * 8.0 * (n * d) as f64, (2 * n * d * (4 + bytes(sample.qkv.form()))) as f64)),
        ("queries, keys, values", of_layers(product(d, 3 * d, n), moved(&sample.qkv, d, Some(attention.form()), n))),
        (
            "attention",
            of_layers(
                4.0 * (n * n * d) as f64,
                (n * d * (3 * bytes(attention.form()) + bytes(sample.out.form()))) as f64,
            ),
        ),
        ("output", of_layers(product(d, d, n), moved(&sample.out, d, None, n))),
        (
            "first layer of the MLP, GELU",
            of_layers(product(d, 4 * d, n), moved(&sample.fc1, d, Some(sample.fc2.form()), n)),
        ),
        ("second layer of the MLP", of_layers(product(4 * d, d, n), moved(&sample.fc2, 4 * d, None, n))),
    ];
    let [of_all, of_one] = times.map(|steps| steps.map(median));
    let step = |((name, (operations, bytes)), (ms, ms_on_one))| Step {
        name,
        ms,
        ms_on_one,
        gflop: operations / 1e9,
        mbytes: bytes / 1e6,
    };
    work.into_iter().zip(of_all.into_iter().zip(of_one)).map(step).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_count_the_operations_of_the_encoder() {
        let config = Config::preset("toy").unwrap();
        let pool = |threads| ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let steps = steps(&config, Precision::F32, &Pools { all: pool(2), one: pool(1) }, 1);
        let (d, n) = (config.vision_width as f64, (config.tokens() + config.registers) as f64);
        let by_hand = 2.0 * n * 12.0 * d * d + 4.0 * n * n * d;
        let counted: f64 = steps[2..].iter().map(|step| 1e9 * step.gflop).sum();
        assert!((counted - config.vision_depth as f64 * by_hand).abs() < 1.0, "{counted}");
        assert!(steps.iter().all(|step| step.ms > 0.0 && step.ms_on_one > 0.0 && step.mbytes > 0.0));
    }

    #[test]
    fn the_lower_roof_bounds_a_step() {
        let step = Step { name: "a", ms: 9.0, ms_on_one: 18.0, gflop: 2.0, mbytes: 30.0 };
        let peaks = Peaks { gflops: 1000.0, gflops_of_one: 500.0, gbytes: 30.0 };
        assert_eq!(step.bound(&peaks), (2.0, false));
        assert_eq!(step.bound(&Peaks { gbytes: 10.0, ..peaks }), (3.0, true));
    }
}
