//! `egotac experiment` from rendering to tables, at the smallest size there is.
#![cfg(feature = "sim")]

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn experiment(work: &Path, out: &Path, more: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_egotac-bench"))
        .args(["experiment", "sources", "--seeds", "1", "--episodes", "1", "--held-out", "1"])
        .arg("--work")
        .arg(work)
        .arg("--out")
        .arg(out)
        .args(more)
        .output()
        .unwrap()
}

#[test]
fn an_experiment_writes_its_tables_and_repeats_no_run() {
    let folder = tempfile::tempdir().unwrap();
    let [work, first, second] = ["work", "first", "second"].map(|name| folder.path().join(name));
    let output = experiment(&work, &first, &["--encoder-steps", "2", "--steps", "2"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(text.starts_with("4 runs to make, 240 windows altogether"), "{text}");

    let json = fs::read_to_string(first.join("sources.json")).unwrap();
    let report: Value = serde_json::from_str(&json).unwrap();
    let names: Vec<&str> = report["arms"].as_array().unwrap().iter().map(|arm| arm["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["mixed", "force_supervised", "contact_only"]);
    let markdown = fs::read_to_string(first.join("sources.md")).unwrap();
    for arm in report["arms"].as_array().unwrap() {
        assert!(markdown.contains(arm["name"].as_str().unwrap()));
        for domain in ["in_domain", "out_of_domain"] {
            let scores = &arm[domain]["seeds"][0];
            let auroc = scores["pooled"]["auroc"].as_f64().unwrap();
            assert!((0.0..=1.0).contains(&auroc));
            // Who has never seen a force says so.
            assert_eq!(scores["active_mae"].is_null(), arm["name"] == "contact_only", "{arm}");
        }
    }
    // What sees no image stands beside what does, in both domains and both tables.
    let baselines: Vec<&str> =
        report["baselines"].as_array().unwrap().iter().map(|own| own["name"].as_str().unwrap()).collect();
    assert_eq!(baselines, ["zero", "mean", "median", "persistence"]);
    for name in baselines {
        assert_eq!(markdown.matches(&format!("\n| {name} | ")).count(), 4, "{name}");
    }
    assert_eq!(report["baselines"][0]["in_domain"]["frame_mean"]["f1"], 0.0);
    for heading in ["F1, frame mean", "F1, pooled", "| false-positive rate |", "spectral convergence"] {
        assert_eq!(markdown.matches(heading).count(), 2, "{heading}");
    }
    // The mixed arm learns from both sources, the others from one each.
    let frames = |arm: usize| report["arms"][arm]["training_frames"].as_u64().unwrap();
    assert_eq!(frames(0), frames(1) + frames(2));
    for picture in ["sources.png", "sources.svg"] {
        assert!(fs::metadata(first.join(picture)).unwrap().len() > 1000);
    }

    let output = experiment(&work, &second, &["--encoder-steps", "2", "--steps", "2"]);
    assert!(String::from_utf8_lossy(&output.stdout).starts_with("0 runs to make, 0 windows"));
    assert_eq!(fs::read_to_string(second.join("sources.json")).unwrap(), json);
}

#[test]
fn an_unknown_experiment_is_refused_before_data_is_made() {
    let folder = tempfile::tempdir().unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_egotac-bench"))
        .args(["experiment", "ablation"])
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert!(!output.status.success());
    assert!(String::from_utf8_lossy(&output.stderr).contains("ablations, sources, scaling, limits"));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}
