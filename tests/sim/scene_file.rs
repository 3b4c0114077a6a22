//! Scene files are checked completely before the simulation; errors name file, key and the expected value.

use std::path::{Path, PathBuf};

use egotac::sim::{Rollout, RolloutOptions, SHIPPED, Scene, mesh_faults};

/// Returns the error of `pinch_cube` with `from` replaced by `to`.
fn edited(from: &str, to: &str) -> String {
    let text = SHIPPED.iter().find(|(name, _)| *name == "pinch_cube").unwrap().1;
    assert!(text.contains(from), "{from}");
    let text = text.replacen(from, to, 1);
    Scene::parse("edited", Path::new("edited.yaml"), &text).unwrap_err().to_string()
}

#[test]
fn each_shipped_scene_loads_by_name() {
    for (name, _) in SHIPPED {
        let scene = Scene::load(name).unwrap();
        assert_eq!(scene.name, name);
        assert!(!scene.spec.description.is_empty());
    }
}

#[test]
fn unknown_scene_error_lists_known_scenes() {
    let error = Scene::load("pinch_kube").unwrap_err().to_string();
    assert!(error.contains("pinch_kube") && error.contains("pinch_cube"), "{error}");
}

#[test]
fn unknown_key_is_refused_with_file_and_key() {
    let error = edited("mass:", "weight: 3\n    mass:");
    assert!(error.contains("edited.yaml") && error.contains("weight") && error.contains("friction"), "{error}");
    let error = edited("squeeze: 1", "squeze: 1");
    assert!(error.contains("squeze") && error.contains("squeeze"), "{error}");
}

#[test]
fn value_out_of_range_error_gives_the_expected_range() {
    let error = edited("mass: [0.02, 0.08]", "mass: [0.08, 0.02]");
    assert!(error.contains("low <= high"), "{error}");
    let error = edited("mass: [0.02, 0.08]", "mass: 0");
    assert!(error.contains("objects[0].mass"), "{error}");
    let error = edited("mass: [0.02, 0.08]", "mass: heavy");
    assert!(error.contains("a number or a range"), "{error}");
    let error = edited("hands:", "rate: 30\nhands:");
    assert!(error.contains("whole number") && error.contains("0.002"), "{error}");
    let error = edited("hands:", "physics: { timestep: 0 }\nhands:");
    assert!(error.contains("timestep"), "{error}");
    let error = edited("object: cube", "object: ball");
    assert!(error.contains("ball") && error.contains("cube"), "{error}");
    let error = edited("at: [-1, 0, 0]", "at: [0, 0, 0]");
    assert!(error.contains("direction"), "{error}");
    let error = edited("force: [0.4, 1.2]", "force: [-2, -1]");
    assert!(error.contains("contacts.thumb.force") && error.contains("0 to 1000"), "{error}");
    let error = edited("share: 1", "share: .nan");
    assert!(error.contains("share"), "{error}");
    let error = edited("name: cube", "name: table").replace("object: cube", "object: table");
    assert!(error.contains("objects[0].name") && error.contains("a name of its own"), "{error}");
    let error = edited("- presence: 0.3", "- { side: left, presence: 0.3 }");
    assert!(error.contains("hands[1].side"), "{error}");
}

#[test]
fn optional_keys_are_checked() {
    let error = edited("hands:", "observe: [rgb, smell]\nhands:");
    assert!(error.contains("smell") && error.contains("slip"), "{error}");
    let error = edited("squeeze: 1", "wrap: 1");
    assert!(error.contains("act.wrap") && error.contains("fingers and torque"), "{error}");
    let error = edited("curl: [0.3, 0.6]", "curl: 0.5\n      wrap: { fingers: [palm], torque: 0.1 }");
    assert!(error.contains("wrap.fingers") && error.contains("palm"), "{error}");
    let error = edited("mass:", "raised: 0.1\n    mass:");
    assert!(error.contains("objects[0].raised") && error.contains("solid"), "{error}");
    let error = edited("hands:", "distractors: [0, 400]\nhands:");
    assert!(error.contains("distractors") && error.contains("40"), "{error}");
    let error = edited("hands:", "camera: { shutter: 0.1 }\nhands:");
    assert!(error.contains("camera.shutter") && error.contains("0.04"), "{error}");
    let error = edited("shape: { cube: { size: [0.03, 0.048] } }", "shape: { soft: { radius: 0.03, stiffness: 1 } }");
    assert!(error.contains("objects[0].shape.stiffness"), "{error}");
    let soft = "shape: { soft: { radius: 0.03, stiffness: 9000, points: 3 } }";
    let error = edited("shape: { cube: { size: [0.03, 0.048] } }", soft);
    assert!(error.contains("objects[0].shape.points") && error.contains("4 to 15"), "{error}");
}

