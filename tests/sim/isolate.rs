//! Generation in worker processes: an episode that ends its process is named, and no other episode is lost.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use egotac::dataset::EpisodeReader;
use egotac::dataset::zarr::{MANO_FORCE, ZarrReader};
use egotac::sim::{DatasetPlan, RolloutOptions, Scene, WorkerCommand, generate_in_processes};

fn plan(episodes: usize) -> DatasetPlan {
    let scenes = vec![Scene::load("hover").unwrap()];
    DatasetPlan { scenes, episodes, seed: 5, jobs: 1, options: RolloutOptions::default() }
}

/// Returns a worker that runs a line of shell.
fn shell(line: &str) -> WorkerCommand {
    WorkerCommand { program: "/bin/sh".into(), arguments: vec!["-c".into(), line.into()] }
}

#[test]
fn error_names_scene_seed_and_exit_status_of_a_dead_worker() {
    let folder = tempfile::tempdir().unwrap();
    for (line, end) in [("read line; exit 1", "exit status: 1"), ("read line; kill -9 $$", "signal: 9 (SIGKILL)")] {
        let out = folder.path().join("set");
        let error = generate_in_processes(&plan(2), &shell(line), false, &out, |_| ()).unwrap_err().to_string();
        assert!(error.contains("2 of 2 episodes failed"), "{error}");
        for seed in [5, 6] {
            assert!(error.contains(&format!("hover with seed {seed}")), "{error}");
        }
        assert!(error.contains(end), "{error}");
        assert!(!out.exists());
    }
}

#[test]
fn worker_that_writes_nonsense_or_cannot_start_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    let error =
        generate_in_processes(&plan(1), &shell("echo hello; cat"), false, &out, |_| ()).unwrap_err().to_string();
    assert!(error.contains("hover with seed 5"), "{error}");
    let none = WorkerCommand { program: "/nowhere/egotac".into(), arguments: vec![] };
    let error = generate_in_processes(&plan(1), &none, false, &out, |_| ()).unwrap_err().to_string();
    assert!(error.contains("/nowhere/egotac"), "{error}");
}

const THREE_EPISODES: [&str; 2] = ["--episodes", "3"];

/// Returns `egotac sim generate` with one job and small pictures.
fn egotac(out: &Path, more: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_egotac"));
    command.args(["sim", "generate", "pinch_cube", "--seed", "30", "--size", "32", "--jobs", "1"]);
    command.args(more).arg("--out").arg(out).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// Returns the child processes of a process.
fn children(parent: u32) -> Vec<u32> {
    let tasks = std::fs::read_dir(format!("/proc/{parent}/task")).into_iter().flatten().flatten();
    let lists = tasks.map(|task| std::fs::read_to_string(task.path().join("children")).unwrap_or_default());
    lists.flat_map(|list| list.split_whitespace().filter_map(|pid| pid.parse().ok()).collect::<Vec<_>>()).collect()
}

/// Waits until the first worker records an episode; returns its process id.
fn wait_for_worker(parent: u32, parts: &Path) -> u32 {
    let deadline = Instant::now() + Duration::from_secs(120);
    loop {
        assert!(Instant::now() < deadline, "no worker started an episode");
        let begun = std::fs::read_dir(parts.join(".unfinished")).is_ok_and(|mut episodes| episodes.next().is_some());
        if let (true, Some(pid)) = (begun, children(parent).first()) {
            return *pid;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn killed_worker_loses_one_episode_which_the_same_command_records_again() {
    let folder = tempfile::tempdir().unwrap();
    let (out, parts) = (folder.path().join("set"), folder.path().join("set.parts"));
    let running = egotac(&out, &THREE_EPISODES).spawn().unwrap();
    let worker = wait_for_worker(running.id(), &parts);
    assert!(Command::new("kill").args(["-9", &worker.to_string()]).status().unwrap().success());
    let ended = running.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&ended.stderr);
    assert!(!ended.status.success());
    assert!(said.contains("1 of 3 episodes failed: pinch_cube with seed 30") && said.contains("SIGKILL"), "{said}");
    // Another worker recorded the others.
    let made = |index: usize| parts.join(format!("{index:06}")).exists();
    assert!(!made(0) && made(1) && made(2) && !out.exists());

    let again = egotac(&out, &THREE_EPISODES).output().unwrap();
    assert!(again.status.success(), "{}", String::from_utf8_lossy(&again.stderr));
    assert_eq!(ZarrReader::open(&out).unwrap().episode_ends().len(), 3);
    assert!(!parts.exists());

    // Processes and threads generate the same data set.
    let threads = folder.path().join("threads");
    assert!(egotac(&threads, &["--episodes", "3", "--in-process"]).status().unwrap().success());
    let [a, b] = [&out, &threads].map(|path| ZarrReader::open(path).unwrap());
    assert_eq!(a.len(), b.len());
    for name in ["data/mano_force", "data/camera_ego_rgb"] {
        assert!(a.read(name, 0..a.len()).unwrap() == b.read(name, 0..b.len()).unwrap(), "{name}");
    }
}

#[test]
fn skip_failed_writes_the_store_without_failed_episodes() {
    let folder = tempfile::tempdir().unwrap();
    let (out, parts) = (folder.path().join("set"), folder.path().join("set.parts"));
    let running = egotac(&out, &["--episodes", "3", "--skip-failed"]).spawn().unwrap();
    let worker = wait_for_worker(running.id(), &parts);
    assert!(Command::new("kill").args(["-9", &worker.to_string()]).status().unwrap().success());
    let ended = running.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&ended.stdout);
    assert!(ended.status.success() && said.contains("left out: pinch_cube with seed 30"), "{said}");
    assert_eq!(ZarrReader::open(&out).unwrap().episode_ends().len(), 2);
}

#[test]
fn workers_use_the_sigma_of_the_command() {
    let folder = tempfile::tempdir().unwrap();
    let store = |sigma: &str| {
        let out = folder.path().join(sigma);
        let output = egotac(&out, &["--episodes", "1", "--sigma", sigma]).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let reader = ZarrReader::open(&out).unwrap();
        let force = reader.read_f32(MANO_FORCE, 0..reader.len()).unwrap();
        (reader.attributes().sigma, force)
    };
    let ((narrow_sigma, narrow), (wide_sigma, wide)) = (store("2mm"), store("8mm"));
    assert!((narrow_sigma - 0.002).abs() < 1e-12 && (wide_sigma - 0.008).abs() < 1e-12);
    let sum = |force: &[f32]| force.iter().map(|f| f64::from(*f)).sum::<f64>();
    assert!(
        sum(&narrow) > 1.0 && (sum(&wide) / sum(&narrow) - 1.0).abs() < 1e-5,
        "spreading must keep the total force"
    );
    let peak = |force: &[f32]| force.iter().copied().fold(0.0, f32::max);
    assert!(peak(&narrow) > 2.0 * peak(&wide), "{} N, {} N", peak(&narrow), peak(&wide));
    let refused = egotac(&folder.path().join("none"), &["--sigma", "0mm"]).output().unwrap();
    assert!(String::from_utf8_lossy(&refused.stderr).contains("0.1mm to 50mm"));
}
