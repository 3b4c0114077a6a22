//! `egotac doctor` reports the parts that this build needs, and fails if one is missing.

use std::process::{Command, Output};

fn doctor(arguments: &[&str], variables: &[(&str, &str)]) -> (Output, Vec<serde_json::Value>) {
    let output = Command::new(env!("CARGO_BIN_EXE_egotac"))
        .args(["doctor", "--json"])
        .args(arguments)
        .envs(variables.iter().copied())
        .output()
        .unwrap();
    let rows = serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("not JSON: {output:?}"));
    (output, rows)
}

fn state<'a>(rows: &'a [serde_json::Value], name: &str) -> &'a str {
    rows.iter().find(|row| row["name"] == name).and_then(|row| row["state"].as_str()).unwrap()
}

#[test]
fn all_parts_are_present_after_set_up() {
    let (output, rows) = doctor(&[], &[]);
    assert!(output.status.success(), "{rows:#?}");
    assert_eq!(state(&rows, "hand"), "ok");
    assert_eq!(state(&rows, "checkpoint"), "ok");
    let expected = |built| if built { "ok" } else { "not_needed" };
    assert_eq!(state(&rows, "messages"), expected(cfg!(feature = "ros")));
    assert_eq!(state(&rows, "MuJoCo"), expected(cfg!(feature = "sim")));
    assert_eq!(state(&rows, "GL renderer"), expected(cfg!(feature = "sim")));
}

#[test]
fn an_absent_hand_file_is_missing() {
    let (output, rows) = doctor(&["--hand", "no/MANO_RIGHT.pkl"], &[]);
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(state(&rows, "hand"), "missing");
}

#[cfg(feature = "sim")]
#[test]
fn a_missing_gl_driver_has_a_fix() {
    let nothing = tempfile::tempdir().unwrap();
    let nothing = nothing.path().join("none.json");
    let (output, rows) = doctor(&[], &[("__EGL_VENDOR_LIBRARY_FILENAMES", nothing.to_str().unwrap())]);
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(state(&rows, "GL renderer"), "missing");
    let row = rows.iter().find(|row| row["name"] == "GL renderer").unwrap();
    assert!(row["fix"].as_str().unwrap().contains("apt-get install libegl1"), "{row}");
}

#[cfg(feature = "ros")]
#[test]
fn bindings_of_another_layout_are_stale() {
    // A copy of the sourced prefix in which one field of one message has another type.
    let sourced = std::env::var("AMENT_PREFIX_PATH").expect("source env.sh");
    let msgs = std::env::split_paths(&sourced).map(|prefix| prefix.join("share/egotac_msgs/msg"));
    let msgs = msgs.into_iter().find(|folder| folder.is_dir()).expect("egotac_msgs in AMENT_PREFIX_PATH");
    let changed = tempfile::tempdir().unwrap();
    let folder = changed.path().join("share/egotac_msgs/msg");
    std::fs::create_dir_all(&folder).unwrap();
    for entry in msgs.read_dir().unwrap() {
        let path = entry.unwrap().path();
        let text = std::fs::read_to_string(&path).unwrap().replace("uint64 sequence", "uint32 sequence");
        std::fs::write(folder.join(path.file_name().unwrap()), text).unwrap();
    }
    let prefixes = format!("{}:{sourced}", changed.path().display());
    let (output, rows) = doctor(&[], &[("AMENT_PREFIX_PATH", &prefixes)]);
    assert_eq!(output.status.code(), Some(1));
    let row = rows.iter().find(|row| row["name"] == "messages").unwrap();
    assert!(row["found"].as_str().unwrap().contains("stale"), "{row}");
}
