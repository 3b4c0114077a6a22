//! The network agrees, stage by stage, with one written in PyTorch (tests/data/model/golden.py).

use std::collections::{BTreeMap, HashMap};
use std::process::Command;

use crate::common::{model_data, relative_error};
use candle_core::{DType, Device, Tensor};
use egotac::model::{EgoTac, checkpoint, init};

const CASES: [&str; 5] = ["toy_0", "toy_1", "other_0", "other_1", "third_0"];
const STAGES: [&str; 4] = ["tokens", "z", "force", "contact_logits"];
/// Relative L2 error that a stage may have; measured: below 1e-6.
const TOLERANCE: f64 = 1e-5;

fn activations(case: &str) -> HashMap<String, Tensor> {
    let path = model_data(format!("{case}_activations.safetensors"));
    let tensors = candle_core::safetensors::load(path, &Device::Cpu).unwrap();
    tensors.into_iter().map(|(name, t)| (name, t.to_dtype(DType::F32).unwrap())).collect()
}

fn assert_stages_agree(case: &str, got: &BTreeMap<&str, Tensor>, want: &HashMap<String, Tensor>) {
    for stage in STAGES {
        let error = relative_error(&got[stage], &want[stage]);
        println!("{case} {stage}: {error:.1e}");
        assert!(error < TOLERANCE, "{case} {stage}: {error:e}");
    }
}

fn stages(model: &EgoTac, images: &Tensor) -> BTreeMap<&'static str, Tensor> {
    let s = model.stages(images).unwrap();
    BTreeMap::from([("tokens", s.tokens), ("z", s.z), ("force", s.force), ("contact_logits", s.contact_logits)])
}

#[test]
fn every_stage_of_a_compiled_network_agrees_with_pytorch() {
    for case in CASES {
        let weights = model_data(format!("{case}_weights.safetensors"));
        let model = checkpoint::load_model(&weights, None, &Device::Cpu).unwrap().freeze().unwrap();
        let want = activations(case);
        assert_stages_agree(case, &stages(&model, &want["images"]), &want);
    }
}

#[test]
fn every_stage_of_a_network_in_training_agrees_with_pytorch() {
    for case in CASES {
        let weights = model_data(format!("{case}_weights.safetensors"));
        let config = checkpoint::load_model(&weights, None, &Device::Cpu).unwrap().config().clone();
        let vars = candle_nn::VarMap::new();
        let model = EgoTac::new(&config, init::var_builder(&vars, 0, &Device::Cpu)).unwrap();
        // After construction: the network has to see the change of its variables.
        checkpoint::load_variables(&weights, &vars).unwrap();
        let want = activations(case);
        assert_stages_agree(case, &stages(&model, &want["images"]), &want);
    }
}

#[test]
fn model_forward_repeats_the_golden_activations_from_the_command_line() {
    let folder = tempfile::tempdir().unwrap();
    for case in ["toy_1", "other_0"] {
        let out = folder.path().join(format!("{case}.safetensors"));
        let output = Command::new(env!("CARGO_BIN_EXE_egotac"))
            .args(["model", "forward", "--checkpoint"])
            .arg(model_data(format!("{case}_weights.safetensors")))
            .arg("--input")
            .arg(model_data(format!("{case}_activations.safetensors")))
            .arg("--out")
            .arg(&out)
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let got = candle_core::safetensors::load(&out, &Device::Cpu).unwrap();
        let want = activations(case);
        let got = STAGES.map(|stage| (stage, got[stage].clone())).into_iter().collect();
        assert_stages_agree(case, &got, &want);
    }
}

#[test]
fn model_forward_says_in_one_line_what_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out.safetensors");
    let forward = |weights: &str, input: &str| {
        let output = Command::new(env!("CARGO_BIN_EXE_egotac"))
            .args(["model", "forward", "--checkpoint"])
            .arg(model_data(weights))
            .arg("--input")
            .arg(model_data(input))
            .arg("--out")
            .arg(&out)
            .output()
            .unwrap();
        assert!(!output.status.success());
        assert!(!out.exists());
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(text.trim().lines().count(), 1, "{text}");
        text
    };
    let wrong_size = forward("toy_0_weights.safetensors", "other_0_activations.safetensors");
    assert!(wrong_size.contains("[B, 3, 3, 56, 56]") && wrong_size.contains("[2, 1, 3, 48, 48]"), "{wrong_size}");
    let no_images = forward("toy_0_weights.safetensors", "toy_0_weights.safetensors");
    assert!(no_images.contains("images") && no_images.contains("force_head.bias"), "{no_images}");
    let no_file = forward("absent.safetensors", "toy_0_activations.safetensors");
    assert!(no_file.contains("absent.safetensors"), "{no_file}");
}
