//! The program `egotac_simulator`, tested by the rclpy peer `tests/ros/simulator_peer.py`.

use crate::harness::Session;

const PROGRAM: &str = env!("CARGO_BIN_EXE_egotac_simulator");
const PEER: &str = "simulator_peer.py";

/// Runs one check of the peer on a node that ends by itself.
fn holds(fact: &str, ros_args: &[&str]) {
    let session = Session::new();
    let mut peer = session.peer(PEER, &[fact]);
    let mut node = session.node(PROGRAM, &[&["-p", "wait_secs:=60.0"], ros_args].concat());
    let status = node.wait();
    assert_eq!(status.code(), Some(0), "{}", node.output());
    let status = peer.wait();
    assert!(status.success(), "{fact}: {status}\n{}\n{}", peer.output(), node.output());
}

#[test]
fn all_topics_of_a_frame_carry_one_stamp_and_the_hand_lies_in_the_image() {
    holds("frames", &["-p", "scenes:=lift_mug", "-p", "pace:=clock", "-p", "duration:=1.0", "-p", "seed:=3"]);
}

#[test]
fn wall_clock_stamps_are_the_time_of_publication() {
    holds("wall", &["-p", "scenes:=[pinch_cube]", "-p", "duration:=0.4", "-p", "width:=64", "-p", "height:=48"]);
}

#[test]
fn with_use_sim_time_an_external_clock_sets_the_pace() {
    let small = ["-p", "width:=32", "-p", "height:=32"];
    let follows = ["-p", "scenes:=[pinch_cube]", "-p", "duration:=1.0", "-p", "use_sim_time:=true"];
    holds("follows", &[&small[..], &follows[..]].concat());
}

#[test]
fn compressed_images_are_published_on_request() {
    holds("compressed", &["-p", "scenes:=[pinch_cube]", "-p", "duration:=0.4", "-p", "compressed:=true"]);
}

#[test]
fn episodes_are_played_in_the_order_of_the_scenes() {
    let scenes = "scenes:=[hover, pinch_cube]";
    let small = ["-p", scenes, "-p", "episodes:=2", "-p", "pace:=fast", "-p", "width:=16", "-p", "height:=16"];
    holds("episodes", &small);
}

#[test]
fn sigint_and_sigterm_end_the_node_with_status_0_during_an_episode() {
    for signal in ["INT", "TERM"] {
        let session = Session::new();
        let mut node = session.node(PROGRAM, &["-p", "scenes:=[pinch_cube]"]);
        node.prints("episode 0");
        node.ends_cleanly(signal);
    }
}

#[test]
fn an_unknown_scene_is_refused_with_the_list_of_known_ones() {
    let session = Session::new();
    let mut node = session.node(PROGRAM, &["-p", "scenes:=[juggle]"]);
    assert_eq!(node.wait().code(), Some(1), "{}", node.output());
    assert!(node.output().contains("scene \"juggle\" is unknown; known: "), "{}", node.output());
}
