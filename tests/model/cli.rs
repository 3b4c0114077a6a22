//! The commands of `egotac model` and `egotac bench model`, run as programs.

use std::path::Path;
use std::process::{Command, Output};

use crate::common::model_data;
use egotac::model::{checkpoint, shipped};
use serde_json::Value;

fn egotac(arguments: &[&str], folder: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_egotac")).args(arguments).current_dir(folder).output().unwrap()
}

fn good(arguments: &[&str], folder: &Path) -> String {
    let output = egotac(arguments, folder);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn refused(arguments: &[&str], folder: &Path) -> String {
    let output = egotac(arguments, folder);
    assert!(!output.status.success(), "{arguments:?}");
    String::from_utf8(output.stderr).unwrap()
}

#[test]
fn attention_is_drawn_for_layers_and_the_temporal_token() {
    let folder = tempfile::tempdir().unwrap();
    let picture = image::RgbImage::from_fn(64, 48, |x, y| image::Rgb([(4 * x) as u8, (5 * y) as u8, 90]));
    picture.save(folder.path().join("a.png")).unwrap();
    for (arguments, name) in
        [(&[][..], "t.png"), (&["--layer", "5"], "l.png"), (&["--layer", "0", "--head", "3"], "h.png")]
    {
        let text = good(&[&["model", "attention", "a.png", "--out", name], arguments].concat(), folder.path());
        let drawn = image::open(folder.path().join(name)).unwrap();
        assert_eq!((drawn.width(), drawn.height()), (3 * 448, 448));
        let shares: Vec<f64> =
            text.lines().filter_map(|line| line.split(": ").nth(1)?.split(' ').next()?.parse().ok()).collect();
        assert_eq!(shares.len(), 3, "{text}");
        // A layer's weights sum to 1 in each image, the temporal token's over all images.
        let sum: f64 = shares.iter().sum();
        let most = if arguments.is_empty() { 100.5 } else { 300.5 };
        assert!(shares.iter().all(|share| *share > 0.0) && sum <= most, "{text}");
    }
    let attention =
        |more: &[&str]| refused(&[&["model", "attention", "a.png", "--out", "x.png"], more].concat(), folder.path());
    // The limits are the shipped network's own.
    let config = checkpoint::geometry(&shipped::path().unwrap()).unwrap();
    let (layers, heads) = (config.vision_depth, config.vision_heads);
    let layer = layers.to_string();
    assert!(attention(&["--layer", &layer]).contains(&format!("layer: expected 0 to {}, got {layers}", layers - 1)));
    let head = heads.to_string();
    assert!(attention(&["--layer", "0", "--head", &head]).contains(&format!("--head: expected 0 to {}", heads - 1)));
}

#[test]
fn import_and_init_write_checkpoints_that_load() {
    let folder = tempfile::tempdir().unwrap();
    let published = model_data("pretrained_registers.safetensors");
    let init = [
        "model",
        "init",
        "--encoder",
        published.to_str().unwrap(),
        "--size",
        "56",
        "--depth",
        "1",
        "--out",
        "init.safetensors",
    ];
    good(&init, folder.path());
    // The name of the command in earlier versions.
    good(&init.map(|argument| if argument == "init" { "start" } else { argument }), folder.path());
    let info: Value =
        serde_json::from_str(&good(&["model", "info", "--checkpoint", "init.safetensors", "--json"], folder.path()))
            .unwrap();
    assert_eq!((&info["config"]["registers"], &info["metadata"]["resize"]), (&4.into(), &"centre".into()));
    let import = [
        "model",
        "import",
        "--checkpoint",
        "init.safetensors",
        "--mapping",
        "table.yaml",
        "--out",
        "again.safetensors",
    ];
    let table = format!("config: {}\nsidecar: {{ name: n, topology: mano, fps: 25 }}\nsame: true\n", info["config"]);
    std::fs::write(folder.path().join("table.yaml"), table).unwrap();
    good(&import, folder.path());
    let again: Value =
        serde_json::from_str(&good(&["model", "info", "--checkpoint", "again.safetensors", "--json"], folder.path()))
            .unwrap();
    assert_eq!((&again["config"], &again["metadata"]["has_force"]), (&info["config"], &"false".into()));
    std::fs::write(folder.path().join("table.yaml"), "config: 3").unwrap();
    assert!(refused(&import, folder.path()).contains("table.yaml"));
}

#[test]
fn forward_takes_a_precision() {
    let folder = tempfile::tempdir().unwrap();
    let (weights, input) = (model_data("toy_0_weights.safetensors"), model_data("toy_0_activations.safetensors"));
    let forward = |precision: &str| {
        good(
            &[
                "model",
                "forward",
                "--checkpoint",
                weights.to_str().unwrap(),
                "--input",
                input.to_str().unwrap(),
                "--precision",
                precision,
                "--out",
                precision,
            ],
            folder.path(),
        );
        let tensors = candle_core::safetensors::load(folder.path().join(precision), &candle_core::Device::Cpu).unwrap();
        tensors["force"].flatten_all().unwrap().to_vec1::<f32>().unwrap()
    };
    let (f32, int8) = (forward("f32"), forward("int8"));
    let norm = |values: &mut dyn Iterator<Item = f32>| values.map(|x| f64::from(x * x)).sum::<f64>().sqrt();
    let error = norm(&mut f32.iter().zip(&int8).map(|(a, b)| a - b)) / norm(&mut f32.iter().copied());
    assert!(error > 1e-4 && error < 0.05, "{error}");
}

#[test]
fn a_grown_and_a_halved_checkpoint_load_again() {
    let folder = tempfile::tempdir().unwrap();
    let shipped = shipped::path().unwrap();
    let shipped = shipped.to_str().unwrap();
    let info = |file: &str| -> Value {
        serde_json::from_str(&good(&["model", "info", "--checkpoint", file, "--json"], folder.path())).unwrap()
    };
    let own = info(shipped);
    let grow = |width: &str| {
        ["model", "grow", "--checkpoint", shipped, "--width", width, "--out", "grown.safetensors"]
            .map(String::from)
            .to_vec()
    };
    let width = 2 * own["config"]["width"].as_u64().unwrap();
    let wide = grow(&width.to_string());
    good(&wide.iter().map(String::as_str).collect::<Vec<_>>(), folder.path());
    let grown = info("grown.safetensors");
    assert_eq!(grown["config"]["width"].as_u64(), Some(width));
    assert_eq!(grown["config"]["vision_depth"], own["config"]["vision_depth"]);
    assert!(grown["metadata"]["name"].as_str().unwrap().ends_with(", grown"));
    let error = refused(&grow("16").iter().map(String::as_str).collect::<Vec<_>>(), folder.path());
    assert!(error.contains("width: expected at least the"), "{error}");

    good(&["model", "half", "--checkpoint", "grown.safetensors", "--out", "half.safetensors"], folder.path());
    let half = info("half.safetensors");
    assert_eq!((&half["config"], &half["metadata"]), (&grown["config"], &grown["metadata"]));
    let bytes = |file: &str| folder.path().join(file).metadata().unwrap().len() as f64;
    assert!((bytes("half.safetensors") / bytes("grown.safetensors") - 0.5).abs() < 0.01);
}
