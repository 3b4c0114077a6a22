//! `egotac label` on LeRobot v3 data sets written by the package lerobot (tests/data/lerobot). tests/peers/lerobot_reads.py
//! checks that lerobot loads the labelled data sets.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type, Int64Type};
use arrow_array::{Array, Int64Array, RecordBatch};
use egotac::TactileField;
use egotac::dataset::lerobot::reader;
use egotac::dataset::video::VideoFrames;
use egotac::hand::{HandModel, Side};
use egotac::model::predictor::{Options, Predictor};
use egotac::model::{Unknown, shipped};
use egotac::tactile::N_FIELD;
use image::RgbImage;
use parquet::arrow::ArrowWriter;
use serde_json::Value;

const DATA: &str = "tests/data/lerobot";
const LENGTHS: [usize; 2] = [7, 5];

fn label(input: &Path, out: &Path, more: &[&str]) -> Output {
    let [input, out] = [input, out].map(|path| path.to_str().unwrap());
    let args = [&["label", input, "--out", out, "--unknown", "guess", "--json", "-"], more].concat();
    Command::new(env!("CARGO_BIN_EXE_egotac")).args(args).output().unwrap()
}

fn summary(output: &Output, status: i32) -> Value {
    assert_eq!(output.status.code(), Some(status), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Returns the only batch of a Parquet file.
fn table(root: &Path, file: &str) -> RecordBatch {
    let mut batches = reader(&root.join(file)).unwrap().with_batch_size(1000).build().unwrap();
    let batch = batches.next().unwrap().unwrap();
    assert!(batches.next().is_none());
    batch
}

const ROWS: &str = "data/chunk-000/file-000.parquet";
const EPISODES: &str = "meta/episodes/chunk-000/file-000.parquet";

fn lists(rows: &RecordBatch, name: &str) -> Vec<Vec<f32>> {
    let column = rows.column_by_name(name).unwrap().as_fixed_size_list();
    (0..column.len()).map(|row| column.value(row).as_primitive::<Float32Type>().values().to_vec()).collect()
}

/// Returns the network's output for the images of both episodes.
fn expected(images: Vec<RgbImage>) -> Vec<TactileField> {
    let mut predictor =
        Predictor::load(&shipped::path().unwrap(), Options { unknown: Unknown::Guess, ..Options::default() }).unwrap();
    let mut images = images.into_iter();
    let mut fields = Vec::new();
    for length in LENGTHS {
        predictor.reset();
        for frame in 0..length {
            let stamp = f64::from(frame as f32 / 10.0);
            fields.push(predictor.push(&images.next().unwrap(), stamp).unwrap().field);
        }
    }
    fields
}

fn check(input: &Path, out: &Path, expected: &[TactileField], prefix: &str) {
    let (before, after) = (table(input, ROWS), table(out, ROWS));
    for (index, field) in before.schema().fields().iter().enumerate() {
        assert_eq!(after.schema().field(index), field.as_ref());
        assert!(before.column(index).to_data() == after.column(index).to_data(), "{}", field.name());
    }
    let (force, contact) = (lists(&after, &format!("{prefix}.force")), lists(&after, &format!("{prefix}.contact")));
    let regions = lists(&after, &format!("{prefix}.region_force"));
    assert_eq!(force.len(), 12);
    for (row, field) in expected.iter().enumerate() {
        assert!(force[row] == field.force && contact[row] == field.contact, "row {row}");
        // A region's forces add up to the hand's.
        for side in Side::BOTH {
            let sum: f32 = regions[row][17 * side as usize..][..17].iter().sum();
            assert!((sum - field.total_force(side)).abs() < 1e-4 * sum.max(1.0), "row {row}: {sum}");
        }
    }
    let tip = HandModel::builtin(Side::Right).regions().iter().position(|region| region.name() == "index_tip").unwrap();
    assert!(expected.iter().zip(&regions).all(|(field, regions)| regions[17 + 3] >= field.force[778 + tip]));
    // Compare the statistics of each column, element by element, with direct formulas.
    let info: Value = serde_json::from_str(&fs::read_to_string(out.join("meta/info.json")).unwrap()).unwrap();
    let stats: Value = serde_json::from_str(&fs::read_to_string(out.join("meta/stats.json")).unwrap()).unwrap();
    let episodes = table(out, EPISODES);
    for (name, rows) in [("force", &force), ("contact", &contact), ("region_force", &regions)] {
        let name = format!("{prefix}.{name}");
        let width = rows[0].len();
        assert_eq!(info["features"][&name]["shape"], serde_json::json!([width]));
        let stat = |stat: &str| -> Vec<f64> {
            stats[&name][stat].as_array().unwrap().iter().map(|n| n.as_f64().unwrap()).collect()
        };
        let of_episodes = |stat: &str| -> Vec<Vec<f64>> {
            let column = episodes.column_by_name(&format!("stats/{name}/{stat}")).unwrap().as_list::<i32>();
            (0..2).map(|row| column.value(row).as_primitive::<Float64Type>().values().to_vec()).collect()
        };
        for element in [0, width / 2, width - 1] {
            let values: Vec<f64> = rows.iter().map(|row| f64::from(row[element])).collect();
            let mean = values.iter().sum::<f64>() / 12.0;
            let std = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 12.0).sqrt();
            for (got, want) in [(stat("mean")[element], mean), (stat("std")[element], std)] {
                assert!((got - want).abs() < 1e-9 * want.max(1.0), "{name}[{element}]: {got} {want}");
            }
            assert_eq!(stat("max")[element], values.iter().copied().fold(f64::MIN, f64::max));
            let mut first = values[..7].to_vec();
            first.sort_by(f64::total_cmp);
            assert_eq!(of_episodes("q50")[0][element], first[3]);
            assert!((of_episodes("q10")[0][element] - (0.4 * first[0] + 0.6 * first[1])).abs() < 1e-9);
            assert_eq!(of_episodes("min")[0][element], first[0]);
        }
        let counts = episodes.column_by_name(&format!("stats/{name}/count")).unwrap().as_list::<i32>();
        let counts: Vec<i64> = (0..2).map(|row| counts.value(row).as_primitive::<Int64Type>().value(0)).collect();
        assert_eq!((counts, &stats[&name]["count"]), (vec![7, 5], &serde_json::json!([12])));
    }
}

/// Returns the content of every file below `folder`, by relative path.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = PathBuf::from(path.file_name().unwrap());
        match path.is_dir() {
            true => found.extend(files(&path).into_iter().map(|(inner, bytes)| (name.join(inner), bytes))),
            false => drop(found.insert(name, fs::read(&path).unwrap())),
        }
    }
    found
}

