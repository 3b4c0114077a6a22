//! The program `egotac_predictor`, tested by the rclpy peer `tests/ros/predictor_peer.py`.

use crate::harness::{Running, Session};
use egotac::model::Config;

const PROGRAM: &str = env!("CARGO_BIN_EXE_egotac_predictor");
const PEER: &str = "predictor_peer.py";

/// Starts a predictor with a small random network.
fn predictor(session: &Session, ros_args: &[&str]) -> Running {
    predictor_with(session, &Config::toy(), ros_args)
}

fn predictor_with(session: &Session, config: &Config, ros_args: &[&str]) -> Running {
    let model = format!("model:={}", session.checkpoint(config).display());
    session.node(PROGRAM, &[&["-p", &model], ros_args].concat())
}

/// Starts the node, runs one check of the peer, and stops the node.
fn holds(fact: &str, ros_args: &[&str]) {
    let session = Session::new();
    let mut node = predictor(&session, ros_args);
    session.check(PEER, &[fact]);
    node.ends_cleanly("INT");
}

#[test]
fn images_of_every_encoding_size_and_padding_are_predicted_with_equal_stamps() {
    holds("encodings", &[]);
}

#[test]
fn a_frame_holds_both_hands_left_first() {
    holds("frames", &[]);
}

#[test]
fn png_and_jpeg_images_are_taken_from_the_resolved_compressed_topic() {
    let session = Session::new();
    let mut node = predictor(&session, &["-p", "image_transport:=compressed", "-r", "image:=cam/image_raw"]);
    session.check(PEER, &["compressed", concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/ros")]);
    node.ends_cleanly("INT");
}

#[test]
fn the_image_topic_can_be_remapped() {
    holds("remapped", &["-r", "image:=cam/image_raw"]);
}

#[test]
fn a_malformed_image_is_dropped_with_a_warning_that_names_the_fault() {
    holds("malformed", &[]);
}

#[test]
fn images_are_rectified_by_camera_info_if_asked_for() {
    holds("rectifies", &["-p", "rectify:=true"]);
}

#[test]
fn a_damaged_compressed_image_is_dropped() {
    holds("malformed_compressed", &["-p", "image_transport:=compressed"]);
}

#[test]
fn sigint_and_sigterm_end_the_node_with_status_0_while_images_arrive() {
    for signal in ["INT", "TERM"] {
        let session = Session::new();
        let mut node = predictor(&session, &[]);
        let mut stream = session.peer(PEER, &["stream"]);
        stream.prints("flows");
        node.ends_cleanly(signal);
    }
}

#[test]
fn model_info_reaches_a_late_subscriber() {
    let session = Session::new();
    let mut node = predictor(&session, &[]);
    node.prints("images from");
    session.check(PEER, &["latched"]);
    node.ends_cleanly("TERM");
}

#[test]
fn parameters_are_listed_described_set_and_refused() {
    // An integer is accepted for a double on the command line, too.
    holds("parameters", &["-p", "contact_threshold:=0.25", "-p", "max_age_ms:=0"]);
}

#[test]
fn a_slow_network_processes_the_newest_image_and_drops_older_ones() {
    let session = Session::new();
    let slow = Config { vision_width: 384, vision_depth: 12, image: 224, ..Config::toy() };
    let mut node = predictor_with(&session, &slow, &["-p", "reliability:=reliable"]);
    session.check(PEER, &["latest_wins"]);
    node.ends_cleanly("INT");
}

#[test]
fn latency_budget_picks_the_best_network_of_a_folder_and_logs_the_reason() {
    let session = Session::new();
    let large = session.checkpoint(&Config::pocket());
    std::fs::rename(&large, large.with_file_name("large.safetensors")).unwrap();
    let folder = format!("model:={}", session.checkpoint(&Config::toy()).parent().unwrap().display());
    let mut node = session.node(PROGRAM, &["-p", &folder, "-p", "latency_budget_ms:=60000.0"]);
    node.prints("large.safetensors in f32");
    node.prints("is the best that keeps the budget of 60000 ms");
    session.check(PEER, &["frames"]);
    node.ends_cleanly("INT");
}

#[test]
fn hostile_checkpoints_are_refused_and_the_predictor_goes_on() {
    let session = Session::new();
    let folder = session.path("hostile");
    std::fs::create_dir(&folder).unwrap();
    let at = |name: &str| folder.join(name);
    // Checkpoints that promise more than they hold, among them the largest geometry and 96 layers.
    let crafted = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/hostile");
    for kind in ["safetensors", "pt"] {
        for entry in std::fs::read_dir(crafted.join(kind)).unwrap() {
            let entry = entry.unwrap();
            std::fs::copy(entry.path(), at(entry.file_name().to_str().unwrap())).unwrap();
        }
    }
    let intact = std::fs::read(session.checkpoint(&Config::toy())).unwrap();
    for (name, length) in [("empty", 0), ("of_7_bytes", 7), ("half", intact.len() / 2), ("cut", intact.len() - 1)] {
        std::fs::write(at(&format!("{name}.safetensors")), &intact[..length]).unwrap();
    }
    std::fs::create_dir(at("folder.safetensors")).unwrap();
    assert!(std::process::Command::new("mkfifo").arg(at("pipe.safetensors")).status().unwrap().success());
    std::os::unix::fs::symlink("/dev/zero", at("zeros.safetensors")).unwrap();
    let mut node = predictor(&session, &[]);
    session.check(PEER, &["hostile_models", folder.to_str().unwrap()]);
    assert!(node.is_running());
    node.ends_cleanly("INT");
}

#[test]
fn set_enabled_stops_and_resumes_predictions() {
    holds("enabled", &[]);
}

#[test]
fn points_carry_the_frames_forces_on_the_hand_pose() {
    holds("points", &[]);
}

#[test]
fn old_images_are_dropped_and_counted() {
    holds("stale", &["-p", "max_age_ms:=5000"]);
}

#[test]
fn reliability_match_adapts_to_a_later_publisher() {
    holds("match", &["-p", "reliability:=match"]);
}

#[test]
fn large_images_arrive_with_the_fast_dds_profile() {
    holds("large", &[]);
}

/// Starts the program and expects exit status 1 and one line with `text`.
fn refuses(ros_args: &[&str], text: &str) {
    let session = Session::new();
    let mut node = session.node(PROGRAM, ros_args);
    let status = node.wait();
    let output = node.output();
    assert_eq!(status.code(), Some(1), "{output}");
    assert!(output.lines().any(|line| line.contains(text)), "{output}");
    assert!(!output.contains("panicked"), "{output}");
}

#[test]
fn invalid_parameters_end_the_program_with_one_line() {
    refuses(&["-p", "model:=/nowhere/model.safetensors"], "/nowhere/model.safetensors: no such file");
    refuses(&["-p", "device:=tpu"], "parameter device: expected one of cpu, cuda, got \"tpu\"");
    refuses(&["-p", "max_age_ms:=soon"], "parameter max_age_ms: expected double, got string \"soon\"");
    refuses(&["-r", "image"], "ROS arguments: ");
}

#[test]
fn parameters_are_described_without_ros() {
    let output = std::process::Command::new(PROGRAM).arg("--describe-parameters").output().unwrap();
    assert!(output.status.success());
    let described: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(described["contact_threshold"]["maximum"], 1.0);
    assert_eq!(described["image_transport"]["one_of"], serde_json::json!(["raw", "compressed"]));
}
