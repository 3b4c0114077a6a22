//! `egotac label` on Open X-Tactile stores written by zarr-python (tests/data/oxt).

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

use crate::common::egotac;
use egotac::dataset::EpisodeReader;
use egotac::dataset::zarr::{StoreLocation, ZarrReader};
use egotac::model::predictor::{Options, Predictor};
use egotac::model::{Unknown, shipped};
use egotac::tactile::N_FIELD;
use serde_json::Value;

const DATA: &str = "tests/data/oxt";

fn label(input: &Path, out: &Path, more: &[&str]) -> Output {
    let [input, out] = [input, out].map(|path| path.to_str().unwrap());
    // The pictures of these recordings are made up: without a guess, the network would not know touch in them.
    egotac(&[&["label", input, "--out", out, "--unknown", "guess"], more].concat())
}

fn succeeds(output: &Output) {
    let [out, err] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes));
    assert!(output.status.success(), "{:?}: {out}{err}", output.status);
}

/// Unpacks a zip file with one store and returns the store's folder.
fn unpacked(zip: &str, to: &Path) -> PathBuf {
    let file = fs::File::open(Path::new(DATA).join(zip)).unwrap();
    zip::ZipArchive::new(file).unwrap().extract(to).unwrap();
    StoreLocation::find(to).unwrap()[0].path.clone()
}

/// Returns the content of every file below `folder`, by relative path.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_owned();
        match path.is_dir() {
            true => found.extend(files(&path).into_iter().map(|(inner, bytes)| (Path::new(&name).join(inner), bytes))),
            false => drop(found.insert(name.into(), fs::read(&path).unwrap())),
        }
    }
    found
}

/// Returns the expected force and contact of frame `index`: the network's output for the store's own images.
fn expected(store: &ZarrReader, index: usize) -> (Vec<f32>, Vec<f32>) {
    let mut predictor =
        Predictor::load(&shipped::path().unwrap(), Options { unknown: Unknown::Guess, ..Options::default() }).unwrap();
    let start = store.episode_ends().iter().copied().filter(|end| *end <= index).max().unwrap_or(0);
    let mut field = None;
    for frame in start..=index {
        let stamp = store.frame(frame).unwrap().timestamp * 1e-3;
        field = Some(predictor.push(&store.image(frame).unwrap(), stamp).unwrap().field);
    }
    let field = field.unwrap();
    (field.force, field.contact)
}

#[test]
fn every_layout_is_labelled_and_its_own_data_stays_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let plain = unpacked("task.zarr.zip", &at("plain"));
    let many = at("many").join("batch_001.zarr");
    for (input, out, result) in [
        (plain.clone(), at("a.zarr"), at("a.zarr")),
        (Path::new(DATA).join("task.zarr.zip"), at("b.zarr"), at("b.zarr")),
        (Path::new(DATA).join("root.zarr.zip"), at("c.zarr"), at("c.zarr")),
        (Path::new(DATA).join("many.zip"), at("many"), many),
    ] {
        let before = fs::metadata(&input).unwrap().modified().unwrap();
        succeeds(&label(&input, &out, &[]));
        assert_eq!(fs::metadata(&input).unwrap().modified().unwrap(), before);
        let source = StoreLocation::find(&input).unwrap().last().cloned().unwrap();
        let (source, labelled) = (ZarrReader::open_at(&source).unwrap(), ZarrReader::open(&result).unwrap());
        assert_eq!((labelled.len(), labelled.episode_ends()), (12, &[7, 12][..]));
        for index in [0, 6, 7, 11] {
            let (force, contact) = expected(&source, index);
            let frame = labelled.frame(index).unwrap();
            assert_eq!((frame.field.force, frame.field.contact), (force, contact), "{} {index}", input.display());
            assert_eq!(frame.camera_ego_rgb, source.image(index).unwrap());
            assert!(frame.force_valid.iter().chain(&frame.contact_valid).all(|valid| *valid == 1));
        }
    }
    // The attributes are the only changed file; all other new files hold labels.
    let (before, mut after) = (files(&plain), files(&at("a.zarr")));
    let added: Vec<PathBuf> = after.keys().filter(|path| !before.contains_key(*path)).cloned().collect();
    assert!(
        added.iter().all(|path| path.starts_with("data/")
            && ["mano_", "familiarity", "presence"].iter().any(|name| path.to_string_lossy().contains(name))
            || path.as_os_str() == ".zattrs"),
        "{added:?}"
    );
    after.retain(|path, _| before.contains_key(path));
    assert!(after == before);
    assert!(!folder.path().join(".a.zarr.unfinished").exists());
}

