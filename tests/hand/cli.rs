//! `egotac hand` poses, draws and maps hands, and its errors name the cause.

use std::collections::HashMap;
use std::path::Path;
use std::process::{Command, Output};

use crate::common::hand_data;
use egotac::hand::{N_JOINTS, N_VERTICES};
use safetensors::tensor::{Dtype, TensorView};
use safetensors::{SafeTensors, serialize};

fn hand(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_egotac")).arg("hand").args(args).output().unwrap()
}

fn succeeds(args: &[&str]) -> String {
    let output = hand(args);
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Returns the single line that a failure prints.
fn fails(args: &[&str]) -> String {
    let output = hand(args);
    assert!(!output.status.success(), "{args:?} succeeded");
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(message.lines().count(), 1, "{message}");
    message
}

fn write(path: &Path, tensors: &[(&str, Vec<usize>, Vec<f32>)], metadata: Option<HashMap<String, String>>) {
    let bytes: Vec<Vec<u8>> =
        tensors.iter().map(|(_, _, v)| v.iter().flat_map(|x| x.to_le_bytes()).collect()).collect();
    let views = tensors.iter().zip(&bytes);
    let views =
        views.map(|((name, shape, _), data)| (*name, TensorView::new(Dtype::F32, shape.clone(), data).unwrap()));
    std::fs::write(path, serialize(views, metadata).unwrap()).unwrap();
}

fn floats(bytes: &[u8], name: &str) -> (Vec<usize>, Vec<f32>) {
    let file = SafeTensors::deserialize(bytes).unwrap();
    let tensor = file.tensor(name).unwrap();
    (tensor.shape().to_vec(), tensor.data().as_chunks().0.iter().copied().map(f32::from_le_bytes).collect())
}

#[test]
fn forward_gives_what_smplx_gives() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out.safetensors");
    let [golden, mano, out] =
        [hand_data("golden.safetensors"), hand_data("right.npz"), out].map(|p| p.display().to_string());
    succeeds(&["forward", "--model", &mano, "--params", &golden, "--out", &out]);
    let (out, golden) = (std::fs::read(&out).unwrap(), std::fs::read(&golden).unwrap());
    for (name, rows) in [("vertices", N_VERTICES), ("joints", N_JOINTS)] {
        let (shape, values) = floats(&out, name);
        let (_, expected) = floats(&golden, &format!("right_{name}"));
        assert_eq!(shape, [7, rows, 3]);
        let worst = values.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 2e-6, "{name}: {worst} m");
    }
}

#[test]
fn forward_names_missing_keys_and_wrong_shapes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("params.safetensors");
    let out = folder.path().join("out.safetensors");
    let run = |tensors: &[(&str, Vec<usize>, Vec<f32>)]| {
        write(&path, tensors, None);
        fails(&["forward", "--params", path.to_str().unwrap(), "--out", out.to_str().unwrap()])
    };
    let zeros = |name: &'static str, shape: &[usize]| (name, shape.to_vec(), vec![0.0; shape.iter().product()]);
    let message = run(&[zeros("betas", &[2, 10]), zeros("transl", &[2, 3])]);
    assert!(message.contains("missing global_orient, hand_pose; there: betas, transl"), "{message}");
    let rest = [zeros("betas", &[2, 10]), zeros("transl", &[2, 3]), zeros("global_orient", &[2, 3])];
    let message = run(&[&rest[..], &[zeros("hand_pose", &[2, 15, 3])]].concat());
    assert!(message.contains("hand_pose: expected shape [2, 45], got [2, 15, 3]"), "{message}");
    let message = run(&[&rest[..], &[zeros("hand_pose", &[3, 45])]].concat());
    assert!(message.contains("hand_pose: expected shape [2, 45], got [3, 45]"), "{message}");
    let message = run(&[&rest[..], &[("hand_pose", vec![2, 45], vec![f32::NAN; 90])]].concat());
    assert!(message.contains("hand_pose: expected finite numbers, got NaN in row 0"), "{message}");
    assert!(!out.exists(), "a failed run left a file");
}

