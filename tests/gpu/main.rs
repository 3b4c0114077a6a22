//! The network and its training on an NVIDIA GPU, beside the CPU; `make check-gpu` builds and runs these tests.
#![cfg(feature = "cuda")]

#[allow(dead_code)] // shared with other tests
#[path = "../train/stores.rs"]
mod stores;

use std::collections::BTreeMap;
use std::path::Path;

use candle_core::{DType, Device, Result, Tensor, Var};
use candle_nn::{VarBuilder, VarMap};
use egotac::model::predictor::Options;
use egotac::model::{Checkpoint, EgoTac, Metadata, Precision, Predictor, init};
use egotac::train::ranks::Single;
use egotac::train::{Config, Control, Event, Step, train_on};
use egotac_kernels::gpu;
use egotac_kernels::ops::{self, plain};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

type Operation<'a> = &'a dyn Fn(&[Tensor]) -> Result<Tensor>;

fn numbers(count: usize, seed: u64) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count).map(|_| rng.sample::<f32, _>(StandardNormal)).collect()
}

fn values(tensor: &Tensor) -> Vec<f64> {
    let host = tensor.to_device(&Device::Cpu).unwrap().to_dtype(DType::F64).unwrap();
    host.flatten_all().unwrap().to_vec1().unwrap()
}

/// Largest difference over the largest value, at least 1e-3; a value that is not finite counts as infinite.
fn error(got: &[f64], want: &[f64]) -> f64 {
    assert_eq!(got.len(), want.len());
    let largest = want.iter().fold(1e-3, |a: f64, b| a.max(b.abs()));
    let difference = |(a, b): (&f64, &f64)| if a.is_finite() { (a - b).abs() } else { f64::INFINITY };
    got.iter().zip(want).map(difference).fold(0.0, f64::max) / largest
}

/// The result, and the gradients of a weighted sum of it.
fn with_gradients(inputs: &[Tensor], operation: Operation) -> Vec<Vec<f64>> {
    let vars: Vec<Var> = inputs.iter().map(|tensor| Var::from_tensor(tensor).unwrap()).collect();
    let leaves: Vec<Tensor> = vars.iter().map(|var| var.as_tensor().clone()).collect();
    let result = operation(&leaves).unwrap();
    let weights = Tensor::from_vec(numbers(result.elem_count(), 77), result.shape(), &Device::Cpu).unwrap();
    let weights = weights.to_device(result.device()).unwrap().to_dtype(result.dtype()).unwrap();
    let gradients = (&result * weights).unwrap().sum_all().unwrap().backward().unwrap();
    let gradients = vars.iter().map(|var| values(gradients.get(var).unwrap()));
    std::iter::once(values(&result)).chain(gradients).collect()
}

/// Compares an operation on the GPU, in f32 and bf16, with its plain form on the CPU in f64, on the same numbers.
fn assert_agree(gpu: &Device, name: &str, shapes: &[&[usize]], seed: u64, fused: Operation, plain: Operation) {
    for (dtype, tolerance) in [(DType::F32, 2e-5), (DType::BF16, 2e-2)] {
        let make = |(i, shape): (usize, &&[usize])| {
            // Weights are of the size that keeps what passes through them at about 1.
            let scale = if i == 1 && shape.len() == 2 { 1.0 / (shape[1] as f64).sqrt() } else { 1.0 };
            let count = shape.iter().product();
            let tensor = Tensor::from_vec(numbers(count, seed + 1000 * i as u64), *shape, &Device::Cpu).unwrap();
            (tensor * scale).unwrap().to_dtype(dtype).unwrap()
        };
        let inputs: Vec<Tensor> = shapes.iter().enumerate().map(make).collect();
        let there: Vec<Tensor> = inputs.iter().map(|tensor| tensor.to_device(gpu).unwrap()).collect();
        let exact: Vec<Tensor> = inputs.iter().map(|tensor| tensor.to_dtype(DType::F64).unwrap()).collect();
        let (got, want) = (with_gradients(&there, fused), with_gradients(&exact, plain));
        for (i, (got, want)) in got.iter().zip(&want).enumerate() {
            let error = error(got, want);
            assert!(error < tolerance, "{name} {shapes:?} {dtype:?}, result or gradient {i}: relative error {error:e}");
        }
    }
}

