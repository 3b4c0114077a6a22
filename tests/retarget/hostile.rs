//! Robots, objects and recordings made to crash, fill the memory or never end: a clean error that names the file.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Guard against hangs; the processor time of a trial ends far earlier.
const HANG: Duration = Duration::from_secs(120);

/// Runs `egotac` with a short processor time for models.
fn egotac(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_egotac"));
    command.args(arguments).env("EGOTAC_LIMIT_MODEL_SECONDS", "3");
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let deadline = Instant::now() + HANG;
    while child.try_wait().unwrap().is_none() {
        if Instant::now() > deadline {
            child.kill().unwrap();
            panic!("{arguments:?} hangs");
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    child.wait_with_output().unwrap()
}

/// Returns the one line of a clean error.
fn refused(arguments: &[&str]) -> String {
    let output = egotac(arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {:?}, {said}", output.status);
    assert!(said.starts_with("egotac: ") && !said.contains("panicked"), "{said}");
    said
}

fn write(folder: &Path, name: &str, text: &str) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path
}

fn world(content: &str) -> String {
    format!("<mujoco><worldbody>{content}</worldbody></mujoco>")
}

fn asset(content: &str) -> String {
    format!("<mujoco><asset>{content}</asset><worldbody><geom size=\"1\"/></worldbody></mujoco>")
}

#[test]
fn models_that_crash_fill_the_memory_or_never_end_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let flex =
        "<flexcomp name=\"f\" type=\"grid\" count=\"2000 2000 2000\" spacing=\"1 1 1\" dim=\"3\" radius=\".1\"/>";
    let replicate = "<replicate count=\"1000000000\" offset=\"0 0 1\"><geom size=\"1\"/></replicate>";
    let height = "<hfield name=\"h\" nrow=\"100000\" ncol=\"100000\" size=\"1 1 1 1\"/>";
    let texture = "<texture name=\"t\" type=\"2d\" builtin=\"flat\" width=\"40000\" height=\"40000\"/>";
    let models = [
        ("flex.xml", world(flex), ""),
        ("replicate.xml", world(replicate), "raises the limit"),
        ("height.xml", asset(height), ""),
        ("texture.xml", asset(texture), "EGOTAC_LIMIT_MODEL_BYTES raises the limit"),
        ("deep.xml", world(&format!("{}{}", "<body>".repeat(100_000), "</body>".repeat(100_000))), ""),
    ];
    for (name, text, expected) in models {
        let path = write(folder.path(), name, &text);
        let path = path.to_str().unwrap();
        let output = folder.path().join("out").display().to_string();
        let as_object =
            ["retarget", "run", "--robot", "four_finger", "--input", "none", "--object", path, "--out", &output];
        for error in [refused(&["retarget", "inspect", path]), refused(&as_object)] {
            assert!(error.contains(name) || error.contains("mujoco") || error.contains("XML"), "{error}");
            assert!(error.contains(expected), "{name}: {error}");
        }
    }
}

#[test]
fn a_good_model_of_somebody_else_loads_within_the_limits() {
    let model = concat!(env!("CARGO_MANIFEST_DIR"), "/sim/robots/four_finger.xml");
    let [own, given] = [["retarget", "inspect", "four_finger", "--json"], ["retarget", "inspect", model, "--json"]];
    let [own, given] = [own, given].map(|arguments| egotac(&arguments));
    assert!(given.status.success(), "{}", String::from_utf8_lossy(&given.stderr));
    let facts = |output: &Output| serde_json::from_slice::<serde_json::Value>(&output.stdout).unwrap();
    assert_eq!(facts(&own)["coordinates"], facts(&given)["coordinates"]);
}

#[test]
fn pipes_and_devices_are_refused_as_robot_mesh_object_and_recording() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe.stl");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let model =
        asset("<mesh name=\"m\" file=\"pipe.stl\"/>").replace("<geom size=\"1\"/>", "<geom type=\"mesh\" mesh=\"m\"/>");
    let model = write(folder.path(), "model.xml", &model);
    let robot = folder.path().join("robot.xml");
    std::os::unix::fs::symlink("/dev/zero", &robot).unwrap();
    let [pipe, model, robot] = [&pipe, &model, &robot].map(|path| path.to_str().unwrap());
    let out = folder.path().join("out").display().to_string();
    let run = |rest: [&str; 4]| {
        let [a, b, c, d] = rest;
        refused(&["retarget", "run", "--robot", "four_finger", "--out", &out, a, b, c, d])
    };
    for (error, got) in [
        (refused(&["retarget", "inspect", model]), "a pipe"),
        (refused(&["retarget", "inspect", robot]), "a device"),
        (run(["--object", pipe, "--input", "none"]), "a pipe"),
        (run(["--input", pipe, "--smooth", "0"]), "a pipe"),
        (run(["--input", "/dev/zero", "--smooth", "0"]), "a device"),
    ] {
        assert!(error.contains(&format!("expected a regular file, got {got}")), "{error}");
    }
}

