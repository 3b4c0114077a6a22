//! Extreme inputs and weights give finite numbers, or an error that names the step.

use std::collections::BTreeMap;

use candle_core::{DType, Device, Tensor};
use candle_nn::VarMap;
use egotac::model::predictor::{Options, Predictor};
use egotac::model::{Checkpoint, Config, EgoTac, Metadata, Precision, init};
use egotac::train::loss;
use egotac_kernels::ops;
use image::{Rgb, RgbImage};
use proptest::prelude::*;

/// Tensors of a random toy network.
fn tensors(config: &Config, seed: u64) -> BTreeMap<String, Tensor> {
    let vars = VarMap::new();
    EgoTac::new(config, init::var_builder(&vars, seed, &Device::Cpu)).unwrap();
    vars.data().lock().unwrap().iter().map(|(name, var)| (name.clone(), var.as_tensor().clone())).collect()
}

fn build(config: &Config, tensors: &BTreeMap<String, Tensor>) -> EgoTac {
    let map = tensors.iter().map(|(name, tensor)| (name.clone(), tensor.clone())).collect();
    EgoTac::new(config, candle_nn::VarBuilder::from_tensors(map, DType::F32, &Device::Cpu)).unwrap()
}

/// The network in its trainable form, and compiled in each precision.
fn forms(config: &Config, tensors: &BTreeMap<String, Tensor>) -> Vec<(String, EgoTac)> {
    let compiled = Precision::ALL.map(|p| (p.to_string(), build(config, tensors).compile(p).unwrap()));
    std::iter::once(("layers".to_string(), build(config, tensors))).chain(compiled).collect()
}

fn values(tensor: &Tensor) -> Vec<f32> {
    tensor.flatten_all().unwrap().to_vec1().unwrap()
}

fn clip(config: &Config, value: impl Fn(usize) -> f32) -> Tensor {
    let shape = (1, config.horizon, 3, config.image, config.image);
    Tensor::from_vec((0..config.horizon * 3 * config.image.pow(2)).map(value).collect::<Vec<_>>(), shape, &Device::Cpu)
        .unwrap()
}

fn noise(i: usize) -> f32 {
    ((i * 7919 % 2003) as f32 / 2003.0 - 0.5) * 3.4
}

fn assert_finite(config: &Config, tensors: &BTreeMap<String, Tensor>, images: &Tensor, what: &str) {
    for (form, model) in forms(config, tensors) {
        let stages = model.stages(images).unwrap_or_else(|error| panic!("{what}, {form}: {error}"));
        for (name, stage) in
            [("tokens", stages.tokens), ("z", stages.z), ("force", stages.force), ("contact", stages.contact_logits)]
        {
            assert!(values(&stage).iter().all(|x| x.is_finite()), "{what}, {form}: {name}");
        }
    }
}

#[test]
fn black_white_constant_saturated_and_tiny_or_huge_inputs_stay_finite() {
    let config = Config::toy();
    let tensors = tensors(&config, 1);
    for (what, value) in [
        ("black", (|_| -2.117_904) as fn(usize) -> f32),
        ("white", |_| 2.64),
        ("constant zero", |_| 0.0),
        ("saturated", |i| if i % 2 == 0 { -2.117_904 } else { 2.64 }),
        ("noise at 1e-6", |i| 1e-6 * noise(i)),
        ("noise at 1e6", |i| 1e6 * noise(i)),
        ("subnormal", |i| 1e-40 * noise(i)),
        ("noise at 1e30", |i| 1e30 * noise(i)),
    ] {
        let images = clip(&config, value);
        if what == "noise at 1e30" {
            // The squares in a layer norm may overflow; then the error names the step.
            for (form, model) in forms(&config, &tensors).into_iter().skip(1) {
                if let Err(error) = model.stages(&images) {
                    assert!(error.to_string().contains("network, encoder."), "{form}: {error}");
                }
            }
            continue;
        }
        assert_finite(&config, &tensors, &images, what);
    }
}