fn copy(from: &Path, to: &Path) {
    for (name, bytes) in files(from) {
        fs::create_dir_all(to.join(&name).parent().unwrap()).unwrap();
        fs::write(to.join(&name), bytes).unwrap();
    }
}

#[test]
fn images_in_videos_are_found_by_their_times() {
    let folder = tempfile::tempdir().unwrap();
    let (input, out) = (Path::new(DATA).join("video"), folder.path().join("out"));
    let before = files(&input);
    let json = summary(&label(&input, &out, &[]), 0);
    assert_eq!(json["summary"]["labelled"], 12);
    let video = input.join("videos/observation.images.head/chunk-000/file-000.mp4");
    let images = VideoFrames::open(&video, None).unwrap().map(|frame| frame.unwrap().1).collect();
    check(&input, &out, &expected(images), "tactile");
    assert!(files(&input) == before, "the original was touched");
    let after = files(&out);
    for (name, bytes) in before {
        let rewritten = ["data/", "meta/episodes/", "meta/info.json", "meta/stats.json"];
        assert!(rewritten.iter().any(|part| name.starts_with(part)) || after[&name] == bytes, "{}", name.display());
    }
    let about: Value = serde_json::from_slice(&after[Path::new("meta/egotac_labels.json")]).unwrap();
    assert_eq!((&about["topology"], &about["summary"]["frames"]), (&"egotac-hand-1".into(), &12.into()));
}

#[test]
fn images_in_rows_need_a_camera_and_columns_may_have_another_prefix() {
    let folder = tempfile::tempdir().unwrap();
    let (input, out) = (Path::new(DATA).join("image"), folder.path().join("out"));
    let refused = label(&input, &out, &[]);
    let error = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(
        refused.status.code() == Some(1) && error.contains("observation.images.wrist") && error.contains("--camera"),
        "{error}"
    );
    summary(&label(&input, &out, &["--camera", "observation.images.wrist", "--prefix", "touch"]), 0);
    let rows = table(&input, ROWS);
    let files =
        rows.column_by_name("observation.images.wrist").unwrap().as_struct().column_by_name("bytes").unwrap().clone();
    let images = (0..12).map(|row| egotac::image::decode(files.as_binary::<i32>().value(row)).unwrap()).collect();
    check(&input, &out, &expected(images), "touch");
    // The Hugging Face types list the new columns beside the old ones.
    let metadata = reader(&out.join(ROWS)).unwrap().schema().metadata().get("huggingface").unwrap().to_string();
    let types: Value = serde_json::from_str(&metadata).unwrap();
    assert_eq!(types["info"]["features"]["touch.force"]["length"], N_FIELD);
    assert_eq!(types["info"]["features"]["observation.images.wrist"]["_type"], "Image");
    // A second run needs another prefix.
    let again =
        label(&out, &folder.path().join("again"), &["--camera", "observation.images.head", "--prefix", "touch"]);
    assert!(String::from_utf8_lossy(&again.stderr).contains("--prefix"));
}

