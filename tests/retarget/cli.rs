//! `egotac retarget` as a user calls it: files, metadata, errors.

#[allow(dead_code)]
use std::collections::HashMap;
use std::path::Path;

use crate::common::egotac;
use crate::trajectory::Trajectory;
use egotac::hand::{N_VERTICES, Side};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};

fn write(path: &Path, tensors: &[(&str, Vec<usize>, Vec<f64>)], metadata: &[(&str, &str)]) {
    let bytes: Vec<Vec<u8>> = tensors.iter().map(|(.., v)| v.iter().flat_map(|x| x.to_le_bytes()).collect()).collect();
    let views = tensors
        .iter()
        .zip(&bytes)
        .map(|((name, shape, _), bytes)| (*name, TensorView::new(Dtype::F64, shape.clone(), bytes).unwrap()));
    let metadata: HashMap<String, String> = metadata.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect();
    std::fs::write(path, safetensors::serialize(views, Some(metadata)).unwrap()).unwrap();
}

fn numbers(bytes: &[u8], name: &str) -> (Vec<usize>, Vec<f64>) {
    let tensors = SafeTensors::deserialize(bytes).unwrap();
    let tensor = tensors.tensor(name).unwrap();
    let values = match tensor.dtype() {
        Dtype::F64 => tensor.data().as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect(),
        Dtype::F32 => tensor.data().as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b).into()).collect(),
        _ => tensor.data().iter().map(|b| f64::from(*b)).collect(),
    };
    (tensor.shape().to_vec(), values)
}

fn flat(trajectory: &Trajectory) -> Vec<f64> {
    trajectory.keypoints.iter().flatten().flat_map(|p| p.to_array()).collect()
}

#[test]
fn run_writes_a_trajectory_and_reports_bad_frames() {
    let folder = tempfile::tempdir().unwrap();
    let (input, out) = (folder.path().join("in.safetensors"), folder.path().join("out.safetensors"));
    let trajectory = Trajectory::generate(90, 2).unwrap();
    let mut keypoints = flat(&trajectory);
    keypoints[40 * 63 + 3 * 8 + 1] = f64::NAN;
    let contact = trajectory.tip_contact.iter().flatten().copied().collect();
    let force: Vec<f64> = trajectory.tip_force.iter().flatten().flat_map(|f| f.to_array()).collect();
    let tensors = [
        ("keypoints", vec![90, 21, 3], keypoints),
        ("tip_contact", vec![90, 5], contact),
        ("tip_force", vec![90, 5, 3], force.clone()),
    ];
    write(&input, &tensors, &[]);
    let run = egotac(&[
        "retarget",
        "run",
        "--robot",
        "four_finger",
        "--input",
        input.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
        "--fps",
        "30",
    ]);
    let said = String::from_utf8(run.stderr).unwrap();
    assert!(run.status.success() && said.contains("frame 40") && said.contains("keypoint 8 (index tip)"), "{said}");
    let bytes = std::fs::read(&out).unwrap();
    let (shape, qpos) = numbers(&bytes, "qpos");
    assert_eq!(shape, [90, 16]);
    assert!(qpos.iter().all(|x| x.is_finite()));
    assert_eq!(qpos[39 * 16..40 * 16], qpos[40 * 16..41 * 16]);
    let (_, status) = numbers(&bytes, "status");
    assert_eq!((status[40], status.iter().filter(|s| **s == 4.0).count()), (4.0, 1));
    for (name, shape) in
        [("ctrl", vec![90, 16]), ("tip_force", vec![90, 5, 3]), ("objective", vec![90]), ("solve_time_us", vec![90])]
    {
        let (got, values) = numbers(&bytes, name);
        assert_eq!(got, shape, "{name}");
        assert!(values.iter().all(|x| x.is_finite()), "{name}");
    }
    // The robot has no little finger: the other fingers carry the sum of all forces.
    let (_, out_force) = numbers(&bytes, "tip_force");
    for frame in (0..90).filter(|frame| *frame != 40) {
        let sum = |all: &[f64], axis: usize| (0..5).map(|finger| all[(frame * 5 + finger) * 3 + axis]).sum::<f64>();
        let asked: Vec<f64> = (0..3).map(|axis| sum(&force, axis)).collect();
        let size = asked.iter().map(|x| x * x).sum::<f64>().sqrt();
        for (axis, asked) in asked.iter().enumerate() {
            assert!((sum(&out_force, axis) - asked).abs() <= 0.05 * size.max(0.5), "frame {frame}");
        }
    }
    let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
    let names = &header.metadata().as_ref().unwrap()["joint_names"];
    let names: Vec<String> = serde_json::from_str(names).unwrap();
    assert_eq!((names.len(), names[0].as_str()), (16, "index_spread"));

    // Forces of the fingers on the world have the opposite sign, in the output as in the input.
    let turned: Vec<f64> = force.iter().map(|x| -x).collect();
    let other = folder.path().join("other.safetensors");
    write(&input, &[tensors[0].clone(), tensors[1].clone(), ("tip_force", vec![90, 5, 3], turned)], &[]);
    let run = egotac(&[
        "retarget",
        "run",
        "--robot",
        "four_finger",
        "--input",
        input.to_str().unwrap(),
        "--out",
        other.to_str().unwrap(),
    ]);
    assert!(run.status.success());
    let (_, mirrored) = numbers(&std::fs::read(&other).unwrap(), "tip_force");
    assert!(out_force.iter().zip(&mirrored).all(|(a, b)| (a + b).abs() < 1e-5));
}

