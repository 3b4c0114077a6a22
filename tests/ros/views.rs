//! Topics of `egotac_predictor` that show touch in other forms, tested by the rclpy peer `tests/ros/views_peer.py`.

use std::path::Path;

use crate::common::save_network_with_presence;
use crate::harness::Session;
use egotac::hand::{HandModel, Side};
use egotac::message::{Header, TactileFrame, TactileRegions};
use egotac::model::Config;
use egotac::{TactileField, Topology};

/// Runs a check of the peer beside a predictor; returns what the predictor printed.
fn holds(fact: &str, ros_args: &[&str]) -> String {
    let session = Session::new();
    let model = session.checkpoint(&Config::toy());
    holds_with(&session, &model, fact, ros_args)
}

fn holds_with(session: &Session, model: &Path, fact: &str, ros_args: &[&str]) -> String {
    let model = format!("model:={}", model.display());
    let mut node = session.node(env!("CARGO_BIN_EXE_egotac_predictor"), &[&["-p", &model], ros_args].concat());
    session.check("views_peer.py", &[fact]);
    node.ends_cleanly("INT");
    node.output()
}

#[test]
fn contacts_are_the_regions_in_contact_with_their_centres_of_force() {
    holds("contacts", &[]);
}

#[test]
fn keypoints_come_on_demand_and_are_unknown_for_an_absent_hand() {
    let session = Session::new();
    let model = session.path("presence.safetensors");
    save_network_with_presence(&model, [false, true]);
    let output = holds_with(&session, &model, "keypoints", &["-p", "view:=letterbox"]);
    assert!(!output.contains("of the picture"), "{output}");
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
    let output = holds("overlay", &[]);
    // The network of this test crops a picture of 4:3 to a square, which is told once.
    let warning = "25 % of the picture (640 x 480) lies outside of the network's view (crop)";
    assert_eq!(output.matches(warning).count(), 1, "{output}");
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