#[test]
fn a_labelled_store_states_its_provenance() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out.zarr");
    succeeds(&label(&Path::new(DATA).join("task.zarr.zip"), &out, &[]));
    let about = ZarrReader::open(&out).unwrap().raw_attributes()["egotac_labels"].clone();
    let hash = Predictor::load(&shipped::path().unwrap(), Options::default()).unwrap().sha256().to_string();
    assert_eq!((&about["model_sha256"], &about["topology"]), (&hash.into(), &"egotac-hand-1".into()));
    assert_eq!(about["thresholds"], serde_json::json!({"contact": 0.5, "contact_force": 0.05}));
    assert_eq!(about["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!((&about["summary"]["frames"], &about["summary"]["labelled"]), (&12.into(), &12.into()));
    let confidence: u64 = about["summary"]["confidence"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap()).sum();
    assert_eq!(Some(confidence), about["summary"]["touched"].as_u64());
}

#[test]
fn frames_of_a_damaged_chunk_get_no_label_and_are_listed() {
    let folder = tempfile::tempdir().unwrap();
    let input = unpacked("task.zarr.zip", &folder.path().join("in"));
    // The second chunk of images holds frames 7 to 11.
    let chunk = input.join("data/camera_ego_rgb/1.0.0.0");
    let bytes = fs::read(&chunk).unwrap();
    fs::write(&chunk, &bytes[..bytes.len() / 2]).unwrap();
    let out = folder.path().join("out.zarr");
    let output = label(&input, &out, &["--json", "-"]);
    assert_eq!(output.status.code(), Some(3), "{}", String::from_utf8_lossy(&output.stderr));
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&json["summary"]["frames"], &json["summary"]["labelled"]), (&12.into(), &7.into()));
    let faults = json["summary"]["faults"].as_array().unwrap();
    assert_eq!(faults.len(), 5);
    assert!(
        faults
            .iter()
            .all(|fault| fault["unit"] == "episode 1" && fault["reason"].as_str().unwrap().contains("camera_ego_rgb"))
    );
    let labelled = ZarrReader::open(&out).unwrap();
    assert!(labelled.read_f32("data/mano_force", 7..12).unwrap().iter().all(|force| force.is_nan()));
    assert_eq!(labelled.read_u8("data/mano_force_valid", 6..8).unwrap(), [vec![1; N_FIELD], vec![0; N_FIELD]].concat());
    // A second run finds the output complete and returns the same status.
    assert_eq!(label(&input, &out, &[]).status.code(), Some(3));
}

#[test]
fn shards_fill_one_output_that_equals_a_single_run() {
    let folder = tempfile::tempdir().unwrap();
    let input = Path::new(DATA).join("many.zip");
    let [alone, together] = ["alone", "together"].map(|name| folder.path().join(name));
    succeeds(&label(&input, &alone, &[]));
    for shard in ["2/3", "0/3", "2/3"] {
        succeeds(&label(&input, &together, &["--shard", shard]));
        assert!(!together.join("batch_000.zarr").exists(), "{shard}: an episode is missing");
    }
    succeeds(&label(&input, &together, &["--shard", "1/3"]));
    // So does the manifest, which every shard wrote.
    assert!(files(&alone).contains_key(Path::new("manifest.json")) && files(&alone) == files(&together));
}

#[test]
fn existing_files_are_never_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let (input, out) = (unpacked("task.zarr.zip", &folder.path().join("in")), folder.path().join("out.zarr"));
    let refused = |output: Output, why: &str| {
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(1) && error.contains(why), "{why}: {error}");
    };
    refused(label(&input, &input, &[]), "never written to");
    refused(label(&input, &input.join("data/more.zarr"), &[]), "never written to");
    fs::create_dir(&out).unwrap();
    refused(label(&input, &out, &[]), "exists");
    refused(label(&input, &folder.path().join("x.zarr"), &["--camera", "camera_left_rgb"]), "camera_ego_rgb");
    fs::remove_dir(&out).unwrap();
    // An output that would be invalid is refused before inference.
    let other = unpacked("task.zarr.zip", &folder.path().join("other"));
    fs::write(other.join(".zattrs"), r#"{"topology": "mano"}"#).unwrap();
    refused(label(&other, &folder.path().join("y.zarr"), &[]), "topology mismatch");
    assert!(!folder.path().join(".y.zarr.unfinished").exists());
    // A store with labels or truth keeps them: the new labels get other names.
    succeeds(&label(&input, &out, &[]));
    let again = folder.path().join("again.zarr");
    succeeds(&label(&out, &again, &["--precision", "int8"]));
    let (first, second) = (files(&out), files(&again));
    assert!(first.iter().all(|(path, bytes)| path.as_os_str() == ".zattrs" || second.get(path) == Some(bytes)));
    let names: Vec<String> = ZarrReader::open(&again).unwrap().arrays().into_iter().map(|a| a.name).collect();
    assert!(names.contains(&"data/predicted_mano_force".into()), "{names:?}");
}

