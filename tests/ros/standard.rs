//! Services and topics of every ROS 2 node, tested on `egotac_verifier` by the rclpy peer `tests/ros/standard_peer.py`.

use crate::harness::Session;

const PROGRAM: &str = env!("CARGO_BIN_EXE_egotac_verifier");

/// Runs one check of the peer on a node; returns the node's output.
fn holds(fact: &str, ros_args: &[&str]) -> String {
    let session = Session::new();
    let mut node = session.node(PROGRAM, ros_args);
    session.check("standard_peer.py", &[fact]);
    node.ends_cleanly("INT");
    node.output()
}

#[test]
fn simulated_time_can_be_chosen_while_a_node_runs() {
    holds("simulated", &[]);
}

#[test]
fn the_level_of_the_log_is_honoured_and_can_be_changed() {
    let printed = holds("levels", &["--log-level", "error"]);
    assert!(!printed.contains("takes the time from /clock"), "a line below the level: {printed}");
}

#[test]
fn parameter_files_name_all_nodes_or_one_by_its_full_name() {
    let session = Session::new();
    let path = session.path("params.yaml");
    let text = "/**:\n  ros__parameters:\n    print: false\nNAME:\n  ros__parameters:\n    window_secs: 7.0\n";
    let name = format!("{}/verifier", session.namespace());
    std::fs::write(&path, text.replace("NAME", &name)).unwrap();
    let mut node = session.node(PROGRAM, &["--params-file", path.to_str().unwrap()]);
    session.check("standard_peer.py", &["wildcards"]);
    node.ends_cleanly("INT");
}