#[test]
fn a_field_on_the_vertices_is_pooled_and_mano_parameters_are_posed() {
    let folder = tempfile::tempdir().unwrap();
    let (input, out) = (folder.path().join("in.safetensors"), folder.path().join("out.safetensors"));
    let model = egotac::hand::HandModel::builtin(Side::Right);
    let regions = model.regions();
    let on_tip = |v: usize| regions[v % N_VERTICES] == egotac::hand::Region::IndexTip;
    let force: Vec<f64> = (0..3 * 2 * N_VERTICES)
        .map(|k| if k % (2 * N_VERTICES) >= N_VERTICES && on_tip(k % (2 * N_VERTICES)) { 0.2 } else { 0.0 })
        .collect();
    let tensors = [("hand_pose", vec![3, 45], vec![0.05; 135]), ("force", vec![3, 2 * N_VERTICES], force)];
    write(&input, &tensors, &[("topology", "egotac-hand-1"), ("side", "right")]);
    let run = egotac(&[
        "retarget",
        "run",
        "--robot",
        "four_finger",
        "--input",
        input.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ]);
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let bytes = std::fs::read(&out).unwrap();
    let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
    let links: Vec<String> = serde_json::from_str(&header.metadata().as_ref().unwrap()["link_names"]).unwrap();
    let (shape, contact) = numbers(&bytes, "link_contact");
    assert_eq!(shape, [3, links.len()]);
    for (link, contact) in links.iter().zip(&contact) {
        assert_eq!(*contact > 0.5, link == "index_distal", "{link}");
    }
}

#[test]
fn errors_name_the_file_the_tensor_and_the_known_robots() {
    let folder = tempfile::tempdir().unwrap();
    let input = folder.path().join("in.safetensors");
    let out = folder.path().join("out.safetensors");
    let run = |robot: &str| {
        let output = egotac(&[
            "retarget",
            "run",
            "--robot",
            robot,
            "--input",
            input.to_str().unwrap(),
            "--out",
            out.to_str().unwrap(),
        ]);
        assert_eq!(output.status.code(), Some(1));
        String::from_utf8(output.stderr).unwrap()
    };
    assert!(run("four_finger").contains("in.safetensors"));
    write(&input, &[("points", vec![1, 21, 3], vec![0.0; 63])], &[]);
    let said = run("four_finger");
    assert!(said.contains("keypoints") && said.contains("points"), "{said}");
    write(&input, &[("keypoints", vec![1, 20, 3], vec![0.0; 60])], &[]);
    let said = run("four_finger");
    assert!(said.contains("21") && said.contains("20"), "{said}");
    write(&input, &[("keypoints", vec![2, 21, 3], vec![0.0; 126])], &[]);
    let said = run("four_finger");
    assert!(said.contains("no frame is a hand") && !out.exists(), "{said}");
    assert!(run("five_finger").contains("four_finger"));
}