#[test]
fn forward_takes_any_batch() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("p.safetensors"), folder.path().join("deep/er/o.safetensors"));
    for rows in [0usize, 1, 5] {
        let zeros = |name: &'static str, width: usize| (name, vec![rows, width], vec![0.0; rows * width]);
        write(
            &path,
            &[zeros("betas", 10), zeros("transl", 3), zeros("global_orient", 3), zeros("hand_pose", 45)],
            None,
        );
        succeeds(&["forward", "--side", "left", "--params", path.to_str().unwrap(), "--out", out.to_str().unwrap()]);
        assert_eq!(floats(&std::fs::read(&out).unwrap(), "vertices").0, [rows, N_VERTICES, 3]);
    }
}

#[test]
fn fix_left_shapedirs_is_refused_for_the_built_in_hand() {
    let message = fails(&["show", "--fix-left-shapedirs", "--out", "never.png"]);
    assert!(message.contains("--side left"), "{message}");
}

#[test]
fn show_draws_a_png() {
    let folder = tempfile::tempdir().unwrap();
    for (model, side) in [("builtin".into(), "left"), (hand_data("right.npz").display().to_string(), "right")] {
        let out = folder.path().join(format!("{side}.png"));
        succeeds(&["show", "--model", &model, "--side", side, "--out", out.to_str().unwrap()]);
        let picture = image::open(&out).unwrap().to_rgb8();
        let inked = picture.pixels().filter(|p| p.0 != [255; 3]).count();
        assert!(inked > 200_000, "{inked} pixels drawn");
    }
}

#[test]
fn map_transfers_force_in_both_directions() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (field, there, back, weights) = (path("f"), path("t"), path("b"), path("w"));
    let mano = hand_data("right.npz").display().to_string();
    let force: Vec<f32> = (0..2 * 1556).map(|k| if k % 7 == 0 { 0.3 } else { 0.0 }).collect();
    let metadata = HashMap::from([("topology".to_string(), "egotac-hand-1".to_string())]);
    write(Path::new(&field), &[("force", vec![2, 1556], force.clone())], Some(metadata));
    succeeds(&["map", "--mano", &mano, "--field", &field, "--to", "mano", "--out", &there]);
    let message = fails(&["map", "--mano", &mano, "--field", &there, "--to", "mano", "--out", &back]);
    assert!(message.contains("expected egotac-hand-1") && message.contains("got mano"), "{message}");
    succeeds(&["map", "--mano", &mano, "--field", &there, "--to", "builtin", "--out", &back]);
    for (file, topology) in [(&there, "mano"), (&back, "egotac-hand-1")] {
        let bytes = std::fs::read(file).unwrap();
        let (shape, carried) = floats(&bytes, "force");
        assert_eq!(shape, [2, 1556]);
        for (before, after) in force.chunks(778).zip(carried.chunks(778)) {
            let total = |force: &[f32]| force.iter().map(|f| f64::from(*f)).sum::<f64>();
            assert!((total(before) - total(after)).abs() < 1e-4, "{} N became {} N", total(before), total(after));
        }
        let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
        assert_eq!(header.metadata().as_ref().unwrap()["topology"], topology);
    }
    let message = succeeds(&["map", "--mano", &mano, "--out", &weights]);
    assert!(message.contains("keypoints"), "{message}");
    let bytes = std::fs::read(&weights).unwrap();
    let (shape, weight) = floats(&bytes, "to_mano.contact.weight");
    assert!(shape[0] >= 778 && (weight.iter().sum::<f32>() - 778.0).abs() < 0.01);
}

#[test]
fn invalid_hand_files_are_named() {
    let message = fails(&["show", "--model", "/nowhere/MANO_RIGHT.pkl"]);
    assert!(message.contains("/nowhere/MANO_RIGHT.pkl"), "{message}");
    let golden = hand_data("golden.safetensors").display().to_string();
    let message = fails(&["show", "--model", &golden]);
    assert!(message.contains("golden.safetensors") && message.contains("not a MANO pickle"), "{message}");
}

#[test]
fn equal_runs_write_equal_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let [golden, mano, out] =
        [hand_data("golden.safetensors"), hand_data("right.npz"), folder.path().join("out.safetensors")]
            .map(|path| path.display().to_string());
    // The order of two keys of metadata would be equal by chance in one of 2^7 tests.
    let runs: std::collections::BTreeSet<Vec<u8>> = (0..8)
        .map(|_| {
            succeeds(&["forward", "--model", &mano, "--params", &golden, "--out", &out]);
            std::fs::read(&out).unwrap()
        })
        .collect();
    assert_eq!(runs.len(), 1);
}
