//! Topic statistics of `egotac_predictor`, tested by the rclpy peer `tests/ros/topic_statistics_peer.py`.

use crate::harness::Session;
use egotac::model::Config;

const PROGRAM: &str = env!("CARGO_BIN_EXE_egotac_predictor");

#[test]
fn statistics_tell_age_and_period_of_the_images() {
    let session = Session::new();
    let model = format!("model:={}", session.checkpoint(&Config::toy()).display());
    let mut node = session.node(PROGRAM, &["-p", &model, "-p", "enable_topic_statistics:=true"]);
    session.check("topic_statistics_peer.py", &["age_and_period"]);
    node.ends_cleanly("INT");
}

#[test]
fn without_the_parameter_there_are_no_statistics() {
    let session = Session::new();
    let model = format!("model:={}", session.checkpoint(&Config::toy()).display());
    let mut node = session.node(PROGRAM, &["-p", &model]);
    session.check("topic_statistics_peer.py", &["silence"]);
    node.ends_cleanly("INT");
}