/// Returns a URDF of a palm with two chains of two hinges, with these shapes.
fn gripper(shape: &str) -> String {
    let mut text = String::from("<link name=\"base\"/>");
    for (chain, y) in [("p", 0.1), ("q", -0.1)] {
        let mut parent = "base".to_owned();
        for (link, z) in [("1", 0.0), ("2", 0.05)] {
            let name = format!("{chain}{link}");
            text += &format!("<link name=\"{name}\"><collision><geometry>{shape}</geometry></collision></link>");
            text += &format!(
                "<joint name=\"j{name}\" type=\"revolute\"><parent link=\"{parent}\"/><child link=\"{name}\"/>"
            );
            text += &format!("<origin xyz=\"0 {y} {z}\"/><axis xyz=\"1 0 0\"/>");
            text += "<limit lower=\"0\" upper=\"1\" effort=\"1\" velocity=\"1\"/></joint>";
            parent = name;
        }
    }
    format!("<robot name=\"r\">{text}</robot>")
}

#[test]
fn a_missing_mesh_is_named_where_the_robot_has_no_fingers_without_it() {
    let folder = tempfile::tempdir().unwrap();
    let text = gripper("<mesh filename=\"meshes/finger.stl\"/>");
    // One fixed joint alone is not a finger in any case.
    let fixed = text.replace("revolute", "fixed");
    let path = write(folder.path(), "robot.urdf", &fixed);
    let error = refused(&["retarget", "inspect", path.to_str().unwrap()]);
    assert!(error.contains("meshes/finger.stl") && error.contains("robot.urdf"), "{error}");
}

#[test]
fn entities_and_masses_of_nodes_in_a_urdf_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let entity = format!(
        "<!DOCTYPE robot [<!ENTITY a \"{}\">]><robot name=\"{}\"/>",
        "a".repeat(1 << 20),
        "&a;".repeat(1 << 20)
    );
    let path = write(folder.path(), "entity.urdf", &entity);
    let error = refused(&["retarget", "inspect", path.to_str().unwrap()]);
    assert!(error.contains("entity.urdf") && error.contains("entities"), "{error}");
    let nodes = format!("<robot name=\"r\">{}</robot>", "<a/>".repeat(2_000_000));
    let path = write(folder.path(), "nodes.urdf", &nodes);
    let error = refused(&["retarget", "inspect", path.to_str().unwrap()]);
    assert!(error.contains("nodes.urdf") && error.contains("1000000 nodes"), "{error}");
    let deep = format!("<robot name=\"r\">{}{}</robot>", "<a>".repeat(500_000), "</a>".repeat(500_000));
    let path = write(folder.path(), "deep.urdf", &deep);
    refused(&["retarget", "inspect", path.to_str().unwrap()]);
}
