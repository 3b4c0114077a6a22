//! The program `egotac_verifier` with an rclpy peer in the roles of predictor and simulator, and the three real nodes together.

use crate::harness::Session;
use serde_json::Value;

const PROGRAM: &str = env!("CARGO_BIN_EXE_egotac_verifier");
const PEER: &str = "verifier_peer.py";

/// Runs one check of the peer; returns the verifier's report and output.
fn report(fact: &str) -> (Value, String) {
    let session = Session::new();
    let path = session.path("report.json");
    let report = format!("report:={}", path.display());
    let mut node = session.node(PROGRAM, &["-p", &report, "-p", "window_secs:=60.0"]);
    session.check(PEER, &[fact]);
    node.ends_cleanly("TERM");
    (serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap(), node.output())
}

#[test]
fn metrics_agree_with_numpy() {
    // The peer compares ~/metrics with its own numpy computation; the report holds the same totals.
    let (report, printed) = report("scores");
    assert_eq!(report["pairs"], 20);
    assert_eq!(report["unmatched_predictions"], 1);
    assert_eq!(report["unmatched_truths"], 3);
    assert_eq!(report["invalid_truths"], 2);
    assert_eq!(report["model_id"], "peer/1");
    let mae = report["metrics"]["mae"].as_f64().unwrap();
    assert!((mae - 0.25 * 100.0 / 1556.0).abs() < 1e-6, "{mae}");
    assert!(report["metrics"]["pooled"]["auroc"].as_f64().is_some());
    assert!(printed.contains("20 pairs"), "{printed}");
}

#[test]
fn fields_of_different_topologies_are_not_compared() {
    let (report, printed) = report("topologies");
    assert_eq!(report["pairs"], 1);
    assert!(printed.contains("topology mismatch: mano and egotac-hand-1"), "{printed}");
}

#[test]
fn a_report_that_cannot_be_written_ends_the_node_with_an_error_and_the_path() {
    let session = Session::new();
    let mut node = session.node(PROGRAM, &["-p", "report:=/dev/null/report.json"]);
    // The node runs once its services answer.
    session.check(PEER, &["up"]);
    node.signal("INT");
    assert_eq!(node.wait().code(), Some(1));
    assert!(node.output().contains("cannot write the report: /dev/null"), "{}", node.output());
}

#[test]
fn a_missed_required_score_is_logged_and_sets_the_exit_status() {
    for (require, code) in [("require:=f1=0.5,missed_force=0.9", 0), ("require:=f1=0.5,mae=0.001", 1)] {
        let session = Session::new();
        let path = session.path("report.json");
        let report = format!("report:={}", path.display());
        let mut node = session.node(PROGRAM, &["-p", &report, "-p", require]);
        session.check(PEER, &["scores"]);
        node.signal("TERM");
        assert_eq!(node.wait().code(), Some(code), "{require}: {}", node.output());
        let missed = "mae: at most 0.001 is required, got 0.0161, which misses by 0.0151";
        assert_eq!(node.output().contains(missed), code == 1, "{}", node.output());
        assert!(!node.output().contains("f1: at least"), "{}", node.output());
        // The report is written in both cases.
        let report: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
        assert_eq!(report["touch"]["pooled.f1"], report["metrics"]["pooled"]["f1"]);
        assert!(report["touch"]["onset_error_secs"].is_f64());
    }
}

#[test]
fn an_unknown_required_score_ends_the_node_at_start() {
    let session = Session::new();
    let mut node = session.node(PROGRAM, &["-p", "require:=f2=0.5"]);
    assert_eq!(node.wait().code(), Some(1));
    assert!(node.output().contains("parameter require") && node.output().contains("missed_force"), "{}", node.output());
}

/// Runs all three programs for three simulated seconds; returns the verifier's report.
#[cfg(feature = "sim")]
fn pipeline(simulator_args: &[&str], predictor_args: &[&str], verifier_args: &[&str]) -> Value {
    let session = Session::new();
    let model = format!("model:={}", session.checkpoint(&egotac::model::Config::toy()).display());
    let path = session.path("report.json");
    let report = format!("report:={}", path.display());
    let verifier_fixed = ["-p", &report, "-r", "tactile:=predictor/tactile", "-r", "truth:=truth/tactile"];
    let mut verifier = session.node(PROGRAM, &[&verifier_fixed, verifier_args].concat());
    let predictor_fixed = ["-p", &model, "-p", "reliability:=reliable", "-r", "image:=image_raw"];
    let mut predictor =
        session.node(env!("CARGO_BIN_EXE_egotac_predictor"), &[&predictor_fixed, predictor_args].concat());
    predictor.prints("images from");
    session.check(PEER, &["up"]);
    let simulator_fixed = ["-p", "scenes:=[pinch_cube]", "-p", "duration:=3.0", "-p", "wait_secs:=60.0"];
    let mut simulator =
        session.node(env!("CARGO_BIN_EXE_egotac_simulator"), &[&simulator_fixed, simulator_args].concat());
    assert_eq!(simulator.wait().code(), Some(0), "{}", simulator.output());
    predictor.ends_cleanly("INT");
    verifier.ends_cleanly("INT");
    let report: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    // A busy machine may skip frames, and the last frame may not be predicted yet.
    let (pairs, alone) = (report["pairs"].as_u64().unwrap(), report["unmatched_truths"].as_u64().unwrap());
    assert!(pairs >= 10 && pairs + alone <= 75, "{report:#}");
    // On a busy machine DDS may connect the verifier to the simulator later than the predictor.
    assert!(pairs + report["unmatched_predictions"].as_u64().unwrap() <= 75, "{report:#}");
    assert!(report["model_id"].as_str().unwrap().starts_with("random/"));
    report
}

#[cfg(feature = "sim")]
#[test]
fn simulated_frames_are_predicted_and_scored() {
    let report = pipeline(&[], &["-r", "hand_pose:=truth/hand_pose"], &[]);
    assert!(report["latency_secs"]["p50"].as_f64().unwrap() > 0.0);
}

#[cfg(feature = "sim")]
#[test]
fn pipeline_works_with_simulated_time_and_compressed_images() {
    let simulator = ["-p", "pace:=clock", "-p", "compressed:=true"];
    let predictor = ["-p", "image_transport:=compressed", "-p", "use_sim_time:=true"];
    let report = pipeline(&simulator, &predictor, &["-p", "use_sim_time:=true"]);
    // Latencies are in simulated time, of which at most three seconds passed.
    assert!(report["latency_secs"]["max"].as_f64().unwrap() < 3.0);
}