#[test]
fn pictures_of_one_colour_give_a_field() {
    let config = Config::toy();
    for precision in Precision::ALL {
        let model = build(&config, &tensors(&config, 2)).compile(precision).unwrap();
        let checkpoint = Checkpoint::new(model, Metadata::new("toy", 1.0, 0.04));
        let mut predictor = Predictor::new(checkpoint, Options::default()).unwrap();
        for (i, color) in [[0; 3], [255; 3], [255, 0, 0], [127; 3]].into_iter().enumerate() {
            let field = predictor.push(&RgbImage::from_pixel(90, 70, Rgb(color)), i as f64 * 0.04).unwrap().field;
            assert!(field.force.iter().all(|f| f.is_finite() && *f >= 0.0), "{precision} {color:?}");
            assert!(field.contact.iter().all(|c| (0.0..=1.0).contains(c)), "{precision} {color:?}");
        }
    }
}

#[test]
fn weights_that_are_subnormal_or_zero_stay_finite() {
    let config = Config::toy();
    for scale in [1e-40, 0.0] {
        for part in ["mlp", "attn", "attention", "norm", "proj", "encoder.", "decoder.", ""] {
            let mut tensors = tensors(&config, 3);
            for (name, tensor) in tensors.iter_mut() {
                if name.contains(part) {
                    *tensor = (&*tensor * scale).unwrap();
                }
            }
            assert_finite(&config, &tensors, &clip(&config, noise), &format!("{part:?} times {scale:e}"));
        }
    }
}

#[test]
fn single_frames_single_steps_and_single_patches_stay_finite() {
    for config in [
        Config { horizon: 1, predict: 1, ..Config::toy() },
        Config { image: 14, pretrain_image: 14, horizon: 1, predict: 1, ..Config::toy() },
        Config { vision_depth: 1, depth: 1, horizon: 1, predict: 5, image: 14, ..Config::toy() },
    ] {
        assert_finite(&config, &tensors(&config, 4), &clip(&config, noise), &format!("{config:?}"));
    }
}

#[test]
fn the_first_step_that_is_not_finite_is_named() {
    let config = Config::toy();
    for (weight, step) in [
        ("encoder.embeddings.patch_embeddings.projection.bias", "encoder.embeddings"),
        ("encoder.encoder.layer.0.attention.output.dense.bias", "encoder.encoder.layer.0.attention"),
        ("encoder.encoder.layer.1.mlp.fc2.bias", "encoder.encoder.layer.1.mlp"),
        ("encoder.layernorm.bias", "encoder.layernorm"),
        ("temporal.proj.bias", "temporal.proj"),
        ("temporal.norm_out.bias", "temporal.norm_out"),
        ("decoder.0.attn.out.bias", "decoder.0.attn"),
        ("decoder.1.mlp.fc2.bias", "decoder.1.mlp"),
        ("force_head.bias", "force_head"),
        ("contact_head.bias", "contact_head"),
    ] {
        for bad in [f32::INFINITY, f32::NAN] {
            for precision in Precision::ALL {
                let mut tensors = tensors(&config, 5);
                let mut bias = values(&tensors[weight]);
                bias[3] = bad;
                let broken = Tensor::from_vec(bias, tensors[weight].shape(), &Device::Cpu).unwrap();
                tensors.insert(weight.into(), broken);
                let model = build(&config, &tensors).compile(precision).unwrap();
                let error = model.stages(&clip(&config, noise)).unwrap_err().to_string();
                let named = format!("network, {step}:");
                assert!(error.contains(&named) && error.contains("at "), "{weight} {precision}: {error}");
            }
        }
    }
}

#[test]
fn an_image_that_is_not_finite_is_named() {
    let config = Config::toy();
    let images = clip(&config, |i| if i == 77 { f32::NAN } else { noise(i) });
    for precision in Precision::ALL {
        let model = build(&config, &tensors(&config, 6)).compile(precision).unwrap();
        let error = model.stages(&images).unwrap_err().to_string();
        assert!(error.contains("network, images") && error.contains("NaN at 77"), "{error}");
    }
}

