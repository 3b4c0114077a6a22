//! Parameter files with wildcards, as rclcpp matches them.

use crate::harness::Session;

const PROGRAM: &str = env!("CARGO_BIN_EXE_egotac_verifier");

/// Starts a verifier with a parameter file and checks its parameter `window_secs`.
fn window_of_file(text: &str, expected: &str, arguments: &[&str]) {
    let session = Session::new();
    let path = session.path("params.yaml");
    std::fs::write(&path, text.replace("NAMESPACE", session.namespace())).unwrap();
    let file = path.display().to_string();
    let mut node = session.node(PROGRAM, &[&["--params-file", &file], arguments].concat());
    session.check("standard_peer.py", &["double_parameter", "verifier", "window_secs", expected]);
    node.ends_cleanly("INT");
}

#[test]
fn a_wildcard_of_one_part_matches_the_namespace() {
    window_of_file("/*/verifier: { ros__parameters: { window_secs: 7.5 } }", "7.5", &[]);
}

#[test]
fn a_wildcard_below_a_namespace_matches_its_nodes() {
    window_of_file("NAMESPACE/**: { ros__parameters: { window_secs: 7.5 } }", "7.5", &[]);
}

#[test]
fn a_wildcard_that_does_not_match_changes_nothing() {
    window_of_file("/*/*/verifier: { ros__parameters: { window_secs: 7.5 } }", "5.0", &[]);
}

#[test]
fn the_last_matching_entry_of_a_file_wins() {
    let text = "
/**: { ros__parameters: { window_secs: 1.5 } }
/*/verifier: { ros__parameters: { window_secs: 2.5 } }
";
    window_of_file(text, "2.5", &[]);
    let text = "
/*/verifier: { ros__parameters: { window_secs: 2.5 } }
NAMESPACE/verifier: { ros__parameters: { window_secs: 3.5 } }
";
    window_of_file(text, "3.5", &[]);
}
