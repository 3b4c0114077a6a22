//! Labels of LeRobot data sets as inputs of policies, and data sets of versions 2.0 and 2.1. tests/peers/policy_inputs.py builds
//! policies on the outputs.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type};
use arrow_array::{Array, RecordBatch};
use egotac::dataset::Labelled;
use egotac::dataset::lerobot::reader;
use serde_json::Value;

const DATA: &str = "tests/data/lerobot";
const ROWS: &str = "data/chunk-000/file-000.parquet";
const STATE: &str = "observation.state";
const ENVIRONMENT: &str = "observation.environment_state";

fn label(input: &Path, out: &Path, more: &[&str]) -> Output {
    let [input, out] = [input, out].map(|path| path.to_str().unwrap());
    let args = [&["label", input, "--out", out], more].concat();
    Command::new(env!("CARGO_BIN_EXE_egotac")).args(args).output().unwrap()
}

fn labelled(name: &str, out: PathBuf, more: &[&str]) -> PathBuf {
    let output = label(&Path::new(DATA).join(name), &out, more);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    out
}

fn refused(input: &Path, more: &[&str]) -> String {
    let folder = tempfile::tempdir().unwrap();
    let output = label(input, &folder.path().join("out"), more);
    assert!(!output.status.success());
    String::from_utf8(output.stderr).unwrap()
}

fn rows(file: &Path) -> RecordBatch {
    reader(file).unwrap().with_batch_size(1000).build().unwrap().next().unwrap().unwrap()
}

fn lists(rows: &RecordBatch, name: &str) -> Vec<Vec<f32>> {
    let column = rows.column_by_name(name).unwrap().as_fixed_size_list();
    (0..column.len()).map(|row| column.value(row).as_primitive::<Float32Type>().values().to_vec()).collect()
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn labels_are_appended_to_the_state_with_its_statistics() {
    let folder = tempfile::tempdir().unwrap();
    let options = ["--as", "state", "--columns", "total,region_force", "--unknown", "guess"];
    let out = labelled("video", folder.path().join("out"), &options);
    let before = lists(&rows(&Path::new(DATA).join("video").join(ROWS)), STATE);
    let after = rows(&out.join(ROWS));
    let (state, regions) = (lists(&after, STATE), lists(&after, "tactile.region_force"));
    for row in 0..12 {
        assert_eq!(state[row][..3], before[row][..]);
        assert_eq!(state[row][5..39], regions[row][..]);
        for side in 0..2 {
            let sum: f32 = regions[row][17 * side..][..17].iter().sum();
            assert!((state[row][3 + side] - sum).abs() < 1e-4 * sum.max(1.0));
        }
        assert_eq!(state[row][39..], [1.0, 1.0], "a guess counts as known");
    }
    let info = json(&out.join("meta/info.json"));
    let feature = &info["features"][STATE];
    assert_eq!(feature["shape"], serde_json::json!([41]));
    let names: Vec<&str> = feature["names"].as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect();
    assert_eq!(names[..6], ["a", "b", "c", "left_total", "right_total", "left_thumb_tip_region_force"]);
    assert_eq!((names.len(), &names[39..]), (41, &["left_known", "right_known"][..]));
    let stats = json(&out.join("meta/stats.json"));
    for element in [0, 2, 4, 40] {
        let values: Vec<f64> = state.iter().map(|row| f64::from(row[element])).collect();
        let mean = values.iter().sum::<f64>() / 12.0;
        assert!((stats[STATE]["mean"][element].as_f64().unwrap() - mean).abs() < 1e-6, "{element}");
    }
    let episodes = rows(&out.join("meta/episodes/chunk-000/file-000.parquet"));
    let column = episodes.column_by_name(&format!("stats/{STATE}/max")).unwrap().as_list::<i32>();
    let most = column.value(1).as_primitive::<Float64Type>().values().to_vec();
    assert_eq!((most.len(), most[2]), (41, 1.0), "the second episode has 1 as its third number");
    // The labels can still be read, and are not appended twice.
    assert_eq!(Labelled::read(&out).unwrap().labels.n_frames(), 12);
    let error = refused(&out, &["--as", "state", "--prefix", "again"]);
    assert!(error.contains("observation.state holds labels already"), "{error}");
}

#[test]
fn unknown_touch_is_zero_in_an_environment_state_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    // The pictures are made up, so that the network knows touch in none of them.
    let out = labelled("video", folder.path().join("out"), &["--as", "environment_state"]);
    let environment = lists(&rows(&out.join(ROWS)), ENVIRONMENT);
    assert!(environment.iter().all(|row| row.len() == 36 && row.iter().all(|value| *value == 0.0)));
    assert!(lists(&rows(&out.join(ROWS)), "tactile.region_force").iter().flatten().all(|force| force.is_nan()));
    let guessed = labelled("video", folder.path().join("guess"), &["--as", "environment_state", "--unknown", "guess"]);
    let environment = lists(&rows(&guessed.join(ROWS)), ENVIRONMENT);
    assert!(environment.iter().all(|row| row[34..] == [1.0, 1.0]) && environment.iter().flatten().any(|v| *v > 0.0));
    let again = refused(&guessed, &["--as", "environment_state", "--prefix", "again"]);
    assert!(again.contains("holds labels already"), "{again}");
}