#[test]
fn links_stay_out_of_an_object_which_needs_poses_and_shape() {
    let folder = tempfile::tempdir().unwrap();
    let [input, ball, free, held] =
        ["in.safetensors", "ball.xml", "free.safetensors", "held.safetensors"].map(|name| folder.path().join(name));
    std::fs::write(&ball, "<mujoco><worldbody><geom type=\"sphere\" size=\"0.02\"/></worldbody></mujoco>").unwrap();
    let trajectory = Trajectory::generate(60, 2).unwrap();
    // A ball at the human's index fingertip: without it, the robot's would be inside.
    let poses =
        |tip: usize| trajectory.keypoints.iter().flat_map(move |k| [k[tip].x, k[tip].y, k[tip].z, 1.0, 0.0, 0.0, 0.0]);
    let keypoints = ("keypoints", vec![60, 21, 3], flat(&trajectory));
    let with_poses = [keypoints.clone(), ("object_pose", vec![60, 7], poses(8).collect())];
    let run = |out: &Path, object: &[&str]| {
        let files = [input.to_str().unwrap(), "--out", out.to_str().unwrap()];
        let output = egotac(&[&["retarget", "run", "--robot", "four_finger", "--input"], &files[..], object].concat());
        (output.status.success(), String::from_utf8(output.stderr).unwrap())
    };
    let object = ["--object", ball.to_str().unwrap()];
    write(&input, &[keypoints], &[]);
    let (ok, said) = run(&held, &object);
    assert!(!ok && said.contains("object_pose") && !held.exists(), "{said}");
    assert!(run(&free, &[]).0);
    write(&input, &with_poses, &[]);
    let (ok, said) = run(&held, &[]);
    assert!(!ok && said.contains("--object") && !held.exists(), "{said}");
    let (ok, said) = run(&held, &object);
    assert!(ok, "{said}");
    let [free, held] = [free, held].map(|path| numbers(&std::fs::read(path).unwrap(), "qpos").1);
    let moved = |joints: std::ops::Range<usize>| -> f64 {
        let frames = free.chunks(16).zip(held.chunks(16)).skip(10);
        frames
            .map(|(a, b)| {
                (a[joints.clone()].iter().zip(&b[joints.clone()])).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
            })
            .fold(0.0, f64::max)
    };
    assert!(moved(0..4) > 0.1, "the index finger stays out: {}", moved(0..4));
    assert!(moved(0..4) > 3.0 * moved(8..12), "the ring finger is far: {}", moved(8..12));
}

/// Output of `egotac retarget list` where models are looked for below `folder` only.
fn listed(folder: &Path, arguments: &[&str]) -> std::process::Output {
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_egotac"));
    command.arg("retarget").args(arguments).env("EGOTAC_ROBOTS", folder);
    command.env_remove("MENAGERIE_ROOT").env_remove("EGOTAC_PYTHON").output().unwrap()
}

#[test]
fn list_says_which_models_are_found_and_where_to_get_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let output = listed(folder.path(), &["list"]);
    let text = String::from_utf8(output.stdout).unwrap();
    let line =
        |text: &str, name: &str| text.lines().find(|line| line.starts_with(&format!("{name} "))).unwrap().to_owned();
    assert!(line(&text, "four_finger").contains("usable    part of the program"), "{text}");
    let missing = line(&text, "allegro_right");
    assert!(missing.contains("no model") && missing.contains("wonik_allegro/right_hand.xml"), "{missing}");
    assert!(missing.contains("MENAGERIE_ROOT"), "{missing}");
    assert!(line(&text, "inspire_left").contains("dexi-rs"), "{text}");

    let model = folder.path().join("wonik_allegro/right_hand.xml");
    std::fs::create_dir_all(model.parent().unwrap()).unwrap();
    std::fs::write(&model, "<mujoco/>").unwrap();
    let output = listed(folder.path(), &["list", "--json"]);
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let robots = json.as_array().unwrap();
    let found = |name: &str| &robots.iter().find(|robot| robot["name"] == name).unwrap()["found"];
    assert_eq!(found("allegro_right"), model.to_str().unwrap());
    assert!(found("allegro_left").is_null());
    assert_eq!(robots.len(), text.lines().count());
}

#[test]
fn the_start_of_a_name_stands_for_the_one_robot_that_fits_or_lists_the_candidates() {
    let folder = tempfile::tempdir().unwrap();
    let inspected = listed(folder.path(), &["inspect", "tendon", "--json"]);
    assert!(inspected.status.success(), "{}", String::from_utf8_lossy(&inspected.stderr));
    let facts: serde_json::Value = serde_json::from_slice(&inspected.stdout).unwrap();
    assert_eq!(facts["robot"], "tendon_hand");

    let refused = listed(folder.path(), &["inspect", "allegro"]);
    let text = String::from_utf8_lossy(&refused.stderr);
    assert!(!refused.status.success());
    for name in ["allegro_right", "allegro_left", "allegro_urdf_right", "allegro_urdf_left", "not found here"] {
        assert!(text.contains(name), "{text}");
    }
    assert!(!text.contains("shadow"), "{text}");

    // Of several robots, the only one whose model is found is meant: here one whose model is broken, which the error names.
    let model = folder.path().join("wonik_allegro/right_hand.xml");
    std::fs::create_dir_all(model.parent().unwrap()).unwrap();
    std::fs::write(&model, "<broken").unwrap();
    let broken = listed(folder.path(), &["inspect", "allegro"]);
    let text = String::from_utf8_lossy(&broken.stderr);
    assert!(!broken.status.success() && text.contains("right_hand.xml") && !text.contains("allegro_left"), "{text}");
}
