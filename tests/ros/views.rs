//! Topics of `egotac_predictor` that show touch in other forms, tested by the rclpy peer `tests/ros/views_peer.py`.

use crate::harness::Session;
use egotac::hand::{HandModel, Side};
use egotac::message::{Header, TactileFrame, TactileRegions};
use egotac::model::Config;
use egotac::{TactileField, Topology};

fn holds(fact: &str, ros_args: &[&str]) {
    let session = Session::new();
    let model = format!("model:={}", session.checkpoint(&Config::toy()).display());
    let mut node = session.node(env!("CARGO_BIN_EXE_egotac_predictor"), &[&["-p", &model], ros_args].concat());
    session.check("views_peer.py", &[fact]);
    node.ends_cleanly("INT");
}

#[test]
fn regions_are_sums_of_the_frame_in_the_order_of_the_latched_names() {
    holds("regions", &[]);
}

#[test]
fn wrenches_in_their_frames_are_those_of_the_coloured_surface() {
    holds("wrenches", &[]);
}

#[test]
fn hands_of_unknown_pose_or_low_confidence_are_shown_at_rest() {
    holds("at_rest", &["-p", "min_confidence:=0.5"]);
}

#[test]
fn the_overlay_is_a_jpeg_of_the_image_and_both_hands() {
    holds("overlay", &[]);
}

#[test]
fn regions_of_a_message_are_the_column_of_label_data_sets_and_unknown_stays_unknown() {
    let regions = Side::BOTH.map(|side| HandModel::builtin(side).regions());
    let mut field = TactileField::zeros(Topology::EgotacHand1);
    for (vertex, force) in field.force.iter_mut().enumerate() {
        *force = (vertex % 7) as f32 / 8.0;
    }
    let tip = regions[1].iter().position(|region| region.name() == "index_tip").unwrap() + 778;
    let summary = |field: &TactileField| {
        let frame = TactileFrame::from_field(Header::default(), field).unwrap();
        TactileRegions::from_frame(&frame, &regions).unwrap()
    };
    assert_eq!(summary(&field).force.to_vec(), field.region_forces(&regions));
    field.contact[tip] = f32::NAN;
    field.force[tip] = f32::NAN;
    let unknown = summary(&field);
    let is_unknown = |values: &[f32]| -> Vec<usize> { (0..34).filter(|index| values[*index].is_nan()).collect() };
    assert_eq!(is_unknown(&unknown.force), [17 + 3]);
    assert_eq!(is_unknown(&unknown.contact), [17 + 3]);
    // A hand that is not in the message is absent.
    let mut frame = TactileFrame::from_field(Header::default(), &field).unwrap();
    frame.hands.remove(1);
    let left = TactileRegions::from_frame(&frame, &regions).unwrap();
    assert!(left.presence[0].is_nan() && left.presence[1] == 0.0 && left.force[17..].iter().all(|f| *f == 0.0));
}
