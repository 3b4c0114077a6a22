//! The programs in `examples/` run and print what their first lines promise.

use std::path::{Path, PathBuf};
use std::process::Command;

use egotac::dataset::tensors;
use egotac::hand::{N_VERTICES, Topology};
use egotac::tactile::{N_FIELD, TactileSequence};
use image::{Rgb, RgbImage};

/// Runs an example, which cargo built beside the program, and returns its lines.
fn run(name: &str, arguments: &[&Path]) -> Vec<String> {
    let folder = Path::new(env!("CARGO_BIN_EXE_egotac")).with_file_name("examples");
    let output = Command::new(folder.join(name)).args(arguments).output().unwrap();
    assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap().lines().map(String::from).collect()
}

/// The numbers of a line of comma-separated values.
fn numbers(line: &str) -> Vec<f64> {
    line.split(',').map(|value| value.parse().unwrap()).collect()
}

/// Three frames; frame t presses vertex 800 (right hand) with t newtons.
fn sequence() -> TactileSequence {
    let mut force = vec![0.0; 3 * N_FIELD];
    for frame in 0..3 {
        force[frame * N_FIELD + 800] = frame as f32;
    }
    TactileSequence {
        timestamps: vec![0.0, 0.1, 0.2],
        ..TactileSequence::from_force(Some(Topology::EgotacHand1), force)
    }
}

fn written(folder: &Path, name: &str, sequence: &TactileSequence) -> PathBuf {
    let path = folder.join(name);
    tensors::write(&path, sequence, Default::default()).unwrap();
    path
}

#[test]
fn predict_video_prints_a_line_per_frame() {
    let folder = tempfile::tempdir().unwrap();
    for index in 0..4 {
        let shade = Rgb([60 * index as u8, 90, 120]);
        RgbImage::from_pixel(64, 48, shade).save(folder.path().join(format!("{index}.png"))).unwrap();
    }
    let video = folder.path().join("in.mkv");
    let mut ffmpeg = Command::new("ffmpeg");
    ffmpeg.args(["-v", "error", "-framerate", "10", "-i"]).arg(folder.path().join("%d.png")).arg(&video);
    assert!(ffmpeg.status().expect("ffmpeg: `make setup` installs it").success());
    let lines = run("predict_video", &[&video]);
    assert_eq!(lines.len(), 1 + 4);
    for (index, line) in lines[1..].iter().enumerate() {
        assert!((numbers(line)[0] - 0.1 * index as f64).abs() < 2e-3, "{line}");
    }
}

#[test]
fn pose_hand_writes_a_mesh_of_778_vertices() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = folder.path().join("hand.obj");
    assert_eq!(run("pose_hand", &[&mesh]).len(), 5 + 1);
    let text = std::fs::read_to_string(mesh).unwrap();
    assert_eq!(text.lines().filter(|line| line.starts_with("v ")).count(), N_VERTICES);
}

#[test]
fn score_files_finds_no_error_between_a_file_and_itself() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path(), "a.safetensors", &sequence());
    let table = run("score_files", &[&path, &path]);
    let row = |name: &str| table.iter().find(|line| line.contains(name)).unwrap_or_else(|| panic!("{table:?}")).clone();
    assert!(row("active MAE").contains(" 0") && row("temporal Pearson").contains(" 1"), "{table:?}");
}

#[test]
fn read_labelled_store_prints_the_peak_force_of_each_hand() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path(), "a.safetensors", &sequence());
    let lines = run("read_labelled_store", &[&path]);
    assert_eq!(lines.len(), 2);
    assert_eq!(numbers(&lines[1]), [0.0, 3.0, 0.0, 2.0]);
}

#[cfg(feature = "sim")]
#[test]
fn retarget_keypoints_closes_the_robot_hand() {
    let lines = run("retarget_keypoints", &[]);
    assert_eq!(lines.len(), 1 + 50);
    let [open, closed] = [numbers(&lines[1]), numbers(lines.last().unwrap())];
    let flexion = |pose: &[f64]| pose[1..].iter().map(|angle| angle.abs()).sum::<f64>();
    assert!(flexion(&closed) > flexion(&open) + 1.0, "{open:?} {closed:?}");
}

#[cfg(feature = "sim")]
#[test]
fn run_scene_prints_the_force_of_the_poke() {
    let lines = run("run_scene", &[Path::new("poke")]);
    let peak = lines[1..].iter().map(|line| numbers(line)[2]).fold(0.0, f64::max);
    assert!(peak > 0.1, "{peak}");
}
