//! A checkpoint holds all its metadata, is restored exactly, and is refused if a tensor does not fit.

use std::collections::HashMap;
use std::path::Path;

use candle_core::{Device, Tensor};
use candle_nn::VarMap;
use egotac::image::{Filter, Resize};
use egotac::model::{Checkpoint, Config, EgoTac, Metadata, checkpoint, init};
use sha2::{Digest, Sha256};

fn network(config: &Config, seed: u64) -> (EgoTac, VarMap) {
    let vars = VarMap::new();
    let model = EgoTac::new(config, init::var_builder(&vars, seed, &Device::Cpu)).unwrap();
    (model, vars)
}

fn metadata() -> Metadata {
    Metadata {
        resize: Resize::Letterbox,
        filter: Filter::Bicubic,
        mean: [0.1, 0.2, 0.3],
        std: [0.4, 0.5, 0.6],
        has_force: false,
        training: r#"{"seed": 7, "note": "ä \"quoted\""}"#.into(),
        ..Metadata::new("a name", 0.123, 0.04)
    }
}

/// Writes `tensors` beside the metadata of `like`.
fn rewrite(like: &Path, to: &Path, change: impl FnOnce(&mut HashMap<String, Tensor>, &mut HashMap<String, String>)) {
    let bytes = std::fs::read(like).unwrap();
    let (_, header) = safetensors::SafeTensors::read_metadata(&bytes).unwrap();
    let mut map = header.metadata().clone().unwrap();
    let mut tensors = candle_core::safetensors::load(like, &Device::Cpu).unwrap();
    change(&mut tensors, &mut map);
    safetensors::serialize_to_file(tensors.iter(), Some(map), to).unwrap();
}

#[test]
fn a_saved_network_is_restored_bit_by_bit() {
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (folder.path().join("a.safetensors"), folder.path().join("b.safetensors"));
    let config = Config::toy();
    let (model, vars) = network(&config, 3);
    let sha256 = Checkpoint::save(&first, &config, &metadata(), &vars).unwrap();
    assert_eq!(Checkpoint::save(&second, &config, &metadata(), &vars).unwrap(), sha256);
    let bytes = std::fs::read(&first).unwrap();
    assert_eq!(bytes, std::fs::read(&second).unwrap());
    assert_eq!(format!("{:x}", Sha256::digest(&bytes)), sha256);

    let loaded = Checkpoint::load(&first, &Device::Cpu).unwrap();
    assert_eq!((&loaded.metadata, loaded.model.config(), loaded.sha256), (&metadata(), &config, sha256));
    let images = Tensor::randn(0f32, 1.0, (1, 3, 3, 56, 56), &Device::Cpu).unwrap();
    let values = |model: &EgoTac| {
        let (force, contact) = model.forward(&images).unwrap();
        [force, contact].map(|t| t.flatten_all().unwrap().to_vec1::<f32>().unwrap())
    };
    assert_eq!(values(&loaded.model), values(&model.freeze().unwrap()));

    let (_, other) = network(&config, 4);
    checkpoint::load_variables(&first, &other).unwrap();
    let third = folder.path().join("c.safetensors");
    Checkpoint::save(&third, &config, &metadata(), &other).unwrap();
    assert_eq!(bytes, std::fs::read(&third).unwrap());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3, "temporary files are left");
}

#[test]
fn parameter_counts_are_the_saved_elements() {
    for name in ["toy", "pocket"] {
        let config = Config::preset(name).unwrap();
        let (_, vars) = network(&config, 0);
        let elements: usize = vars.all_vars().iter().map(|v| v.elem_count()).sum();
        assert_eq!(checkpoint::parameter_count(&config).unwrap(), elements, "{name}");
    }
    // Counted by PyTorch, less its mask token.
    assert_eq!(checkpoint::parameter_count(&Config::toy()).unwrap(), 237_400 - 48);
}

#[test]
fn a_tensor_that_does_not_fit_is_named_with_expected_and_found_shape() {
    let folder = tempfile::tempdir().unwrap();
    let (good, bad) = (folder.path().join("good.safetensors"), folder.path().join("bad.safetensors"));
    let config = Config::toy();
    Checkpoint::save(&good, &config, &metadata(), &network(&config, 0).1).unwrap();
    rewrite(&good, &bad, |tensors, _| {
        tensors.remove("decoder.1.mlp.fc2.bias");
        let queries = tensors.remove("queries").unwrap();
        tensors.insert("querys".into(), queries);
        tensors.insert(
            "temporal.proj.weight".into(),
            Tensor::zeros((32, 47), candle_core::DType::F32, &Device::Cpu).unwrap(),
        );
    });
    let (_, vars) = network(&config, 1);
    let errors =
        [Checkpoint::load(&bad, &Device::Cpu).unwrap_err(), checkpoint::load_variables(&bad, &vars).unwrap_err()];
    for error in errors.map(|error| error.to_string()) {
        for part in [
            "bad.safetensors: 4 of",
            "decoder.1.mlp.fc2.bias: expected [32], found none",
            "queries: expected [2, 32], found none",
            "querys: expected no such tensor, found [2, 32]",
            "temporal.proj.weight: expected [32, 48], found [32, 47]",
        ] {
            assert!(error.contains(part), "{part:?} is not in: {error}");
        }
    }
    rewrite(&good, &bad, |tensors, _| {
        let poisoned = (&tensors["norm.bias"] / 0.0).unwrap();
        tensors.insert("norm.bias".into(), poisoned);
    });
    let error = Checkpoint::load(&bad, &Device::Cpu).unwrap_err().to_string();
    assert!(error.contains("norm.bias: expected finite numbers"), "{error}");
}