#[test]
fn shards_divide_the_episodes_and_a_missing_video_is_listed() {
    let folder = tempfile::tempdir().unwrap();
    let (input, alone, shared) = (folder.path().join("in"), folder.path().join("alone"), folder.path().join("shared"));
    copy(&Path::new(DATA).join("video"), &input);
    summary(&label(&input, &alone, &[]), 0);
    summary(&label(&input, &shared, &["--shard", "1/2"]), 0);
    assert!(!shared.exists());
    summary(&label(&input, &shared, &["--shard", "0/2"]), 0);
    assert!(files(&alone) == files(&shared));

    fs::remove_file(input.join("videos/observation.images.head/chunk-000/file-000.mp4")).unwrap();
    let out = folder.path().join("without");
    let json = summary(&label(&input, &out, &[]), 3);
    assert_eq!((&json["summary"]["labelled"], &json["summary"]["frames"]), (&0.into(), &12.into()));
    assert!(json["summary"]["faults"][0]["reason"].as_str().unwrap().contains("file-000.mp4"));
    assert!(lists(&table(&out, ROWS), "tactile.force").iter().flatten().all(|force| force.is_nan()));
    // Statistics hold no NaN, which would break normalisation.
    assert!(!fs::read_to_string(out.join("meta/stats.json")).unwrap().contains("null"));
}

#[test]
fn other_versions_are_refused_with_advice() {
    let folder = tempfile::tempdir().unwrap();
    let input = folder.path().join("in");
    copy(&Path::new(DATA).join("video"), &input);
    let info = fs::read_to_string(input.join("meta/info.json")).unwrap();
    fs::write(input.join("meta/info.json"), info.replace("v3.0", "v1.6")).unwrap();
    let output = label(&input, &folder.path().join("out"), &[]);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(1) && error.contains("v1.6") && error.contains("v2.0, v2.1 or v3"), "{error}");
}

/// Writes the table again with other numbers in a column.
fn change(root: &Path, file: &str, column: &str, numbers: Vec<i64>) {
    let old = table(root, file);
    let place = old.schema().index_of(column).unwrap();
    let mut columns = old.columns().to_vec();
    columns[place] = Arc::new(Int64Array::from(numbers));
    let new = RecordBatch::try_new(old.schema(), columns).unwrap();
    let mut writer = ArrowWriter::try_new(fs::File::create(root.join(file)).unwrap(), old.schema(), None).unwrap();
    writer.write(&new).unwrap();
    writer.close().unwrap();
}

#[test]
fn rows_at_other_places_than_the_episodes_say_get_no_labels() {
    let folder = tempfile::tempdir().unwrap();
    let camera = ["--camera", "observation.images.head"];
    let alternating = (0..12).map(|row| row % 2).collect();
    let swapped = (0..12).map(|row| i64::from(row < 5)).collect();
    for (name, file, column, numbers, words) in [
        ("alternating", ROWS, "episode_index", alternating, "lacks 6 of the rows"),
        ("swapped", ROWS, "episode_index", swapped, "starts at row 7"),
        ("overlapping", EPISODES, "dataset_from_index", vec![0, 4], "starts at row 4"),
        ("longer", EPISODES, "length", vec![8, 5], "lacks 1 of the rows"),
        ("shorter", EPISODES, "length", vec![6, 5], "more rows than meta/episodes says"),
        ("twice", EPISODES, "episode_index", vec![1, 1], "got episode 1 twice"),
    ] {
        let (input, out) = (folder.path().join(name), folder.path().join(format!("{name}-out")));
        copy(&Path::new(DATA).join("image"), &input);
        change(&input, file, column, numbers);
        let output = label(&input, &out, &camera);
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(1) && error.contains(words), "{name}: {error}");
        assert!(!out.exists(), "{name}");
    }
}
