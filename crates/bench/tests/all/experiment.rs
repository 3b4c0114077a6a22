//! `egotac experiment` from rendering to tables, at the smallest size there is.
#![cfg(feature = "sim")]

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn experiment(name: &str, work: &Path, out: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_egotac-bench"))
        .args(["experiment", name, "--quick", "--work"])
        .arg(work)
        .arg("--out")
        .arg(out)
        .output()
        .unwrap()
}

/// Runs an experiment that must succeed; returns what it printed and told, and its JSON.
fn done(name: &str, work: &Path, out: &Path) -> (String, Value) {
    let output = experiment(name, work, out);
    assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
    let json = fs::read_to_string(out.join(format!("{name}.json"))).unwrap();
    let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
    (text, serde_json::from_str(&json).unwrap())
}

fn arm<'a>(report: &'a Value, name: &str) -> &'a Value {
    report["arms"].as_array().unwrap().iter().find(|arm| arm["name"] == name).unwrap()
}

#[test]
fn an_experiment_writes_its_tables_and_repeats_no_run() {
    let folder = tempfile::tempdir().unwrap();
    let [work, first, second] = ["work", "first", "second"].map(|name| folder.path().join(name));
    let (text, report) = done("sources", &work, &first);
    assert!(text.contains("10 runs to make, 80 windows altogether"), "{text}");

    let names: Vec<&str> = report["arms"].as_array().unwrap().iter().map(|arm| arm["name"].as_str().unwrap()).collect();
    assert_eq!(names[..5], ["force_only", "plus_1", "plus_2", "plus_3", "contact_only"]);
    assert_eq!(names[5..], ["zero", "mean", "median", "persistence"]);
    let markdown = fs::read_to_string(first.join("sources.md")).unwrap();
    for (name, force) in [("force", true), ("contact", false), ("ood_force", true), ("ood_contact", false)] {
        let scores = &arm(&report, "plus_3")["tests"][name];
        assert_eq!(scores["seeds"].as_array().unwrap().len(), 2);
        assert_eq!(scores["seeds"][0]["mae"].is_null(), !force, "{name}");
        assert_eq!(scores["differences"].as_array().unwrap().len(), 2);
    }
    // No force trains the last arm, and its head is scored as it is.
    assert!(arm(&report, "contact_only")["tests"]["force"]["seeds"][0]["active_mae"].as_f64().unwrap() > 0.0);
    names.iter().for_each(|name| assert!(markdown.contains(&format!("| {name} |")), "{name}"));
    // Each arm learns from one source more than the one before it, and the last from all but the first.
    let frames = |name: &str| arm(&report, name)["training_frames"].as_u64().unwrap();
    assert_eq!(frames("plus_3"), frames("force_only") + frames("contact_only"));
    assert!(frames("force_only") < frames("plus_1") && frames("plus_1") < frames("plus_2"));
    for picture in ["sources.png", "sources.svg"] {
        assert!(fs::metadata(first.join(picture)).unwrap().len() > 1000);
    }

    let (text, again) = done("sources", &work, &second);
    assert!(text.contains("0 runs to make, 0 windows"), "{text}");
    assert_eq!(again, report);
    // Another experiment takes the runs that are equal: here those of its first arm.
    let (text, history) = done("history", &work, &second);
    assert!(text.contains("2 runs to make, 16 windows altogether"), "{text}");
    assert_eq!(arm(&history, "mixed")["tests"]["force"]["seeds"], arm(&report, "plus_3")["tests"]["force"]["seeds"]);

    check_the_per_frame_baseline(&work, &second);
    check_forces_from_motion(&work, &second);

    let output = experiment("results", &work, &first);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let page = fs::read_to_string(first.join("README.md")).unwrap();
    assert!(page.contains("[sources](sources.md)") && page.contains("`plus_3`: F1, frame mean"), "{page}");
    assert!(page.contains("| `egotac experiment glove` |"), "{page}");
}

/// Checks that forces from motion are learned from stores of their own, with the frames of the true ones.
fn check_forces_from_motion(work: &Path, out: &Path) {
    let (text, report) = done("motion", work, out);
    assert!(text.contains("recovers"), "{text}");
    let frames = |name: &str| arm(&report, name)["training_frames"].as_u64().unwrap();
    assert_eq!(frames("from_motion"), frames("true_force"));
    let estimated = fs::read_dir(work.join("data")).unwrap().map(|entry| entry.unwrap().path());
    let estimated: Vec<_> = estimated.filter(|path| path.to_string_lossy().ends_with(".motion.zarr")).collect();
    let store = egotac::dataset::zarr::ZarrReader::open(&estimated[0]).unwrap();
    let force = store.read_f32("data/mano_force", 0..store.len()).unwrap();
    let truth = estimated[0].to_string_lossy().replace(".motion.zarr", ".zarr");
    let truth = egotac::dataset::zarr::ZarrReader::open(Path::new(&truth)).unwrap();
    let truth = truth.read_f32("data/mano_force", 0..truth.len()).unwrap();
    let sum = |values: &[f32]| values.iter().filter(|value| value.is_finite()).sum::<f32>();
    // A held object pushes about as hard as it is estimated to, and not exactly so.
    let ratio = sum(&force) / sum(&truth);
    assert!(force != truth && (0.2..5.0).contains(&ratio), "{ratio}");
}

