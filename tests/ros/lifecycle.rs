//! Lifecycle of the nodes, tested by the rclpy peer `tests/ros/lifecycle_peer.py`.

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

/// Takes a node that waits through all states, twice; `topic` exists while the node is configured.
fn goes_through_all_states(program: &str, node: &str, topic: &str, kind: &str, ros_args: &[&str]) {
    let session = Session::new();
    let mut running = session.node(program, &[ros_args, &["-p", "autostart:=false"]].concat());
    session.check(PEER, &["any_node", node, topic, kind]);
    let status = running.wait();
    assert_eq!(status.code(), Some(0), "{status}\n{}", running.output());
}

#[test]
fn the_verifier_has_all_states() {
    goes_through_all_states(
        env!("CARGO_BIN_EXE_egotac_verifier"),
        "verifier",
        "verifier/metrics",
        "TactileMetrics",
        &[],
    );
}

#[test]
fn the_trainer_has_all_states_and_takes_no_goal_while_inactive() {
    let folder = tempfile::tempdir().unwrap();
    let folder = format!("folder:={}", folder.path().display());
    let program = env!("CARGO_BIN_EXE_egotac_trainer");
    goes_through_all_states(program, "trainer", "trainer/status", "TrainerStatus", &["-p", &folder]);
}

#[test]
#[cfg(feature = "sim")]
fn the_retargeter_has_all_states() {
    let program = env!("CARGO_BIN_EXE_egotac_retargeter");
    goes_through_all_states(program, "retargeter", "retargeter/touch", "RobotTouch", &["-p", "start:=rest"]);
}

#[test]
#[cfg(feature = "sim")]
fn the_simulator_has_all_states_and_pauses_while_inactive() {
    let program = env!("CARGO_BIN_EXE_egotac_simulator");
    let small = ["-p", "scenes:=[hover]", "-p", "width:=32", "-p", "height:=32"];
    goes_through_all_states(program, "simulator", "truth/tactile", "TactileTruth", &small);
}