#[test]
fn operations_and_gradients_agree_with_plain_ones_on_the_cpu() {
    let gpu = gpu::open(0).unwrap();
    // The network's own shapes, and odd ones: a single row, more rows than a block sums, widths that no block divides.
    for (seed, (b, n, heads, size, k)) in
        [(1, 257, 12, 64, 768), (3, 257, 3, 64, 192), (4, 1, 4, 32, 128), (2, 7, 1, 5, 3), (5, 300, 2, 33, 70)]
            .into_iter()
            .enumerate()
    {
        let (seed, d) = (seed as u64, heads * size);
        let linear: &[&[usize]] = &[&[b, n, k], &[d, k], &[d]];
        assert_agree(&gpu, "linear", linear, seed, &|t| ops::linear(&t[0], &t[1], &t[2]), &|t| {
            plain::linear(&t[0], &t[1], &t[2])
        });
        assert_agree(&gpu, "gelu", linear, seed, &|t| ops::gelu_linear(&t[0], &t[1], &t[2]), &|t| {
            plain::gelu_linear(&t[0], &t[1], &t[2])
        });
        assert_agree(
            &gpu,
            "self-attention",
            &[&[b, n, k], &[3 * d, k], &[3 * d]],
            seed,
            &|t| ops::self_attention(&t[0], &t[1], &t[2], heads),
            &|t| plain::self_attention(&t[0], &t[1], &t[2], heads),
        );
        let norm: &[&[usize]] = &[&[b, n, d + 3], &[d + 3], &[d + 3]];
        assert_agree(&gpu, "layer norm", norm, seed, &|t| ops::layer_norm(&t[0], Some((&t[1], &t[2])), 1e-6), &|t| {
            plain::layer_norm(&t[0], Some((&t[1], &t[2])), 1e-6)
        });
        assert_agree(&gpu, "bare norm", &norm[..1], seed, &|t| ops::layer_norm(&t[0], None, 1e-6), &|t| {
            plain::layer_norm(&t[0], None, 1e-6)
        });
        assert_agree(
            &gpu,
            "residual",
            &[&[b, n, d], &[b, n, d], &[d]],
            seed,
            &|t| ops::scaled_residual(&t[0], &t[1], &t[2]),
            &|t| plain::scaled_residual(&t[0], &t[1], &t[2]),
        );
        // Where nothing learns, the modulation is fused too.
        let [h, modulation] = [(b * n * d, 1), (b * 2 * d, 2)].map(|(count, seed)| numbers(count, seed));
        let h = Tensor::from_vec(h, (b, n, d), &Device::Cpu).unwrap();
        let modulation = Tensor::from_vec(modulation, (b, 2 * d), &Device::Cpu).unwrap();
        let there = [&h, &modulation].map(|tensor| tensor.to_device(&gpu).unwrap());
        let (got, want) = (ops::modulated_norm(&there[0], &there[1], 1e-6), ops::modulated_norm(&h, &modulation, 1e-6));
        let error = error(&values(&got.unwrap()), &values(&want.unwrap()));
        assert!(error < 2e-5, "modulated norm: relative error {error:e}");
    }
}

#[test]
fn shapes_that_do_not_fit_are_errors() {
    let gpu = gpu::open(0).unwrap();
    let t = |shape: &[usize]| Tensor::zeros(shape, DType::F32, &gpu).unwrap();
    for (name, result) in [
        ("linear", ops::linear(&t(&[3, 4]), &t(&[5, 6]), &t(&[5]))),
        ("linear", ops::gelu_linear(&t(&[3, 6]), &t(&[5, 6]), &t(&[4]))),
        ("layer norm", ops::layer_norm(&t(&[3, 4]), Some((&t(&[5]), &t(&[5]))), 1e-6)),
        ("modulated norm", ops::modulated_norm(&t(&[2, 3, 4]), &t(&[2, 7]), 1e-6)),
        ("self-attention", ops::self_attention(&t(&[2, 3, 13]), &t(&[14, 13]), &t(&[14]), 2)),
        ("scaled residual", ops::scaled_residual(&t(&[3, 4]), &t(&[3, 5]), &t(&[4]))),
    ] {
        let error = result.unwrap_err().to_string();
        assert!(error.contains(name), "{error}");
    }
}

