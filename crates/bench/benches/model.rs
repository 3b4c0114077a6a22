//! Measures a training step with random weights, as one line of JSON. `egotac bench model` measures inference.
//!
//! ```text
//! cargo bench -p egotac-bench --bench model -- --preset tiny --threads 2 [--runs 5] [--batch 4]
//! ```
//!
//! `step_ms` is the median time of a step on a batch of that many clips: forward, force and contact loss, backward, clipping
//! and AdamW. `peak_memory_mb` is the largest resident memory of the process.

use std::time::Instant;

use candle_core::{Device, Result, Tensor};
use candle_nn::{AdamW, Optimizer, ParamsAdamW, VarMap};
use egotac::model::{Config, EgoTac, init};
use egotac::statistics;
use egotac::tactile::N_FIELD;
use egotac_bench::model::measure::memory_mb;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> anyhow::Result<()> {
    let argument = |name: &str| {
        let mut arguments = std::env::args().skip_while(|argument| argument != name);
        arguments.nth(1)
    };
    let number = |name: &str, default: usize| argument(name).map_or(Ok(default), |value| value.parse());
    let (preset, threads) = (argument("--preset").unwrap_or("tiny".into()), number("--threads", 2)?);
    let runs = number("--runs", 5)?;
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;

    let config = Config::preset(&preset)?;
    let batch = number("--batch", 4)?;
    let mut report = serde_json::json!({ "preset": preset, "threads": threads, "batch": batch, "dtype": "f32" });
    report["step_ms"] = step(&config, batch, runs)?.into();
    report["peak_memory_mb"] = memory_mb("VmHWM:")?.into();
    println!("{report}");
    Ok(())
}

fn step(config: &Config, batch: usize, runs: usize) -> anyhow::Result<f64> {
    let device = Device::Cpu;
    let vars = VarMap::new();
    let model = EgoTac::new(config, init::var_builder(&vars, 0, &device))?;
    let mut optimiser = AdamW::new(vars.all_vars(), ParamsAdamW { lr: 1e-4, ..Default::default() })?;
    let images = Tensor::randn(0f32, 1.0, (batch, config.horizon, 3, config.image, config.image), &device)?;
    let force = Tensor::rand(0f32, 1.0, (batch, config.predict, N_FIELD), &device)?;
    let contact = force.gt(0.9)?.to_dtype(candle_core::DType::F32)?;
    median(runs, || {
        let (f, c) = model.forward(&images)?;
        let loss = ((f - &force)?.sqr()?.mean_all()? + weighted_bce(&c, &contact, 2.0)?)?;
        let mut gradients = loss.backward()?;
        clip_gradients(&vars, &mut gradients, 5.0)?;
        Ok(optimiser.step(&gradients)?)
    })
}

/// Computes the mean of `-w y log σ(x) - (1 - y) log(1 - σ(x))`, from logits, without overflow.
fn weighted_bce(x: &Tensor, y: &Tensor, positive_weight: f64) -> Result<Tensor> {
    // log(1 + e⁻ˣ) = max(-x, 0) + log(1 + e^-|x|)
    let softplus = (x.neg()?.relu()? + (x.abs()?.neg()?.exp()? + 1.0)?.log()?)?;
    let weight = ((y * (positive_weight - 1.0))? + 1.0)?;
    (((y.neg()? + 1.0)? * x)? + (weight * softplus)?)?.mean_all()
}

fn clip_gradients(vars: &VarMap, gradients: &mut candle_core::backprop::GradStore, norm: f64) -> Result<()> {
    let vars = vars.all_vars();
    let mut total = 0.0;
    for var in &vars {
        if let Some(gradient) = gradients.get(var) {
            total += f64::from(gradient.sqr()?.sum_all()?.to_scalar::<f32>()?);
        }
    }
    let scale = norm / (total.sqrt() + 1e-6);
    if scale < 1.0 {
        for var in &vars {
            if let Some(gradient) = gradients.remove(var) {
                gradients.insert(var, (gradient * scale)?);
            }
        }
    }
    Ok(())
}

/// Returns the median time of `runs` runs after one that does not count, ms.
fn median(runs: usize, mut run: impl FnMut() -> anyhow::Result<()>) -> anyhow::Result<f64> {
    run()?;
    let mut times = Vec::new();
    for _ in 0..runs.max(1) {
        let start = Instant::now();
        run()?;
        times.push(start.elapsed().as_secs_f64() * 1e3);
    }
    Ok(statistics::median(times))
}
