//! The example `examples/hand_tracker.py` with a stand-in for MediaPipe, and the retargeter that follows it.

use crate::harness::Session;

const PEER: &str = "hand_tracker_peer.py";

#[test]
fn keypoints_of_both_hands_come_with_the_stamp_of_the_image_at_their_place() {
    let session = Session::new();
    let tracker = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/hand_tracker.py");
    let namespace = format!("__ns:={}", session.namespace());
    let mut tracker = session.peer(PEER, &["tracker", tracker, "--ros-args", "-r", &namespace]);
    session.check(PEER, &["keypoints"]);
    tracker.ends_cleanly("INT");
}

#[test]
#[cfg(feature = "sim")]
fn the_retargeter_follows_the_tracked_hand() {
    let session = Session::new();
    let tracker = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/hand_tracker.py");
    let namespace = format!("__ns:={}", session.namespace());
    let mut tracker = session.peer(PEER, &["tracker", tracker, "--ros-args", "-r", &namespace]);
    let arguments = [
        "-p",
        "start:=rest",
        "-p",
        "side:=right",
        "-r",
        "keypoints:=hand_tracker/right/keypoints",
        "-p",
        "robot:=four_finger",
    ];
    let mut node = session.node(env!("CARGO_BIN_EXE_egotac_retargeter"), &arguments);
    session.check(PEER, &["followed"]);
    node.ends_cleanly("INT");
    tracker.ends_cleanly("INT");
}
