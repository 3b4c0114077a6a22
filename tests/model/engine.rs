//! The compiled network gives the output of the trainable form: in f32 up to rounding, in bf16 and int8 up to theirs.

use candle_core::{Device, Tensor};
use candle_nn::VarMap;
use egotac::model::{Config, EgoTac, Precision, init};
use proptest::prelude::*;

/// A network with no parameter at its initial value of zero.
fn network(config: &Config, seed: u64) -> EgoTac {
    let vars = VarMap::new();
    let model = EgoTac::new(config, init::var_builder(&vars, seed, &Device::Cpu)).unwrap();
    for (name, var) in vars.data().lock().unwrap().iter() {
        if var.rank() == 1 || name.contains("ada") {
            let numbers: Vec<f32> = (0..var.elem_count()).map(|i| 0.1 * ((i * 37 + name.len()) as f32).sin()).collect();
            let noise = Tensor::from_vec(numbers, var.shape(), &Device::Cpu).unwrap();
            var.set(&(var.as_tensor() + noise).unwrap()).unwrap();
        }
    }
    model
}

fn images(config: &Config, batch: usize) -> Tensor {
    let shape = (batch, config.horizon, 3, config.image, config.image);
    let count = batch * config.horizon * 3 * config.image * config.image;
    let values: Vec<f32> = (0..count).map(|i| ((i * 7919 % 2003) as f32 / 2003.0 - 0.5) * 4.0).collect();
    Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
}

fn relative_error(got: &Tensor, want: &Tensor) -> f32 {
    assert_eq!(got.dims(), want.dims());
    let norm = |t: &Tensor| t.sqr().unwrap().sum_all().unwrap().to_scalar::<f32>().unwrap().sqrt();
    norm(&(got - want).unwrap()) / norm(want)
}

fn errors(config: &Config, seed: u64, batch: usize, precision: Precision) -> [f32; 4] {
    let layers = network(config, seed);
    let images = images(config, batch);
    let want = layers.stages(&images).unwrap();
    let got = layers.compile(precision).unwrap().stages(&images).unwrap();
    [
        relative_error(&got.tokens, &want.tokens),
        relative_error(&got.z, &want.z),
        relative_error(&got.force, &want.force),
        relative_error(&got.contact_logits, &want.contact_logits),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_compiled_network_agrees_with_the_layers_for_any_geometry(
        (vision_heads, vision_size, vision_depth) in (1usize..4, 1usize..20, 1usize..3),
        (heads, size, depth) in (1usize..4, 1usize..20, 1usize..3),
        (patch, grid, learned) in (2usize..6, 1usize..6, 1usize..5),
        (horizon, predict, registers, batch) in (1usize..4, 1usize..4, 0usize..3, 1usize..4),
        seed in 0u64..1000,
    ) {
        let config = Config {
            vision_width: 2 * vision_heads * vision_size, vision_depth, vision_heads, width: 2 * heads * size, depth, heads,
            image: patch * grid, patch, pretrain_image: patch * learned, horizon, predict, registers,
        };
        for (stage, error) in errors(&config, seed, batch, Precision::F32).into_iter().enumerate() {
            // A layer norm of a few values amplifies rounding.
            prop_assert!(error < if config.vision_width.min(config.width) < 8 { 1e-2 } else { 1e-4 }, "stage {stage}: {error:e} {config:?}");
        }
    }
}

#[test]
fn errors_of_bf16_and_int8_stay_below_their_limits() {
    for (precision, most) in [(Precision::F32, 5e-6), (Precision::Bf16, 2e-2), (Precision::Int8, 6e-2)] {
        for config in [Config::toy(), Config::pocket()] {
            let errors = errors(&config, 4, 2, precision);
            assert!(errors.iter().all(|error| *error < most), "{precision}: {errors:?}");
            if precision != Precision::F32 {
                assert!(errors[0] > 1e-5, "{precision} is not in use: {errors:?}");
            }
        }
    }
}

#[test]
fn errors_of_bf16_and_int8_grow_as_the_root_of_the_layers() {
    // A variable depends on seed and name alone, so a deeper network has the layers of the shallower one and more.
    for (precision, per_layer) in [(Precision::Bf16, 4e-3), (Precision::Int8, 1.5e-2)] {
        for vision_depth in 1..=8 {
            let config = Config { vision_depth, depth: 1, ..Config::pocket() };
            let error = errors(&config, 9, 1, precision)[0];
            let most = per_layer * (vision_depth as f32).sqrt();
            assert!(error < most, "{precision}, {vision_depth} layers: {error:e}, at most {most:e}");
        }
    }
}

#[test]
fn compiled_weights_take_the_bytes_of_their_precision() {
    let bytes = |precision| network(&Config::tiny(), 0).compile(precision).unwrap().compiled_bytes().unwrap() as f64;
    let f32 = bytes(Precision::F32);
    assert!((bytes(Precision::Bf16) / f32 - 0.5).abs() < 0.08, "bf16 takes {} of f32", bytes(Precision::Bf16) / f32);
    assert!(bytes(Precision::Int8) / f32 < 0.4, "int8 takes {} of f32", bytes(Precision::Int8) / f32);
    // 8.7 M parameters, less the position embeddings of 37² - 16² patches and projections of unused queries and keys.
    assert!((26e6..35e6).contains(&f32), "{f32}");
}

#[test]
fn results_do_not_depend_on_the_number_of_threads_or_callers() {
    for precision in Precision::ALL {
        let config = Config { horizon: 2, ..Config::pocket() };
        let model = network(&config, 2).compile(precision).unwrap();
        let images = images(&config, 2);
        let values = || {
            let (force, contact) = model.forward(&images).unwrap();
            [force, contact].map(|t| t.flatten_all().unwrap().to_vec1::<f32>().unwrap())
        };
        let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let one = pool(1).install(values);
        assert_eq!(one, pool(3).install(values), "{precision}");
        let several: Vec<_> = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..3).map(|_| scope.spawn(values)).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        assert!(several.iter().all(|other| *other == one), "{precision}");
    }
}

#[test]
fn shapes_that_do_not_fit_are_errors() {
    let config = Config::toy();
    let model = network(&config, 0).freeze().unwrap();
    let zeros = |shape: &[usize]| Tensor::zeros(shape, candle_core::DType::F32, &Device::Cpu).unwrap();
    for (error, name) in [
        (
            model.encode(&zeros(&[1, 3, 56, 42])).unwrap_err(),
            "frames: expected shape [N, 3, 56, 56], got [1, 3, 56, 42]",
        ),
        (model.project(&zeros(&[1, 17, 47])).unwrap_err(), "tokens"),
        (model.fuse(&zeros(&[1, 2, 17, 32])).unwrap_err(), "observation window"),
        (model.fuse_frames(&[&zeros(&[1, 17, 32])]).unwrap_err(), "observation window"),
        (model.heads(&zeros(&[1, 31])).unwrap_err(), "z: expected shape [B, 32], got [1, 31]"),
    ] {
        assert!(error.to_string().contains(name), "{error}");
    }
}