#[test]
fn columns_are_chosen_and_wrong_choices_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let out = labelled("video", folder.path().join("out"), &["--columns", "total"]);
    let schema = rows(&out.join(ROWS)).schema();
    let names: Vec<&str> = schema.fields().iter().map(|field| field.name().as_str()).collect();
    let ours: Vec<&&str> = names.iter().filter(|name| name.starts_with("tactile.")).collect();
    assert_eq!(ours, [&"tactile.total", &"tactile.certainty"]);
    let input = Path::new(DATA).join("video");
    let error = refused(&input, &["--observation"]);
    assert!(error.contains("--as environment_state") && error.contains("--as state"), "{error}");
    let error = refused(&input, &["--prefix", "observation.tactile"]);
    assert!(error.contains("--as"), "{error}");
    let error = refused(&input, &["--columns", "total,total"]);
    assert!(error.contains("total twice"), "{error}");
}

#[test]
fn data_sets_of_version_2_are_labelled_in_their_version() {
    let folder = tempfile::tempdir().unwrap();
    let out = labelled("v21", folder.path().join("out"), &["--as", "state", "--unknown", "guess"]);
    let tensors = labelled("v21", folder.path().join("out.safetensors"), &["--to", "tensors", "--unknown", "guess"]);
    let labels = egotac::dataset::tensors::read(&tensors).unwrap();
    assert_eq!(labels.episode_ends, [7, 12]);
    assert_eq!(json(&out.join("meta/info.json"))["codebase_version"], "v2.1");
    let text = fs::read_to_string(out.join("meta/episodes_stats.jsonl")).unwrap();
    let stats: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(stats.len(), 2);
    for (episode, range) in [(0, 0..7), (1, 7..12)] {
        let rows = rows(&out.join(format!("data/chunk-000/episode_{episode:06}.parquet")));
        let force = lists(&rows, "tactile.force").concat();
        assert!(force == labels.force[1556 * range.start..1556 * range.end], "episode {episode}");
        let state = lists(&rows, STATE);
        assert!(state.iter().all(|row| row.len() == 39 && row[37..] == [1.0, 1.0]));
        let highest = state.iter().map(|row| f64::from(row[10])).fold(f64::MIN, f64::max);
        assert_eq!(stats[episode]["stats"][STATE]["max"][10], highest);
        assert_eq!(stats[episode]["stats"][STATE]["count"], serde_json::json!([range.len()]));
        // Statistics of other columns stay.
        assert!(stats[episode]["stats"]["action"]["mean"].is_array());
    }
    assert!(!out.join("meta/stats.json").exists() && !out.join("meta/episodes").exists());
    let read = Labelled::read(&out).unwrap().labels;
    assert!(read.force == labels.force && read.episode_ends == labels.episode_ends);

    // Version 2.0 has statistics of all episodes alone.
    let old = folder.path().join("old");
    assert!(Command::new("cp").arg("-r").args([Path::new(DATA).join("v21"), old.clone()]).status().unwrap().success());
    fs::remove_file(old.join("meta/episodes_stats.jsonl")).unwrap();
    fs::write(old.join("meta/stats.json"), r#"{"action": {"mean": [1.0, 2.0]}}"#).unwrap();
    let info = fs::read_to_string(old.join("meta/info.json")).unwrap().replace("v2.1", "v2.0");
    fs::write(old.join("meta/info.json"), info).unwrap();
    let output = label(&old, &folder.path().join("new"), &["--unknown", "guess"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let stats = json(&folder.path().join("new/meta/stats.json"));
    assert_eq!(stats["action"]["mean"], serde_json::json!([1.0, 2.0]));
    assert_eq!(stats["tactile.force"]["count"], serde_json::json!([12]));
}

#[test]
fn damaged_metadata_of_version_2_names_file_and_line() {
    let folder = tempfile::tempdir().unwrap();
    let input = folder.path().join("in");
    assert!(
        Command::new("cp").arg("-r").args([Path::new(DATA).join("v21"), input.clone()]).status().unwrap().success()
    );
    for (line, expected) in [
        ("{\"episode_index\": 0}", "length"),
        ("{\"episode_index\": -1, \"length\": 7}", "got -1 and 7"),
        ("{\"episode_index\": 0, \"length\": 0}", "at least 1, got 0 and 0"),
    ] {
        fs::write(input.join("meta/episodes.jsonl"), line).unwrap();
        let error = refused(&input, &[]);
        assert!(error.contains("episodes.jsonl: line 1: ") && error.contains(expected), "{error}");
    }
}
