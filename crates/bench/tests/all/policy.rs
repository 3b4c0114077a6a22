//! `egotac experiment policy`: the task's mechanics against facts, and the whole chain at its smallest size.
#![cfg(feature = "sim")]

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use egotac_bench::policy::control::{constant, expert, run};
use egotac_bench::policy::task::{End, Hidden, Trial};
use serde_json::Value;

/// Seeds below `count` whose ball has a mass within `range`, kg.
fn seeds(range: std::ops::Range<f64>, count: usize) -> Vec<u64> {
    (0..).filter(|seed| range.contains(&Hidden::draw(*seed).mass)).take(count).collect()
}

#[test]
fn the_expert_lifts_balls_of_every_weight() {
    let seeds: Vec<u64> = (0..24).collect();
    let failed: Vec<_> =
        seeds.iter().map(|seed| run(*seed, expert).unwrap()).filter(|outcome| outcome.end != End::Lifted).collect();
    assert!(failed.len() <= 1, "{failed:?}");
}

#[test]
fn a_weak_grip_drops_heavy_balls_and_a_strong_one_crushes_light_ones() {
    for seed in seeds(0.22..0.3, 4) {
        assert_eq!(run(seed, |trial| Ok(constant(trial, 0.35))).unwrap().end, End::Dropped);
    }
    for seed in seeds(0.06..0.08, 4) {
        assert_eq!(run(seed, |trial| Ok(constant(trial, 5.6))).unwrap().end, End::Crushed);
    }
}

#[test]
fn the_hand_carries_the_weight_and_the_thumb_below_tells_it() {
    let held = |seed: u64| {
        let mut trial = Trial::start(seed, None).unwrap();
        while trial.act(expert(&trial).unwrap(), true).unwrap() {}
        let (grasp, weight) = (trial.grasp().unwrap(), 9.81 * trial.hidden.mass);
        assert!((grasp.load - weight).abs() < 0.05 * weight, "{grasp:?}, {weight} N");
        grasp.thumb - grasp.fingers
    };
    let (light, heavy) = (seeds(0.06..0.08, 3), seeds(0.22..0.3, 3));
    for (light, heavy) in light.into_iter().zip(heavy) {
        let (light, heavy) = (held(light), held(heavy));
        assert!(heavy > light + 0.1, "{light} N, {heavy} N");
    }
}

fn experiment(work: &Path, out: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_egotac-bench"))
        .args(["experiment", "policy", "--quick"])
        .arg("--work")
        .arg(work)
        .arg("--out")
        .arg(out)
        .output()
        .unwrap()
}

#[test]
fn the_experiment_writes_its_table_and_repeats_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let [work, first, second] = ["work", "first", "second"].map(|name| folder.path().join(name));
    let output = experiment(&work, &first);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));

    let json = fs::read_to_string(first.join("policy.json")).unwrap();
    let report: Value = serde_json::from_str(&json).unwrap();
    let rows = report["rows"].as_array().unwrap();
    let names: Vec<&str> = rows.iter().map(|row| row["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["expert", "constant_grip", "image", "image_predicted_touch", "image_true_touch"]);
    // All are tried on the same balls.
    let masses = |row: &Value| -> Vec<f64> {
        row["outcomes"][0].as_array().unwrap().iter().map(|outcome| outcome["mass"].as_f64().unwrap()).collect()
    };
    assert_eq!(masses(&rows[0]).len(), 3);
    assert!(rows.iter().all(|row| masses(row) == masses(&rows[0])));
    let markdown = fs::read_to_string(first.join("policy.md")).unwrap();
    assert!(names.iter().all(|name| markdown.contains(&format!("| {name} |"))));
    for picture in ["policy.png", "policy.svg"] {
        assert!(fs::metadata(first.join(picture)).unwrap().len() > 1000);
    }

    // A second run finds all results, and would have made others if a file's weights did not count.
    let runs = fs::read_dir(work.join("policy")).unwrap().count();
    assert!(experiment(&work, &second).status.success());
    assert_eq!(fs::read_to_string(second.join("policy.json")).unwrap(), json);
    assert_eq!(fs::read_dir(work.join("policy")).unwrap().count(), runs);
}