#[test]
fn an_image_whose_numbers_overflow_leaves_no_trace_in_the_stream() {
    let config = Config::toy();
    for weight in ["temporal.proj.bias", "temporal.norm_out.bias", "force_head.bias"] {
        let mut tensors = tensors(&config, 7);
        let broken = Tensor::full(f32::INFINITY, tensors[weight].shape(), &Device::Cpu).unwrap();
        tensors.insert(weight.into(), broken);
        for (form, model) in forms(&config, &tensors) {
            let checkpoint = Checkpoint::new(model, Metadata::new("toy", 1.0, 0.04));
            let mut predictor = Predictor::new(checkpoint, Options::default()).unwrap();
            let error = predictor.push(&RgbImage::new(90, 70), 0.0).unwrap_err();
            assert!(error.is_recoverable(), "{weight} {form}: {error}");
            assert_eq!(predictor.cached_frames(), 0, "{weight} {form}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn losses_and_their_gradients_are_finite_for_any_logit(scale in prop::sample::select(vec![1.0f32, 80.0, 1e3, 1e6, 1e30])) {
        let logits: Vec<f32> = (0..64).map(|i| scale * noise(i)).chain([80.0, -80.0, 90.0, -90.0, 0.0]).collect();
        let var = candle_core::Var::from_vec(logits.clone(), logits.len(), &Device::Cpu).unwrap();
        for label in [0.0f32, 1.0] {
            let target = Tensor::full(label, logits.len(), &Device::Cpu).unwrap();
            let each = loss::bce_with_logits(var.as_tensor(), &target, 2.0).unwrap();
            for (got, x) in values(&each).iter().zip(&logits) {
                // log(1 + e^-|x|) + max(∓x, 0), in f64
                let x = f64::from(*x);
                let softplus = |x: f64| (-x.abs()).exp().ln_1p() + x.max(0.0);
                let want = if label == 1.0 { 2.0 * softplus(-x) } else { softplus(x) };
                prop_assert!((f64::from(*got) - want).abs() <= 1e-5 * want.max(1.0), "{label} {x}: {got} for {want}");
            }
            let gradients = each.mean_all().unwrap().backward().unwrap();
            prop_assert!(values(gradients.get(&var).unwrap()).iter().all(|g| g.is_finite()));
        }
    }

    #[test]
    fn one_dominant_key_takes_all_weight_at_any_index(n in 2usize..70, at in 0usize..70, size in 1usize..20) {
        let (at, d) = (at % n, 2 * size);
        let mut qkv: Vec<f32> = (0..n * 3 * d).map(noise).collect();
        for token in 0..n {
            qkv[token * 3 * d..token * 3 * d + d].fill(1e3);
            qkv[token * 3 * d + d..token * 3 * d + 2 * d].fill(if token == at { 1e3 } else { -1e3 });
        }
        let value = qkv[at * 3 * d + 2 * d..(at + 1) * 3 * d].to_vec();
        let qkv = Tensor::from_vec(qkv, (1, n, 3 * d), &Device::Cpu).unwrap();
        let same = Tensor::eye(3 * d, DType::F32, &Device::Cpu).unwrap();
        let none = Tensor::zeros(3 * d, DType::F32, &Device::Cpu).unwrap();
        for row in ops::self_attention(&qkv, &same, &none, 2).unwrap().get(0).unwrap().to_vec2::<f32>().unwrap() {
            prop_assert_eq!(&row, &value);
        }
    }

    #[test]
    fn rows_without_variance_of_any_size_are_finite(value in prop::sample::select(vec![0.0f32, 1e-30, 1.0, -1e6, 1e15]), d in 1usize..70) {
        let x = Tensor::full(value, (2, d), &Device::Cpu).unwrap();
        let row = values(&ops::layer_norm(&x, None, 1e-6).unwrap());
        // The result is the rounding of the mean over the root of epsilon: a bounded multiple of the last place.
        let most = if value.abs() < 1e-3 { 1e-3 } else { (value.abs() * f32::EPSILON * 8.0 / 1e-3).max(1e-3) };
        prop_assert!(row.iter().all(|x| x.is_finite() && x.abs() <= most.max(1.5)), "{row:?}");
    }
}
