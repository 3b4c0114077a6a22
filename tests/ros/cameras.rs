//! Several cameras on one `egotac_predictor`, tested by the rclpy peer `tests/ros/cameras_peer.py`.

use crate::harness::{Running, Session};
use egotac::model::{Config, shipped};

const PROGRAM: &str = env!("CARGO_BIN_EXE_egotac_predictor");
const PEER: &str = "cameras_peer.py";

/// Starts a predictor of three cameras with a random network.
fn three_cameras(session: &Session, config: &Config, ros_args: &[&str]) -> Running {
    let model = format!("model:={}", session.checkpoint(config).display());
    let cameras = ["-p", &model, "-p", "cameras:=[head, left, right]", "-p", "reliability:=reliable"];
    session.node(PROGRAM, &[&cameras, ros_args].concat())
}

#[test]
fn results_of_three_cameras_are_bit_equal_to_those_of_three_predictors() {
    let session = Session::new();
    let mut together = three_cameras(&session, &Config::toy(), &[]);
    let model = format!("model:={}", session.path("model.safetensors").display());
    let single = |name: &str| {
        let (node, image) = (format!("__node:=only_{name}"), format!("image:={name}/image"));
        let own = ["-p", &model, "-p", "reliability:=reliable", "-p", "threads:=1", "-r", &node, "-r", &image];
        session.node(PROGRAM, &own)
    };
    let mut singles = ["head", "left", "right"].map(single);
    session.check(PEER, &["bit_equal"]);
    together.ends_cleanly("INT");
    singles.iter_mut().for_each(|node| node.ends_cleanly("INT"));
}

#[test]
fn beyond_capacity_the_newest_image_of_each_camera_wins_and_each_drop_is_counted() {
    let session = Session::new();
    let slow = Config { vision_width: 384, vision_depth: 12, image: 224, ..Config::toy() };
    let mut node = three_cameras(&session, &slow, &[]);
    session.check(PEER, &["drops_are_counted"]);
    node.ends_cleanly("INT");
}

#[test]
fn the_fused_result_is_that_of_the_camera_with_the_most_familiar_image() {
    let session = Session::new();
    let model = format!("model:={}", shipped::path().unwrap().display());
    let arguments =
        ["-p", &model, "-p", "cameras:=[head, left]", "-p", "unknown:=guess", "-p", "fusion_window_ms:=10000"];
    let mut node = session.node(PROGRAM, &arguments);
    session.check(PEER, &["fused"]);
    node.ends_cleanly("INT");
}

#[test]
fn threads_are_as_many_as_asked_for_and_bound_to_the_cores() {
    let session = Session::new();
    let mut node = three_cameras(&session, &Config::toy(), &["-p", "threads:=3", "-p", "pin_cores:=[0]"]);
    node.prints("3 computing threads on the cores [0]");
    node.prints("images from");
    let tasks = std::fs::read_dir(format!("/proc/{}/task", node.id())).unwrap();
    let statuses = tasks.filter_map(|task| std::fs::read_to_string(task.unwrap().path().join("status")).ok());
    let computing: Vec<String> = statuses.filter(|status| status.starts_with("Name:\tcompute-")).collect();
    assert_eq!(computing.len(), 3, "{computing:#?}");
    assert!(computing.iter().all(|status| status.contains("Cpus_allowed_list:\t0\n")), "{computing:#?}");
    node.ends_cleanly("INT");
}

#[test]
fn a_core_that_is_not_there_and_a_name_that_is_no_topic_end_the_program() {
    let session = Session::new();
    for (given, text) in [
        ("pin_cores:=[4000]", "parameter pin_cores: expected cores that this process may use, got 4000"),
        ("cameras:=[a-b]", "parameter cameras: expected names of letters, digits and underscores, got \"a-b\""),
    ] {
        let model = format!("model:={}", session.checkpoint(&Config::toy()).display());
        let mut node = session.node(PROGRAM, &["-p", &model, "-p", given]);
        assert_eq!(node.wait().code(), Some(1), "{}", node.output());
        assert!(node.output().contains(text), "{}", node.output());
    }
}