/// Needs the Python environment of `make setup`.
#[cfg(feature = "sim")]
#[test]
fn zarr_python_reads_labels_and_original_data() {
    let folder = tempfile::tempdir().unwrap();
    let (input, out) = (unpacked("task.zarr.zip", &folder.path().join("in")), folder.path().join("out.zarr"));
    succeeds(&label(&input, &out, &[]));
    let script = r#"
import sys, numpy as np, zarr
before, after = (zarr.open_group(path, mode="r") for path in sys.argv[1:])
for name in before["data"].array_keys():
    a, b = before["data"][name], after["data"][name]
    assert a.dtype == b.dtype and np.array_equal(a[:], b[:]), name
new = sorted(set(after["data"].array_keys()) - set(before["data"].array_keys()))
assert new == ["familiarity", "mano_contact_score", "mano_contact_valid", "mano_force", "mano_force_valid", "presence"], new
force, contact = after["data"]["mano_force"][:], after["data"]["mano_contact_score"][:]
assert force.shape == contact.shape == (12, 1556) and force.dtype == contact.dtype == np.float32
assert (force >= 0).all() and (contact >= 0).all() and (contact <= 1).all()
assert after.attrs["topology"] == "egotac-hand-1"
print(force.sum(dtype="f8"), contact.sum(dtype="f8"))
"#;
    let python = std::env::var("EGOTAC_PYTHON").expect("EGOTAC_PYTHON names the set-up's Python: source env.sh");
    let output = std::process::Command::new(python).args(["-c", script]).args([&input, &out]).output().unwrap();
    succeeds(&output);
    let store = ZarrReader::open(&out).unwrap();
    let sum = |name| store.read_f32(name, 0..12).unwrap().into_iter().map(f64::from).sum::<f64>();
    let printed = String::from_utf8(output.stdout).unwrap();
    let numbers: Vec<f64> = printed.split_whitespace().map(|word| word.parse().unwrap()).collect();
    for (python, rust) in numbers.iter().zip([sum("data/mano_force"), sum("data/mano_contact_score")]) {
        assert!((python - rust).abs() <= 1e-9 * rust.abs(), "{python} {rust}");
    }
}

#[test]
fn a_damaged_file_of_a_zip_is_listed_and_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let source = Path::new(DATA).join("task.zarr.zip");
    let chunk = "task.zarr/data/right_hand_joints/0.0";
    let mut archive = zip::ZipArchive::new(fs::File::open(&source).unwrap()).unwrap();
    let (offset, bytes) = {
        let entry = archive.by_name(chunk).unwrap();
        (entry.data_start().unwrap(), entry.compressed_size())
    };
    let mut damaged = fs::read(&source).unwrap();
    damaged[(offset + bytes / 2) as usize] ^= 0x10;
    let input = folder.path().join("task.zarr.zip");
    fs::write(&input, damaged).unwrap();
    let out = folder.path().join("task.zarr");
    let done = label(&input, &out, &["--json", "-"]);
    assert_eq!(done.status.code(), Some(3), "{}", String::from_utf8_lossy(&done.stderr));
    let done: Value = serde_json::from_slice(&done.stdout).unwrap();
    let lost = &done["summary"]["lost"];
    assert_eq!((&lost[0]["offset"], &lost[0]["bytes"]), (&offset.into(), &bytes.into()), "{lost}");
    assert!(lost[0]["file"].as_str().unwrap().ends_with("data/right_hand_joints/0.0") && lost[1].is_null());
    // Everything else is complete, labels included.
    let (left, whole) = (files(&out), files(&unpacked("task.zarr.zip", &folder.path().join("whole"))));
    let missing: Vec<&PathBuf> = whole.keys().filter(|path| !left.contains_key(*path)).collect();
    assert_eq!(missing, [Path::new("data/right_hand_joints/0.0")]);
    assert_eq!(done["summary"]["labelled"], done["summary"]["frames"]);
    assert!(left.contains_key(Path::new("data/mano_force/.zarray")));
}

#[test]
fn data_info_states_the_time_unit_of_a_foreign_store_and_invents_no_forces() {
    let told = egotac(&["data", "info", &format!("{DATA}/task.zarr.zip"), "--json"]);
    let info: Value = serde_json::from_slice(&told.stdout).unwrap();
    assert_eq!((&info["time_unit_secs"], &info["max_force"]), (&0.001.into(), &Value::Null), "{info}");
    let fps = info["fps"].as_f64().unwrap();
    assert!((fps - 1e3 / 33.3).abs() < 0.01, "{fps}");
    let text = String::from_utf8(egotac(&["data", "info", &format!("{DATA}/task.zarr.zip")]).stdout).unwrap();
    assert!(text.contains("no true forces") && text.contains("<U13"), "{text}");
}

#[test]
fn options_about_bodies_are_refused_without_physics() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out.zarr");
    for option in [["--density", "wood"], ["--mass", "cup=0.2"], ["--gravity", "0,0,-1"]] {
        let output = label(Path::new(&format!("{DATA}/task.zarr.zip")), &out, &option);
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && error.contains(option[0]) && error.contains("--physics"), "{error}");
        assert!(!out.exists());
    }
}
