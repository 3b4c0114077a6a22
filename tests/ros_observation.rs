//! The policy's observation builder of `examples/` against rclpy, which plays camera, arm and predictor.
#![cfg(feature = "ros")]

#[path = "ros/harness.rs"]
mod harness;

use harness::Session;

#[test]
fn image_joints_and_touch_pair_by_their_stamps() {
    Session::new().check("observation_peer.py", &[]);
}
