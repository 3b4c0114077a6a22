//! The program `egotac_glove` with an rclpy peer in the roles of camera and gloves.

use crate::harness::Session;

const PROGRAM: &str = env!("CARGO_BIN_EXE_egotac_glove");
const PEER: &str = "glove_peer.py";

/// Runs one check of the peer beside the node; returns the node's output.
fn check(fact: &str, parameters: &[&str]) -> String {
    let session = Session::new();
    let arguments: Vec<&str> = parameters.iter().flat_map(|parameter| ["-p", parameter]).collect();
    let mut node = session.node(PROGRAM, &arguments);
    session.check(PEER, &[fact]);
    node.ends_cleanly("TERM");
    node.output()
}

#[test]
fn stamped_readings_are_interpolated_to_the_images_stamps_and_keep_their_sum() {
    check("stamped", &[]);
}

#[test]
fn an_array_without_a_stamp_gets_the_time_of_its_arrival_and_the_parameters_calibration() {
    check("arrays", &["sensor:=opentouch_169", "rest:=3072.0", "newtons_per_unit:=-0.001"]);
}

#[test]
fn a_glove_without_a_calibration_gives_contact_and_no_force() {
    check("uncalibrated", &["sensor:=opentouch_169"]);
}

#[test]
fn readings_of_another_glove_are_dropped_with_the_reason() {
    let output = check("foreign", &[]);
    assert!(
        output.contains("values of the right glove, taxel map aether_132: expected shape [132], got [5]"),
        "{output}"
    );
}

#[test]
fn an_unknown_taxel_map_ends_the_node_at_start() {
    let session = Session::new();
    let mut node = session.node(PROGRAM, &["-p", "sensor:=mitten"]);
    assert_eq!(node.wait().code(), Some(1));
    assert!(node.output().contains("parameter sensor") && node.output().contains("aether_132"), "{}", node.output());
}
