//! `egotac bench model` as a user runs it.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn egotac(arguments: &[&str], folder: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_egotac-bench")).args(arguments).current_dir(folder).output().unwrap()
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
fn bench_prints_one_configuration_as_json() {
    let folder = tempfile::tempdir().unwrap();
    for precision in ["f32", "bf16", "int8"] {
        let text = good(
            &["bench", "model", "--preset", "toy", "--threads", "1", "--precision", precision, "--runs", "3", "--json"],
            folder.path(),
        );
        let row: Value = serde_json::from_str(&text).unwrap();
        for key in ["streaming_ms", "clip_ms", "encoder_ms", "picture_ms", "peak_memory_mb", "weights_mb"] {
            assert!(row[key].as_f64().unwrap() > 0.0, "{key} in {text}");
        }
        assert_eq!((row["precision"].as_str(), row["preset"].as_str()), (Some(precision), Some("toy")));
        for times in ["encoder", "streaming", "clip", "picture"] {
            let [min, p50, p95] = ["min", "p50", "p95"].map(|key| row[times][key].as_f64().unwrap());
            assert!(0.0 < min && min <= p50 && p50 <= p95, "{times} in {text}");
        }
    }
}

#[test]
fn bench_writes_table_json_and_plot() {
    let folder = tempfile::tempdir().unwrap();
    let peer = r#"#!/bin/sh
echo '{"encoder_ms": 1000, "streaming_ms": 2000, "clip_ms": 4000, "openvino_encoder_ms": 500}'
"#;
    std::fs::write(folder.path().join("peer.sh"), peer).unwrap();
    let text = good(
        &[
            "bench",
            "model",
            "--preset",
            "toy",
            "--horizon",
            "1,3",
            "--precision",
            "f32,int8",
            "--threads",
            "1",
            "--runs",
            "2",
            "--peer",
            "sh peer.sh",
            "--rounds",
            "2",
            "--out",
            "out",
        ],
        folder.path(),
    );
    for file in ["model.md", "model.json", "model.png", "model.svg"] {
        assert!(folder.path().join("out").join(file).is_file(), "{file}");
    }
    let report: Value = serde_json::from_slice(&std::fs::read(folder.path().join("out/model.json")).unwrap()).unwrap();
    assert_eq!(report["rows"].as_array().unwrap().len(), 4);
    assert_eq!(report["rounds"][0]["peer"].as_array().unwrap().len(), 2);
    assert_eq!(std::fs::read_to_string(folder.path().join("out/model.md")).unwrap(), text);
    assert!(text.contains("egotac bench model --preset toy --horizon 1,3 --precision f32,int8"), "{text}");
    assert!(text.contains("| toy | OpenVINO | 500.0 |") && text.contains("| — | — |"), "{text}");
}

#[test]
fn a_stream_of_the_toy_network_keeps_its_memory() {
    let folder = tempfile::tempdir().unwrap();
    let text =
        good(&["bench", "model", "--preset", "toy", "--threads", "1", "--growth", "3000", "--json"], folder.path());
    let growth: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(growth["frames"], 3000);
    assert!(growth["end_mb"].as_f64().unwrap() - growth["warm_mb"].as_f64().unwrap() < 8.0, "{text}");
}

#[test]
fn wrong_arguments_are_refused_with_the_valid_ones() {
    let folder = tempfile::tempdir().unwrap();
    let bench = |more: &[&str]| refused(&[&["bench", "model"], more].concat(), folder.path());
    assert!(bench(&["--preset", "huge"]).contains("known: toy, pocket, tiny, small, base"));
    assert!(bench(&["--precision", "int4"]).contains("f32, bf16, int8"));
    assert!(bench(&["--preset", "toy,tiny"]).contains("several values need --out"));
    assert!(bench(&["--preset", "toy", "--size", "57"]).contains("config.image"));
    assert!(bench(&["--preset", "toy", "--threads", "0"]).contains("1 to 1024"));
}