/// Writes the stump of a pyramid, 40 mm high, in millimetres, with the given faces, and the scene `hover` with it.
fn write_stump(folder: &Path, faces: &[&str]) -> (PathBuf, String) {
    let corners = [(0, 0), (40, 0), (40, 40), (0, 40)].map(|(x, y)| (x, y, 0));
    let corners = corners.into_iter().chain([(10, 10), (30, 10), (30, 30), (10, 30)].map(|(x, y)| (x, y, 40)));
    let mut text: String = corners.map(|(x, y, z)| format!("v {x} {y} {z}\n")).collect();
    text += &faces.iter().map(|face| format!("f {face}\n")).collect::<String>();
    std::fs::write(folder.join("stump.obj"), text).unwrap();
    let scene = SHIPPED.iter().find(|(name, _)| *name == "hover").unwrap().1;
    let start = scene.find("    shape:").unwrap();
    let end = start + scene[start..].find('\n').unwrap();
    let scene =
        format!("{}    shape: {{ mesh: {{ file: stump.obj, scale: 0.001 }} }}{}", &scene[..start], &scene[end..]);
    let path = folder.join("stump.yaml");
    std::fs::write(&path, &scene).unwrap();
    (path, scene)
}

const STUMP: [&str; 6] = ["1 4 3 2", "5 6 7 8", "1 2 6 5", "2 3 7 6", "3 4 8 7", "4 1 5 8"];

#[test]
fn mesh_faults_are_reported_per_file() {
    let folder = tempfile::tempdir().unwrap();
    let faults = |faces: &[&str]| {
        let (path, _) = write_stump(folder.path(), faces);
        mesh_faults(&Scene::load(path.to_str().unwrap()).unwrap()).unwrap().concat()
    };
    assert_eq!(faults(&STUMP), "");
    let open = faults(&STUMP[..5]);
    assert!(open.contains("stump.obj") && open.contains("open: 4 edges"), "{open}");
    let inverted = STUMP.map(|face| face.chars().rev().collect::<String>());
    let inside_out = faults(&inverted.each_ref().map(String::as_str));
    // The stump's volume: 40 mm x (40² + 20² + 40 x 20) mm² / 3.
    assert!(inside_out.contains("inside out: its volume is -3.7e-5 m³"), "{inside_out}");
}

#[test]
fn mesh_path_is_relative_to_the_scene_file() {
    let folder = tempfile::tempdir().unwrap();
    let (path, scene) = write_stump(folder.path(), &STUMP);
    let options = RolloutOptions { picture: None, ..RolloutOptions::default() };
    let mut rollout = Rollout::new(&Scene::load(path.to_str().unwrap()).unwrap(), 1, &options).unwrap();
    let mut last = 0.0;
    while let Some(frame) = rollout.next_frame().unwrap() {
        last = frame.objects[0].position.z;
        assert!(frame.frame.validity.reason().is_empty(), "{}", frame.frame.validity.reason());
    }
    // It rests on its bottom: the centre of its bounding box is at 20 mm.
    assert!((last - 0.02).abs() < 1e-3, "{last} m");
    // Relative to another folder the file is not found, and the error names the path.
    let error = Rollout::new(&Scene::parse("stump", Path::new("elsewhere/stump.yaml"), &scene).unwrap(), 1, &options);
    let error = error.unwrap_err().to_string();
    assert!(error.contains("elsewhere/stump.obj"), "{error}");
}
