//! Training on the processes of a real MPI launcher; `make check-mpi` builds and runs these tests.
#![cfg(feature = "mpi")]

#[path = "../train/stores.rs"]
mod stores;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Time within which all ranks must end after one was killed.
const END: Duration = Duration::from_secs(60);

/// Returns the command that trains on `ranks` processes, or without a launcher for 0.
fn training(ranks: usize, config: &Path, more: &[&str]) -> Command {
    let program = env!("CARGO_BIN_EXE_egotac");
    let mut command = match ranks {
        0 => Command::new(program),
        _ => {
            let mut command = Command::new("mpirun");
            command.args(["--oversubscribe", "--bind-to", "none", "-n", &ranks.to_string(), program]);
            // Open MPI refuses to run as root, which the user of a container often is.
            command.env("OMPI_ALLOW_RUN_AS_ROOT", "1").env("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1");
            command
        }
    };
    command.args(["train", "--config"]).arg(config).args(more).env("RAYON_NUM_THREADS", "1");
    command
}

fn ok(mut command: Command) -> String {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{command:?}: {}", told(&output));
    String::from_utf8(output.stdout).unwrap()
}

fn told(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Writes stores and the configuration of a run of `steps` steps.
fn prepare(folder: &Path, out: &str, clips: usize, steps: usize) -> PathBuf {
    if !folder.join("a.zarr").exists() {
        stores::write(folder);
    }
    let file = folder.join(format!("{out}.yaml"));
    fs::write(&file, stores::config(folder, out, clips, steps)).unwrap();
    file
}

/// Reads the columns of losses of a run's log, by step.
fn losses(folder: &Path, out: &str) -> BTreeMap<usize, Vec<f64>> {
    let log = fs::read_to_string(folder.join(out).join("log.csv")).unwrap();
    let row = |line: &str| {
        let values: Vec<f64> = line.split(',').map(|value| value.parse().unwrap()).collect();
        (values[0] as usize, values[1..6].to_vec())
    };
    log.lines().skip(1).map(row).collect()
}

/// Checks that two runs have the same losses to 1e-5 and checkpoints to 1e-4.
fn assert_same(folder: &Path, a: &str, b: &str) {
    let (left, right) = (losses(folder, a), losses(folder, b));
    assert_eq!(left.keys().collect::<Vec<_>>(), right.keys().collect::<Vec<_>>());
    for (step, values) in &left {
        for (x, y) in values.iter().zip(&right[step]) {
            // The log has six decimals.
            assert!((x - y).abs() <= 1e-5 * y.abs() + 1.1e-6, "step {step}: {values:?} {:?}", right[step]);
        }
    }
    let [a, b] = [a, b].map(|out| folder.join(out).join("checkpoint.safetensors"));
    let (weights, name) = stores::difference(&a, &b);
    assert!(weights < 1e-4, "{weights} in {name}");
}

#[test]
fn two_ranks_equal_one_process_with_twice_the_batch() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let said = ok(training(2, &prepare(folder, "two", 2, 12), &[]));
    // Rank 0 alone speaks.
    assert!(said.matches("2 ranks").count() == 1 && said.matches("sha256").count() == 1, "{said}");
    ok(training(0, &prepare(folder, "one", 2, 12), &["--set", "batch.clips=4"]));
    assert_same(folder, "two", "one");
    ok(training(4, &prepare(folder, "four", 1, 12), &[]));
    assert_same(folder, "four", "one");
    // One rank of a launcher is one process, bit for bit.
    ok(training(1, &prepare(folder, "launched", 4, 12), &[]));
    assert_eq!(losses(folder, "launched"), losses(folder, "one"));
}

#[test]
fn a_killed_rank_ends_all_and_the_run_resumes_on_other_ranks() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    const STEPS: usize = 40;
    ok(training(0, &prepare(folder, "whole", 4, STEPS), &[]));
    for (rank, resumed_on) in [(1, 4), (0, 0)] {
        let out = format!("killed{rank}");
        let config = prepare(folder, &out, 2, STEPS);
        let mut launcher = training(2, &config, &[]).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let log = folder.join(&out).join("log.csv");
        wait(|| fs::read_to_string(&log).is_ok_and(|log| log.lines().count() > 10), &mut launcher);
        let ranks = ranks_of(launcher.id());
        assert_eq!(ranks.len(), 2, "{ranks:?}");
        assert!(Command::new("kill").args(["-9", &ranks[&rank].to_string()]).status().unwrap().success());
        let killed = Instant::now();
        while launcher.try_wait().unwrap().is_none() {
            assert!(killed.elapsed() < END, "the launcher runs on");
            std::thread::sleep(Duration::from_millis(20));
        }
        let output = launcher.wait_with_output().unwrap();
        let said = told(&output);
        assert!(
            !output.status.success() && said.contains(&format!("rank {rank}")) && said.contains("signal 9"),
            "{said}"
        );
        for pid in ranks.values() {
            assert!(!is_running(*pid), "process {pid} runs on");
        }
        assert!(folder.join(&out).join("state.safetensors").is_file());
        assert!(losses(folder, &out).len() < STEPS, "it was over before it was killed");
        // The lock went with rank 0; the batches stay those of two ranks.
        ok(training(resumed_on, &config, &["--resume"]));
        assert_same(folder, &out, "whole");
    }
}

#[test]
fn an_error_on_one_rank_ends_all_and_names_it() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let config = prepare(folder, "other", 2, 4);
    // Rank 1 alone has another seed.
    let script = format!(
        "exec {} train --config {} --set seed=$((7 + OMPI_COMM_WORLD_RANK))",
        env!("CARGO_BIN_EXE_egotac"),
        config.display()
    );
    let mut command = Command::new("mpirun");
    command.args(["--oversubscribe", "--bind-to", "none", "-n", "2", "sh", "-c", &script]);
    command.env("OMPI_ALLOW_RUN_AS_ROOT", "1").env("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1");
    let output = command.output().unwrap();
    let said = told(&output);
    assert!(!output.status.success() && said.contains("configuration of rank 1: expected those of rank 0"), "{said}");
    let output = training(2, &folder.join("absent.yaml"), &[]).output().unwrap();
    assert!(!output.status.success() && told(&output).contains("absent.yaml"), "{}", told(&output));
}

/// Waits until `done`, while the launcher runs.
fn wait(done: impl Fn() -> bool, launcher: &mut Child) {
    let begun = Instant::now();
    while !done() {
        assert!(launcher.try_wait().unwrap().is_none() && begun.elapsed() < END, "the run ended or does not go on");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Returns the processes that a launcher has started, by rank.
fn ranks_of(launcher: u32) -> BTreeMap<usize, u32> {
    let pids = fs::read_dir("/proc").unwrap().filter_map(|entry| entry.ok()?.file_name().to_str()?.parse::<u32>().ok());
    let rank = |pid: u32| {
        let status = fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
        status.lines().find(|line| *line == format!("PPid:\t{launcher}"))?;
        let environment = fs::read_to_string(format!("/proc/{pid}/environ")).ok()?;
        let number = environment.split('\0').find_map(|line| line.strip_prefix("OMPI_COMM_WORLD_RANK="))?;
        Some((number.parse().ok()?, pid))
    };
    pids.filter_map(rank).collect()
}

/// Returns true unless a process has ended, whether or not its parent has taken note.
fn is_running(pid: u32) -> bool {
    fs::read_to_string(format!("/proc/{pid}/stat")).is_ok_and(|stat| !stat.contains(") Z "))
}
