//! Commands that write outputs lose, mix up, double and half-write nothing; and the check would see it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use egotac_bench::faults::check::{Harm, Reference};
use egotac_bench::faults::subject::Subject;
use egotac_bench::faults::{Options, input, run};

fn short(only: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let options = Options {
        short: true,
        runs: 1,
        seed: 1,
        only: only.iter().map(|name| name.to_string()).collect(),
        program: PathBuf::from(env!("CARGO_BIN_EXE_egotac-bench")),
        folder: folder.path().to_path_buf(),
    };
    let report = run(&options, "test".into(), |_| ()).unwrap();
    let findings: Vec<_> = report
        .rows
        .iter()
        .flat_map(|row| row.findings.iter().map(move |(run, what)| (&row.command, &row.fault, run, what)))
        .collect();
    assert!(!report.rows.is_empty() && report.is_clean(), "{findings:#?}");
}

#[test]
fn every_command_knows_its_arguments() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("out"), b"").unwrap();
    for subject in Subject::all(&folder.path().join("inputs"), &[], 1).unwrap() {
        let mut command = Command::new(env!("CARGO_BIN_EXE_egotac-bench"));
        command.args(subject.arguments(subject.input.as_deref())).current_dir(folder.path());
        let output = command.output().unwrap();
        // The output's folder is a file: an error, but not that of bad usage, which has status 2.
        assert_eq!(output.status.code(), Some(1), "{}: {}", subject.name, String::from_utf8_lossy(&output.stderr));
    }
}

#[test]
fn import_survives_every_fault() {
    short(&["import"]);
}

#[test]
fn findings_name_files_without_the_folders_of_one_run() {
    let folder = tempfile::tempdir().unwrap();
    let inputs = folder.path().join("inputs");
    let subjects = Subject::all(&inputs, &["label, images".into()], 1).unwrap();
    let case = folder.path().join("work/case");
    let text = format!("{}: cut; {} is gone", case.join("out/a.zarr").display(), inputs.join("b/table").display());
    assert_eq!(subjects[0].shortened(&text, &case), "out/a.zarr: cut; inputs/b/table is gone");
}

#[test]
fn label_survives_every_fault() {
    short(&["label"]);
}

#[test]
fn train_survives_every_fault() {
    short(&["train"]);
}

#[cfg(feature = "sim")]
#[test]
fn generate_survives_every_fault() {
    short(&["generate"]);
}

/// Labels the same store twice; returns the outputs.
fn labelled(folder: &Path) -> [PathBuf; 2] {
    input::store(&folder.join("in.zarr"), 1).unwrap();
    input::checkpoint(&folder.join("model.safetensors"), 1).unwrap();
    ["first.zarr", "second.zarr"].map(|name| label(folder, "in.zarr", name))
}

/// Labels an input of the folder by its network; returns the output.
fn label(folder: &Path, input: &str, out: &str) -> PathBuf {
    let [input, model, out] = [input, "model.safetensors", out].map(|name| folder.join(name));
    let mut command = Command::new(env!("CARGO_BIN_EXE_egotac-bench"));
    command.args(["label", "--checkpoint"]).arg(&model).arg("--out").arg(&out).arg(&input);
    assert!(command.output().unwrap().status.success());
    out
}

#[test]
fn planted_faults_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let [first, second] = labelled(folder.path());
    let reference = Reference::read(&first, &second, &[""]).unwrap();
    assert_eq!(reference.varying, Vec::<PathBuf>::new());
    let compare = |out: &Path| {
        let mut harm = Harm::default();
        reference.compare(out, false, &mut harm);
        harm
    };
    assert!(compare(&second).is_none(), "{:?}", compare(&second));
    let entries = &reference.entries[Path::new("")];
    let labels: std::collections::BTreeSet<_> = entries.iter().map(|entry| &entry.label).collect();
    assert_eq!((entries.len(), labels.len()), (160, 160), "each image has a label of its own");

    // Chunks of the labels, and of the images, trade places.
    let chunks = |array: &str| -> Vec<PathBuf> {
        let listed = fs::read_dir(second.join("data").join(array)).unwrap().map(|entry| entry.unwrap().path());
        let mut chunks: Vec<PathBuf> =
            listed.filter(|path| !path.file_name().unwrap().to_string_lossy().starts_with('.')).collect();
        chunks.sort();
        chunks
    };
    let forces = chunks("predicted_mano_force");
    let (a, bytes) = (&forces[0], fs::read(&forces[0]).unwrap());
    fs::write(a, &bytes[..bytes.len() / 2]).unwrap();
    assert!(compare(&second).half_written, "a chunk is cut");
    fs::remove_file(a).unwrap();
    let harm = compare(&second);
    assert!(harm.lost && harm.mixed_up, "a chunk is missing: its labels read as zeros");
    fs::write(a, &bytes).unwrap();
    assert!(compare(&second).is_none());

    fs::write(second.join("left"), b"x").unwrap();
    assert!(compare(&second).leftovers);
    fs::remove_file(second.join("left")).unwrap();

    let mut harm = Harm::default();
    reference.compare(&folder.path().join("in.zarr"), false, &mut harm);
    assert!(harm.lost && harm.mixed_up, "truth is not a label: {:?}", harm.notes);
}

