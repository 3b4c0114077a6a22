//! The shipped checkpoint has the size and the scores of its card.

use std::path::{Path, PathBuf};

use egotac::hand::Topology;
use egotac::model::{Checkpoint, checkpoint, shipped};
use serde_json::Value;

fn root(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// Scores that distinguish a network that uses the image from a constant.
struct Scores {
    active_mae: f64,
    temporal_pearson: Option<f64>,
    auroc: f64,
}

/// Returns the scores of the model, then those of the constant predictors.
fn read(report: &Value) -> (Scores, Vec<Scores>) {
    let scores = |of: &Value| Scores {
        active_mae: of["active_mae"].as_f64().unwrap(),
        temporal_pearson: of["temporal_pearson"].as_f64(),
        auroc: of["pooled"]["auroc"].as_f64().unwrap(),
    };
    (scores(report), ["zero", "mean", "median"].map(|name| scores(&report["baselines"][name])).into())
}

/// Asserts that the network is better than every constant. The pooled AUROC is compared by its distance to 1, at most two
/// fifths of that of the best constant: where a scene touches few vertices, a constant that knows them reaches 0.96.
fn assert_beats_constants(reports: &Value) {
    let (model, constants) = read(reports);
    let best = |score: fn(&Scores) -> f64| constants.iter().map(score);
    let (error, auroc) = (best(|s| s.active_mae).fold(f64::MAX, f64::min), best(|s| s.auroc).fold(0.0, f64::max));
    assert!(model.active_mae <= 0.8 * error, "active MAE {} N against {error} N", model.active_mae);
    assert!(1.0 - model.auroc <= 0.4 * (1.0 - auroc), "AUROC {} against {auroc}", model.auroc);
    assert!(model.temporal_pearson.unwrap() >= 0.5, "temporal Pearson {:?}", model.temporal_pearson);
}

#[test]
fn it_is_small_and_for_the_built_in_hand() {
    let path = shipped::path().unwrap();
    assert_eq!(path, root("models/egotac.safetensors"));
    assert!(path.metadata().unwrap().len() <= 12_000_000);
    let checkpoint = Checkpoint::load(&path, &candle_core::Device::Cpu).unwrap();
    assert_eq!(checkpoint.metadata.topology, Topology::EgotacHand1);
    assert!(checkpoint::parameter_count(checkpoint.model.config()).unwrap() <= 6_000_000);
}

#[test]
fn its_card_shows_the_scores_that_the_commands_wrote() {
    let card = std::fs::read_to_string(root("models/README.md")).unwrap();
    for file in ["models/egotac.eval.json", "models/egotac.eval-2.json", "models/egotac.eval-first.json"] {
        let report: Value = serde_json::from_str(&std::fs::read_to_string(root(file)).unwrap()).unwrap();
        assert_beats_constants(&report);
        let rows = [
            ("contact F1, frame mean", "/frame_mean/f1", "frame_mean.f1"),
            ("contact IoU, frame mean", "/frame_mean/iou", "frame_mean.iou"),
            ("contact AUROC, frame mean", "/frame_mean/auroc", "frame_mean.auroc"),
            ("false-positive rate in frames without contact", "/false_positive_rate", "false_positive_rate"),
            ("contact F1, pooled", "/pooled/f1", "pooled.f1"),
            ("contact AUROC, pooled", "/pooled/auroc", "pooled.auroc"),
            ("MAE (N)", "/mae", "mae"),
            ("active MAE (N)", "/active_mae", "active_mae"),
            ("temporal Pearson", "/temporal_pearson", "temporal_pearson"),
            ("force cosine", "/force_cosine", "force_cosine"),
            ("rise F1", "/rise_f1", "rise_f1"),
            ("fall F1", "/fall_f1", "fall_f1"),
            ("DFT Pearson", "/dft_pearson", "dft_pearson"),
            ("spectral convergence", "/spectral_convergence", "spectral_convergence"),
            ("dominant frequency error (Hz)", "/dominant_frequency_error_hz", "dominant_frequency_error_hz"),
        ];
        for (name, pointer, score) in rows {
            let cell = |of: &Value| match of.pointer(pointer).and_then(Value::as_f64) {
                Some(value) => format!("{value:.4}"),
                None => "undefined".into(),
            };
            let end = |at: usize| report["intervals"][score][at].as_f64().unwrap();
            let interval = format!("{:.4} .. {:.4}", end(0), end(1));
            let baselines = ["zero", "mean", "median", "persistence"].map(|name| cell(&report["baselines"][name]));
            let row = format!("| {name} | {} | {interval} | {} |", cell(&report), baselines.join(" | "));
            assert!(card.contains(&row), "models/README.md lacks the row of {file}: {row}");
        }
    }
}

#[test]
fn the_readme_shows_rows_that_the_demo_wrote() {
    let written = std::fs::read_to_string(root("docs/demo/metrics.md")).unwrap();
    let readme = std::fs::read_to_string(root("README.md")).unwrap();
    let header = "| predicted against the simulator's truth |";
    let table = readme.lines().skip_while(|line| !line.starts_with(header)).take_while(|line| line.starts_with('|'));
    let rows: Vec<&str> = table.collect();
    assert!(rows.len() > 5, "README.md lacks the table of the demo");
    for row in rows {
        assert!(written.lines().any(|line| line == row), "docs/demo/metrics.md lacks the row of README.md: {row}");
    }
}

#[test]
fn pages_have_no_broken_links() {
    let docs = std::fs::read_dir(root("docs")).unwrap().map(|entry| entry.unwrap().path());
    let pages = docs.filter(|path| path.extension().is_some_and(|extension| extension == "md"));
    let others = ["README.md", "models/README.md", "sim/README.md"].map(root);
    for file in pages.chain(others) {
        let text = std::fs::read_to_string(&file).unwrap();
        let folder = file.parent().unwrap().to_path_buf();
        for link in text.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            let target = link.split('#').next().unwrap();
            assert!(link.starts_with("http") || folder.join(target).exists(), "{} links to {link}", file.display());
        }
    }
}

#[cfg(feature = "sim")]
#[test]
fn it_beats_constants_on_unseen_rollouts() {
    let folder = tempfile::tempdir().unwrap();
    let egotac = |arguments: &str| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_egotac"));
        let output = command.args(arguments.split(' ')).current_dir(&folder).output().unwrap();
        assert!(output.status.success(), "{arguments}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    egotac("sim generate pinch_cube lift_mug hover --episodes 12 --seed 700000 --size 224 --out test.zarr");
    let checkpoint = root("models/egotac.safetensors");
    let scores = egotac(&format!(
        // The constants are means of the test set itself, which are harder to beat than those of the training set.
        "eval --checkpoint {} --data test.zarr --baselines-from test.zarr --json",
        checkpoint.display()
    ));
    assert_beats_constants(&serde_json::from_str(&scores).unwrap());
}
