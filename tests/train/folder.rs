//! The folder of a training run: one run at a time, equal bytes for equal runs, and a resume from every moment.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::common::refused;
use crate::common::store::write_bright_store;
use candle_core::Device;
use egotac::file;
use egotac::train::{Config, Control, Event, train};
use safetensors::SafeTensors;

/// Writes a store and the configuration of a run; returns both forms of the configuration.
fn prepare(folder: &Path, steps: usize) -> (PathBuf, Config) {
    write_bright_store(&folder.join("train.zarr"), 40);
    let at = folder.display();
    let text = format!(
        "name: test\ndata: [{at}/train.zarr]\nout: {at}/run\nmodel: toy\nseed: 5\nsteps: {steps}\nsave_every: {steps}\n\
         validate_every: {steps}\nbatch: {{clips: 2, windows: 4}}\n"
    );
    let path = folder.join("config.yaml");
    fs::write(&path, &text).unwrap();
    (path, serde_yaml::from_str(&text).unwrap())
}

fn run(config: &Config, resume: bool) -> egotac::Result<egotac::train::Outcome> {
    train(config, resume, &Device::Cpu, &mut |_: Event| Control::Continue)
}

/// Returns the bytes of state and checkpoint.
fn results(config: &Config) -> [Vec<u8>; 2] {
    ["state.safetensors", "checkpoint.safetensors"].map(|name| fs::read(config.out.join(name)).unwrap())
}

/// Starts `egotac train` and waits until its log has more than `lines` lines.
fn start(file: &Path, config: &Config, lines: usize) -> Child {
    let mut child = Command::new(env!("CARGO_BIN_EXE_egotac"))
        .args(["train", "--config"])
        .arg(file)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let begun = Instant::now();
    while fs::read_to_string(config.out.join("log.csv")).map_or(0, |log| log.lines().count()) <= lines {
        assert!(begun.elapsed() < Duration::from_secs(60) && child.try_wait().unwrap().is_none(), "no step was taken");
        std::thread::sleep(Duration::from_millis(5));
    }
    child
}

#[test]
fn equal_runs_give_equal_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let (_, config) = prepare(folder.path(), 3);
    let runs: Vec<_> = (0..4)
        .map(|_| {
            run(&config, false).unwrap();
            let bytes = results(&config);
            fs::remove_dir_all(&config.out).unwrap();
            bytes
        })
        .collect();
    assert!(runs.iter().all(|bytes| *bytes == runs[0]));
}

#[test]
fn a_run_killed_before_its_first_save_resumes_from_the_beginning() {
    let folder = tempfile::tempdir().unwrap();
    let (file, mut config) = prepare(folder.path(), 400);
    let mut child = start(&file, &config, 2);
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(!config.out.join("state.safetensors").exists(), "it was killed too late");

    let other = Config { seed: 6, ..config.clone() };
    let error = run(&other, true).unwrap_err().to_string();
    assert!(error.contains("config.yaml") && error.contains("another configuration: `seed: 5` then"), "{error}");

    // Four steps are enough to compare the bits; the configuration of the killed run is changed alike.
    config.steps = 4;
    fs::write(config.out.join("config.yaml"), serde_yaml::to_string(&config).unwrap()).unwrap();
    run(&config, true).unwrap();
    let resumed = results(&config);
    let log = || fs::read_to_string(config.out.join("log.csv")).unwrap().lines().count();
    assert_eq!(log(), 5);
    fs::remove_dir_all(&config.out).unwrap();
    // Nor is a folder needed.
    run(&config, true).unwrap();
    assert!(results(&config) == resumed);
    fs::remove_dir_all(&config.out).unwrap();
    run(&config, false).unwrap();
    assert!(results(&config) == resumed);
}

#[test]
fn a_second_run_in_the_same_folder_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (file, config) = prepare(folder.path(), 4000);
    let mut first = start(&file, &config, 1);
    for resume in [&["--resume"][..], &[]] {
        let arguments = [&["train", "--config", file.to_str().unwrap()], resume].concat();
        refused(&arguments, "run: another run trains in this folder");
    }
    assert!(first.try_wait().unwrap().is_none(), "the first run goes on");
    first.kill().unwrap();
    first.wait().unwrap();
    // The lock ends with its process.
    let config = Config { steps: 1, ..config };
    fs::remove_file(config.out.join("config.yaml")).unwrap();
    run(&config, false).unwrap();
}

#[test]
fn a_state_with_impossible_counters_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (_, config) = prepare(folder.path(), 2);
    run(&config, false).unwrap();
    let path = config.out.join("state.safetensors");
    let bytes = fs::read(&path).unwrap();
    for (name, value, message) in [
        ("step", 1u64 << 34, "step: expected at most 2, got 17179869184"),
        ("optimizer_steps", 1 << 34, "optimizer_steps: expected at most 2, got 17179869184"),
    ] {
        let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
        let mut metadata: std::collections::BTreeMap<_, _> = header.metadata().clone().unwrap().into_iter().collect();
        metadata.insert(name.into(), value.to_string());
        let tensors = SafeTensors::deserialize(&bytes).unwrap();
        let changed = file::tensors::to_bytes(&path, tensors.iter(), &metadata).unwrap();
        fs::write(&path, changed).unwrap();
        let error = run(&config, true).unwrap_err().to_string();
        assert!(error.contains("state.safetensors") && error.contains(message), "{error}");
    }
}
