//! `examples/observation_builder.py` with an rclpy peer in the roles of camera, arm and predictor.
#![cfg(feature = "ros")]

#[path = "ros/harness.rs"]
mod harness;

use harness::Session;

#[test]
fn image_joints_and_touch_are_paired_by_their_stamps() {
    Session::new().check("observation_peer.py", &[]);
}