#[test]
fn planted_entries_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let [first, second] = labelled(folder.path());
    let reference = |change: fn(&mut Reference)| {
        let mut reference = Reference::read(&first, &second, &[""]).unwrap();
        change(&mut reference);
        let mut harm = Harm::default();
        reference.compare(&second, false, &mut harm);
        harm
    };
    // Two labels trade places.
    let swapped = reference(|reference| {
        let entries = reference.entries.values_mut().next().unwrap();
        let label = entries[3].label.clone();
        entries[3].label = entries[90].label.clone();
        entries[90].label = label;
    });
    assert!(swapped.mixed_up && !swapped.lost && !swapped.doubled, "{swapped:?}");
    // An image that only the reference has.
    let lost = reference(|reference| {
        let entries = reference.entries.values_mut().next().unwrap();
        let mut more = entries[0].clone();
        more.picture = Some("another".into());
        entries.push(more);
    });
    assert!(lost.lost && !lost.mixed_up && !lost.doubled, "{lost:?}");
    // An image that the reference has not.
    let foreign = reference(|reference| drop(reference.entries.values_mut().next().unwrap().remove(7)));
    assert!(foreign.mixed_up && !foreign.lost, "{foreign:?}");
}

#[test]
fn an_unreadable_image_is_no_mix_up_where_the_status_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    input::images(&at("in"), 1).unwrap();
    input::checkpoint(&at("model.safetensors"), 1).unwrap();
    let whole = label(folder.path(), "in", "whole.zarr");
    let reference = Reference::read(&whole, &whole, &[""]).unwrap();
    fs::write(at("in/frame_020.png"), b"no image").unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_egotac-bench"));
    command
        .args(["label", "--checkpoint"])
        .arg(at("model.safetensors"))
        .arg("--out")
        .arg(at("partly.zarr"))
        .arg(at("in"));
    assert_eq!(command.output().unwrap().status.code(), Some(3));
    let compare = |partly| {
        let mut harm = Harm::default();
        reference.compare(&at("partly.zarr"), partly, &mut harm);
        harm
    };
    assert!(compare(true).is_none(), "{:?}", compare(true));
    assert!(compare(false).lost && compare(false).mixed_up);
}

#[test]
fn a_planted_doubling_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let [first, second] = labelled(folder.path());
    let reference = Reference::read(&first, &second, &[""]).unwrap();
    let compare = |images: Vec<usize>| {
        let planted = folder.path().join("planted.zarr");
        input::store_of(&planted, 1, images).unwrap();
        let out = label(folder.path(), "planted.zarr", "planted-labels.zarr");
        let mut harm = Harm::default();
        reference.compare(&out, false, &mut harm);
        [planted, out].iter().for_each(|path| fs::remove_dir_all(path).unwrap());
        harm
    };
    // As a run would write it that labels the last block of an episode again after a kill.
    let doubled = compare((0..80).chain(72..152).collect());
    assert!(doubled.doubled && doubled.lost, "{:?}", doubled.notes);
    // An image in the place of another one is a doubling as well as a loss.
    let replaced = compare((0..160).map(|index| if index == 90 { 89 } else { index }).collect());
    assert!(replaced.doubled && replaced.lost, "{:?}", replaced.notes);
    let same = compare((0..160).collect());
    assert!(!same.doubled && !same.lost && !same.mixed_up, "{:?}", same.notes);
}