/// A network with random weights, whose AdaLN and heads are not zero.
fn network(preset: &str, precision: Precision, device: &Device) -> EgoTac {
    let config = egotac::model::Config::preset(preset).unwrap();
    let vars = VarMap::new();
    EgoTac::new(&config, init::var_builder(&vars, 3, &Device::Cpu)).unwrap();
    let drawn: BTreeMap<String, Tensor> =
        vars.data().lock().unwrap().iter().map(|(name, var)| (name.clone(), var.as_detached_tensor())).collect();
    let tensors = drawn.into_iter().enumerate().map(|(i, (name, drawn))| {
        let noise = Tensor::from_vec(numbers(drawn.elem_count(), i as u64), drawn.shape(), &Device::Cpu).unwrap();
        (name, (drawn + (noise * 0.01).unwrap()).unwrap())
    });
    let vb = VarBuilder::from_tensors(tensors.collect(), precision.dtype(device), device);
    EgoTac::new(&config, vb).unwrap()
}

#[test]
fn each_stage_of_the_network_is_that_of_the_cpu() {
    let gpu = gpu::open(0).unwrap();
    let side = egotac::model::Config::preset("pocket").unwrap().image;
    let images = Tensor::from_vec(numbers(2 * 3 * 3 * side * side, 5), (2, 3, 3, side, side), &Device::Cpu).unwrap();
    let want = network("pocket", Precision::F32, &Device::Cpu).stages(&images).unwrap();
    for (precision, tolerance) in [(Precision::F32, 1e-4), (Precision::Bf16, 3e-2)] {
        for compiled in [false, true] {
            let mut there = network("pocket", precision, &gpu);
            if compiled {
                there = there.compile(precision).unwrap();
            }
            let got = there.stages(&images.to_device(&gpu).unwrap()).unwrap();
            for (name, got, want) in [
                ("tokens", &got.tokens, &want.tokens),
                ("scene", &got.z, &want.z),
                ("force", &got.force, &want.force),
                ("contact", &got.contact_logits, &want.contact_logits),
            ] {
                let error = error(&values(got), &values(want));
                assert!(error < tolerance, "{name}, {precision}, compiled {compiled}: relative error {error:e}");
            }
        }
    }
}

/// Predicts touch on a stream of images.
fn stream(precision: Precision, device: &Device) -> Vec<Vec<f64>> {
    let checkpoint = Checkpoint::new(
        network("pocket", precision, device).compile(precision).unwrap(),
        Metadata::new("random", 1.0, 0.04),
    );
    let mut predictor =
        Predictor::new(checkpoint, Options { device: device.clone(), precision, ..Options::default() }).unwrap();
    let images = (0..6u32).map(|t| {
        let image = image::RgbImage::from_fn(160, 120, |x, y| {
            image::Rgb([(x * (t + 1)) as u8, (y + 40 * t) as u8, (x * y / (t + 2)) as u8])
        });
        let field = predictor.push(&image, 0.04 * f64::from(t)).unwrap().field;
        field.force.iter().chain(&field.contact).map(|value| f64::from(*value)).collect()
    });
    images.collect()
}

#[test]
fn a_stream_gives_the_touch_of_the_cpu_also_while_another_is_loaded() {
    let want = stream(Precision::F32, &Device::Cpu);
    let distance = |got: &[Vec<f64>]| got.iter().zip(&want).map(|(got, want)| error(got, want)).fold(0.0, f64::max);
    for (precision, tolerance) in [(Precision::F32, 1e-4), (Precision::Bf16, 3e-2)] {
        // Each network has its own device, as in the node, which loads one while another runs.
        let streams = std::thread::scope(|scope| {
            let started: Vec<_> =
                (0..4).map(|_| scope.spawn(move || stream(precision, &gpu::open(0).unwrap()))).collect();
            started.into_iter().map(|thread| thread.join().unwrap()).collect::<Vec<_>>()
        });
        for got in streams {
            let error = distance(&got);
            assert!(error < tolerance, "{precision}: relative error {error:e}");
        }
    }
}