#[test]
fn metadata_that_is_missing_or_out_of_range_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let (good, bad) = (folder.path().join("good.safetensors"), folder.path().join("bad.safetensors"));
    let config = Config::toy();
    Checkpoint::save(&good, &config, &metadata(), &network(&config, 0).1).unwrap();
    for key in metadata().to_map().keys().map(String::as_str).chain(["config"]) {
        rewrite(&good, &bad, |_, map| assert!(map.remove(key).is_some()));
        let error = Checkpoint::load(&bad, &Device::Cpu).unwrap_err().to_string();
        assert!(error.contains(&format!("metadata {key:?} is missing")), "{error}");
    }
    for (key, value) in [
        ("force_scale", "-1"),
        ("frame_dt", "soon"),
        ("resize", "stretch"),
        ("filter", "box"),
        ("topology", "hand"),
        ("std", "[1, 0, 1]"),
        ("mean", "[1, 0]"),
        ("has_force", "yes"),
        ("config", "{}"),
    ] {
        rewrite(&good, &bad, |_, map| assert!(map.insert(key.into(), value.into()).is_some()));
        let error = Checkpoint::load(&bad, &Device::Cpu).unwrap_err().to_string();
        assert!(error.contains(key), "{key}: {error}");
    }
}

#[test]
fn a_file_that_is_not_safetensors_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("weights.safetensors");
    for bytes in [&b""[..], b"garbage that is no header", &[255; 64]] {
        std::fs::write(&path, bytes).unwrap();
        let error = Checkpoint::load(&path, &Device::Cpu).unwrap_err().to_string();
        assert!(error.contains("weights.safetensors: not a safetensors file"), "{error}");
    }
}

#[test]
fn initial_parameters_have_the_documented_distributions() {
    let (model, vars) = network(&Config::pocket(), 5);
    let images = Tensor::randn(0f32, 1.0, (2, 3, 3, 112, 112), &Device::Cpu).unwrap();
    let (force, _) = model.forward(&images).unwrap();
    assert_eq!(force.dims(), [2, 1, 1556]);
    let std = |name: &str| {
        let vars = vars.data().lock().unwrap();
        let values = vars[name].flatten_all().unwrap().to_vec1::<f32>().unwrap();
        (values.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
    };
    let about = |got: f64, want: f64| assert!((got / want - 1.0).abs() < 0.1, "{got} is not about {want}");
    assert_eq!(std("decoder.0.ada_attn.linear.weight"), 0.0);
    assert_eq!(std("encoder.encoder.layer.0.layer_scale1.lambda1"), 1.0);
    // DINOv2's 0.02 at 768 inputs, the same gain at 128.
    about(std("encoder.encoder.layer.0.mlp.fc1.weight"), 0.02 * 6f64.sqrt());
    about(std("encoder.embeddings.position_embeddings"), 0.02);
    // Uniform in ±1/√128: standard deviation 1/√(3·128).
    about(std("temporal.mlp.fc1.weight"), (1.0 / 384f64).sqrt());
    about(std("force_head.bias"), (1.0 / 384f64).sqrt());
}

#[test]
fn an_encoder_alone_is_loaded_into_another_network() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("other.safetensors");
    let (from, to) = (Config { horizon: 1, depth: 1, ..Config::toy() }, Config { width: 48, ..Config::toy() });
    let (_, trained) = network(&from, 1);
    Checkpoint::save(&path, &from, &metadata(), &trained).unwrap();
    let values = |vars: &VarMap| -> Vec<(String, Vec<f32>)> {
        let vars = vars.data().lock().unwrap();
        let value = |(name, var): (&String, &candle_core::Var)| {
            (name.clone(), var.flatten_all().unwrap().to_vec1::<f32>().unwrap())
        };
        let mut values: Vec<_> = vars.iter().map(value).collect();
        values.sort_by(|a, b| a.0.cmp(&b.0));
        values
    };
    let (_, vars) = network(&to, 2);
    let before = values(&vars);
    checkpoint::load_encoder(&path, &vars).unwrap();
    let trained: HashMap<String, Vec<f32>> = values(&trained).into_iter().collect();
    let mut taken = 0;
    for ((name, before), (_, after)) in before.into_iter().zip(values(&vars)) {
        let is_encoder = name.starts_with(checkpoint::ENCODER);
        taken += usize::from(is_encoder);
        assert_eq!(after, if is_encoder { trained[&name].clone() } else { before }, "{name}");
    }
    assert!(taken > 10);

    let (_, wider) = network(&Config { vision_width: 96, ..to }, 2);
    let before = values(&wider);
    let error = checkpoint::load_encoder(&path, &wider).unwrap_err().to_string();
    assert!(error.contains("other.safetensors") && error.contains("encoder.") && error.contains("expected"), "{error}");
    assert_eq!(values(&wider), before);
}
