//! Lifecycle of `egotac_predictor`, tested by the rclpy peer `tests/ros/lifecycle_peer.py`.

use crate::harness::Session;
use egotac::model::Config;

const PROGRAM: &str = env!("CARGO_BIN_EXE_egotac_predictor");
const PEER: &str = "lifecycle_peer.py";

#[test]
fn a_lifecycle_manager_takes_a_node_through_all_states() {
    let session = Session::new();
    let model = format!("model:={}", session.checkpoint(&Config::toy()).display());
    let mut node = session.node(PROGRAM, &["-p", &model, "-p", "autostart:=false"]);
    session.check(PEER, &["goes_through_all_states"]);
    // The transition to finalized ends the program.
    let status = node.wait();
    assert_eq!(status.code(), Some(0), "{status}\n{}", node.output());
}

#[test]
fn a_configuration_that_fails_leaves_the_node_unconfigured() {
    let session = Session::new();
    let mut node = session.node(PROGRAM, &["-p", "model:=/nothing/here", "-p", "autostart:=false"]);
    session.check(PEER, &["cannot_be_configured"]);
    node.ends_cleanly("INT");
    assert!(node.output().contains("/nothing/here: no such file"), "{}", node.output());
}