#[test]
fn threads_see_each_other_s_work() {
    let gpu = gpu::open(0).unwrap();
    let side = egotac::model::Config::preset("pocket").unwrap().image;
    let network = network("pocket", Precision::F32, &gpu).compile(Precision::F32).unwrap();
    let frame = |seed: u64| Tensor::from_vec(numbers(3 * side * side, seed), (1, 3, side, side), &gpu).unwrap();
    let want: Vec<Vec<f64>> = (0..16).map(|seed| values(&network.encode(&frame(seed)).unwrap())).collect();
    // Each thread encodes what another one has copied to the GPU.
    let frames: Vec<Tensor> = std::thread::scope(|scope| {
        let started: Vec<_> = (0..16).map(|seed| scope.spawn(move || frame(seed))).collect();
        started.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    std::thread::scope(|scope| {
        for (frame, want) in frames.iter().zip(&want) {
            let network = &network;
            scope.spawn(move || assert_eq!(&values(&network.encode(frame).unwrap()), want));
        }
    });
}

/// Trains in a new folder; the run is stopped after step `stop` and resumed. Returns steps and final weights.
fn trained(device: &Device, more: &str, stop: usize) -> (Vec<Step>, Vec<f64>) {
    let folder = tempfile::tempdir().unwrap();
    stores::write(folder.path());
    let text = stores::config(folder.path(), "run", 4, 9) + more;
    let config: Config = serde_yaml::from_str(&text).unwrap();
    let mut steps = Vec::new();
    for resume in [false, true] {
        let mut observe = |event: Event| match event {
            Event::Stepped(step) => {
                steps.push(step.clone());
                if !resume && step.step == stop { Control::Stop } else { Control::Continue }
            }
            _ => Control::Continue,
        };
        train_on(&Single, &config, resume, device, &mut observe).unwrap();
    }
    (steps, weights(&folder.path().join("run/checkpoint.safetensors")))
}

fn weights(path: &Path) -> Vec<f64> {
    let mut tensors: Vec<_> = candle_core::safetensors::load(path, &Device::Cpu).unwrap().into_iter().collect();
    tensors.sort_by(|a, b| a.0.cmp(&b.0));
    tensors.iter().flat_map(|(_, tensor)| values(tensor)).collect()
}

#[test]
fn a_run_takes_the_steps_of_one_on_the_cpu_and_resumes() {
    let gpu = gpu::open(0).unwrap();
    let (want, want_weights) = trained(&Device::Cpu, "", 5);
    let (got, got_weights) = trained(&gpu, "", 5);
    let (whole, whole_weights) = trained(&gpu, "", usize::MAX);
    assert_eq!((got.len(), whole.len(), want.len()), (9, 9, 9));
    for ((got, whole), want) in got.iter().zip(&whole).zip(&want) {
        for ((a, c), b) in got.losses.values().into_iter().zip(whole.losses.values()).zip(want.losses.values()) {
            assert!((a - b).abs() <= 1e-4 * b.abs().max(1e-3), "step {}: {a} for {b}", got.step);
            assert!((a - c).abs() <= 1e-4 * c.abs().max(1e-3), "step {}: {a} for {c}, not interrupted", got.step);
        }
        assert!((got.grad_norm - want.grad_norm).abs() < 1e-3 * want.grad_norm, "{} {}", got.grad_norm, want.grad_norm);
    }
    assert!(error(&got_weights, &want_weights) < 1e-3 && error(&got_weights, &whole_weights) < 1e-3);
    // In bf16 the losses are those of f32 but for rounding.
    let (rounded, _) = trained(&gpu, "precision: bf16\n", usize::MAX);
    for (a, b) in rounded.iter().zip(&want) {
        assert!(
            (a.losses.total - b.losses.total).abs() < 0.05 * b.losses.total,
            "{} {}",
            a.losses.total,
            b.losses.total
        );
    }
}

/// NCCL allows one rank on each GPU, so that a group on one GPU has one rank, which gets its own values.
#[cfg(feature = "nccl")]
#[test]
fn the_sums_of_a_single_rank_are_its_own_values() {
    use egotac::train::ranks::nccl::Nccl;
    let gpu = gpu::open(0).unwrap();
    let group = Nccl::join(Nccl::new_id().unwrap(), 0, 1, &gpu).unwrap();
    // A part of a tensor too: its values do not begin where the memory of the tensor does.
    let whole = Tensor::from_vec(numbers(3000, 5), (3, 1000), &gpu).unwrap();
    let given = [whole.clone(), whole.narrow(0, 1, 1).unwrap()];
    for _ in 0..3 {
        let sums = group.sum_tensors(&given).unwrap();
        assert_eq!(sums.len(), given.len());
        for (sum, tensor) in sums.iter().zip(&given) {
            assert_eq!((sum.dims(), values(sum)), (tensor.dims(), values(tensor)));
        }
    }
    let across = whole.t().unwrap();
    assert!(group.sum_tensors(&[across]).unwrap_err().to_string().contains("contiguous"));
    assert_eq!(values(&group.sum_tensors(&given[..1]).unwrap()[0]), values(&whole));
    assert!(Nccl::join(Nccl::new_id().unwrap(), 0, 1, &Device::Cpu).is_err());
}