/// Checks that the baseline sees one hand at a time, on the same vertices as the network, and says nothing of force.
fn check_the_per_frame_baseline(work: &Path, out: &Path) {
    let (_, report) = done("separation", work, out);
    let crop = &arm(&report, "crop")["tests"]["ood_force"]["seeds"][0];
    let whole = &arm(&report, "mixed")["tests"]["ood_force"]["seeds"][0];
    assert!(crop["active_mae"].is_null() && whole["active_mae"].is_number());
    // Both are scored on the same vertices: those of the right hand.
    assert_eq!(crop["counts"]["contact_entries"], whole["counts"]["contact_entries"]);
    let (entries, frames) = (&whole["counts"]["contact_entries"], &whole["counts"]["frames"]);
    assert!(entries.as_u64().unwrap() <= 778 * frames.as_u64().unwrap());
    assert!(crop["pooled"]["auroc"].is_number(), "{crop}");
}

#[test]
fn a_finished_network_is_measured_on_worse_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let work = folder.path().join("work");
    let (_, report) = done("decline", &work, folder.path());
    let score =
        |name: &str, of: &str| arm(&report, name)["tests"]["known"]["seeds"][0]["frame_mean"][of].as_f64().unwrap();
    assert!(score("clean", "auroc") > score("occlusion 75%", "auroc"));
    assert!(fs::metadata(folder.path().join("decline.png")).unwrap().len() > 1000);
    // Conditions are kept: what was measured is read again.
    let kept = fs::read_dir(work.join("measured")).unwrap().next().unwrap().unwrap().path();
    assert_eq!(fs::read_dir(kept).unwrap().count(), report["arms"].as_array().unwrap().len() - 4);
    assert_eq!(arm(&report, "zero")["tests"]["ood"]["seeds"][0]["frame_mean"]["f1"], 0.0);
}

#[test]
fn a_finished_network_is_measured_with_other_sensors() {
    let folder = tempfile::tempdir().unwrap();
    let (_, report) = done("transfer", &folder.path().join("work"), folder.path());
    let of = |name: &str, of: &str| arm(&report, name)["tests"]["known"]["seeds"][0][of].as_f64().unwrap();
    assert!(of("same", "temporal_pearson") > 0.3, "{report}");
    assert!(of("all", "mae") != of("same", "mae"));
}

#[test]
fn images_that_hardly_change_and_patches_without_hands_are_not_encoded() {
    let folder = tempfile::tempdir().unwrap();
    let (text, report) = done("reuse", &folder.path().join("work"), folder.path());
    let rows = report["rows"].as_array().unwrap();
    let encoded: Vec<f64> = rows.iter().map(|row| row["encoded"].as_f64().unwrap()).collect();
    // Two cameras, on the head and on a stand, each with all images, with much reuse, and with patches near the hands alone.
    assert_eq!((encoded.len(), encoded[0], encoded[3]), (6, 1.0, 1.0));
    assert!(encoded[1] <= 1.0 && encoded[4] < 1.0, "{encoded:?}");
    assert!([2, 5].iter().all(|row| encoded[*row] < 1.0 && rows[*row]["focus"]["after"] == 0), "{encoded:?}");
    assert_eq!(rows[0]["scores"]["differences"], Value::Null);
    assert!(rows[4]["scores"]["differences"][0].is_array() && text.contains("## Camera on a stand"), "{text}");
    assert!(fs::metadata(folder.path().join("reuse.png")).unwrap().len() > 1000);
}

#[test]
fn attention_is_shared_out_over_hands_objects_and_touch() {
    let folder = tempfile::tempdir().unwrap();
    let (text, report) = done("attention", &folder.path().join("work"), folder.path());
    let shares = report["worlds"][0]["shares"].as_array().unwrap();
    assert_eq!(shares.len(), 6);
    for share in shares {
        let [area, attention, ratio] = ["area", "attention", "ratio"].map(|key| share[key].as_f64().unwrap());
        assert!(
            (0.0..1.0).contains(&area) && (0.0..1.0).contains(&attention) && (ratio - attention / area).abs() < 1e-9
        );
    }
    assert!(text.contains("| temporal token | hand |"));
    assert!(fs::metadata(folder.path().join("attention.png")).unwrap().len() > 1000);
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
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(error.contains("ablations") && error.contains("separation"), "{error}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}
