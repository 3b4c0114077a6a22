//! `examples/observation_builder.py` with an rclpy peer in the roles of camera, arm and predictor.

use crate::harness::Session;

#[test]
fn image_joints_and_touch_are_paired_by_their_stamps() {
    Session::new().check("observation_peer.py", &[]);
}
