//! The program `egotac_retargeter`, tested by the rclpy peer `tests/ros/retargeter_peer.py`.

#[allow(dead_code)]
use std::path::PathBuf;

use crate::harness::{Running, Session};
use crate::trajectory::Trajectory;
use egotac::hand::{HandModel, HandParams, N_VERTICES, Region, Side};
use egotac::message::{HandPose, Header};
use egotac::mujoco::object::Shapes;
use egotac::retarget::human::{Hand, keypoint};
use egotac::retarget::{Input, ObjectPose, Retargeter, Robot, Touch, TouchPooling};
use glam::Vec3;
use serde_json::{Value, json};

const PROGRAM: &str = env!("CARGO_BIN_EXE_egotac_retargeter");
const PEER: &str = "retargeter_peer.py";
/// Time between two frames of the peer, s.
const DT: f64 = 0.04;

/// Parameters of a node that follows at once, to compare it with the library: on another way, a robot may end in another local
/// minimum.
const AT_ONCE: [&str; 8] =
    ["-p", "start:=rest", "-p", "ramp_secs:=0.0", "-p", "input_timeout_ms:=0.0", "-p", "acceleration:=100000.0"];
/// Default of the parameter `acceleration`, rad/s^2.
const ACCELERATION: f64 = 50.0;

fn node(session: &Session, ros_args: &[&str]) -> Running {
    session.node(PROGRAM, ros_args)
}

/// Runs one check of the peer on a node that follows at once.
fn holds(fact: &str, case: &Value, ros_args: &[&str]) -> String {
    holds_with(fact, case, &[&AT_ONCE, ros_args].concat())
}

/// Starts the node, runs one check of the peer on `case`, and stops the node; returns its output.
fn holds_with(fact: &str, case: &Value, ros_args: &[&str]) -> String {
    let session = Session::new();
    let path = session.path("case.json");
    std::fs::write(&path, case.to_string()).unwrap();
    let mut node = node(&session, ros_args);
    session.check(PEER, &[fact, path.to_str().unwrap()]);
    node.ends_cleanly("INT");
    node.output()
}

/// Returns frames for the peer with the library's results: `hand`, `force` (778), `qpos`, `normal_force`.
fn case(robot: &str, frames: Vec<(Value, [glam::DVec3; 21], Vec<f32>)>) -> Value {
    case_about(Robot::load(robot, None).unwrap(), frames, |_| None)
}

/// Returns frames as [`case`]; `object` gives the pose of the object for a hand.
fn case_about(
    robot: Robot,
    frames: Vec<(Value, [glam::DVec3; 21], Vec<f32>)>,
    object: impl Fn(&[glam::DVec3; 21]) -> Option<ObjectPose>,
) -> Value {
    let mut retargeter = Retargeter::new(robot).unwrap();
    let side = retargeter.robot().side();
    let pooling = TouchPooling::builtin(side).unwrap();
    let names: Vec<String> = retargeter.robot().joint_names().into_iter().map(str::to_owned).collect();
    let ranges: Vec<[f64; 2]> = {
        let robot = retargeter.robot();
        robot.output_joints().map(|joint| robot.parts.joints[joint].range).collect()
    };
    let frames: Vec<Value> = frames
        .into_iter()
        .enumerate()
        .map(|(frame, (hand, keypoints, force))| {
            let mut input = Input::new(keypoints, 1000.0 + frame as f64 * DT);
            input.object = object(&keypoints);
            if !force.is_empty() {
                let mut touch = Touch::default();
                let contact: Vec<f32> = force.iter().map(|f| f32::from(*f > 0.05)).collect();
                pooling.pool_into(&force, &contact, &mut touch).unwrap();
                input.touch = Some(touch);
            }
            let output = retargeter.push(&input).unwrap();
            let normal_force: Vec<f64> = output.expected_touch.links.iter().map(|link| link.normal_force).collect();
            let links: Vec<&str> = output.expected_touch.links.iter().map(|link| link.name.as_str()).collect();
            json!({
                "hand": hand, "force": force, "qpos": output.qpos, "links": links, "normal_force": normal_force,
                "net_force": output.expected_touch.net_force.to_array(),
                "object": input.object.map(|pose| (pose.position.to_array(), pose.orientation.to_array())),
            })
        })
        .collect();
    let robot = retargeter.robot();
    let masters: Vec<&str> =
        robot.coupling.masters.iter().map(|joint| robot.parts.joints[*joint].name.as_str()).collect();
    let rest = robot.rest_positions();
    // A pose within the limits that is not the rest pose.
    let pose: serde_json::Map<String, Value> = names
        .iter()
        .zip(&rest)
        .zip(&ranges)
        .map(|((name, at), [low, high])| (name.clone(), json!(at + 0.3 * (0.5 * (low + high) - at))))
        .collect();
    json!({
        "joints": names, "masters": masters, "rest": rest, "pose": pose, "ranges": ranges,
        "velocity": robot.spec.limits.velocity, "acceleration": ACCELERATION, "frames": frames,
    })
}

fn keypoints_json(keypoints: &[glam::DVec3; 21]) -> Value {
    json!(keypoints.map(|point| point.to_array()))
}

/// Returns frames of a hand that moves freely, as keypoints, with a growing force on its index fingertip.
fn moving(frames: usize) -> Value {
    let hands = Trajectory::generate(frames, 5).unwrap().keypoints;
    let regions = HandModel::builtin(Side::Right).regions();
    let pressed = |frame: usize| -> Vec<f32> {
        let size = 0.02 * frame as f32;
        regions.iter().map(|region| if *region == Region::IndexTip { size } else { 0.0 }).collect()
    };
    let frames = hands.iter().enumerate().map(|(frame, hand)| (keypoints_json(hand), *hand, pressed(frame)));
    case("four_finger", frames.collect())
}

/// Returns frames of a hand that closes, as MANO parameters.
fn closing(frames: usize, side: Side) -> Value {
    let model = HandModel::builtin(side);
    let frames = (0..frames).map(|frame| {
        let mut params = HandParams { transl: Vec3::new(0.1, -0.2, 0.4), ..HandParams::default() };
        // Bend the second and third joints of the index, middle and ring finger.
        let sign = if side == Side::Right { 1.0 } else { -1.0 };
        for joint in [1, 2, 4, 5, 10, 11] {
            params.hand_pose[joint] = Vec3::new(0.0, 0.0, sign * 0.02 * frame as f32);
        }
        let pose = HandPose::from_params(Header::default(), &model, &params);
        let (p, q) = (pose.wrist.position, pose.wrist.orientation);
        let hand = json!({
            "side": pose.side, "topology": pose.topology, "position": [p.x, p.y, p.z], "orientation": [q.x, q.y, q.z, q.w],
            "hand_pose": pose.hand_pose.to_vec(), "betas": pose.betas,
        });
        (hand, Hand::of_model(&model, &pose.to_params(&model).unwrap()), Vec::new())
    });
    case("four_finger", frames.collect())
}

#[test]
fn joints_and_forces_from_keypoints_agree_with_the_library() {
    assert_eq!(HandModel::builtin(Side::Right).v_template.len(), N_VERTICES);
    let printed = holds("keypoints", &moving(25), &["-p", "touch_wait_ms:=60000.0"]);
    assert!(printed.contains("four_finger") && printed.contains("follows the right hand"), "{printed}");
}

#[test]
fn poses_are_followed_and_those_of_the_other_hand_ignored() {
    holds("poses", &closing(12, Side::Right), &[]);
}

#[test]
fn one_hand_of_a_message_with_both_is_followed_if_its_confidence_is_high_enough() {
    holds("pairs_of_hands", &closing(12, Side::Right), &["-p", "min_confidence:=0.5"]);
}

#[test]
fn links_stay_out_of_an_object() {
    holds_about_a_ball("about");
}

#[test]
fn an_object_in_another_frame_is_carried_over_by_tf() {
    holds_about_a_ball("frames_of_object");
}

/// Runs one check of the peer on a hand that closes about a ball.
fn holds_about_a_ball(fact: &str) {
    let folder = tempfile::tempdir().unwrap();
    let ball = folder.path().join("ball.xml");
    std::fs::write(&ball, "<mujoco><worldbody><geom type=\"sphere\" size=\"0.02\"/></worldbody></mujoco>").unwrap();
    let shapes = Shapes::read(&ball).unwrap();
    let hands = Trajectory::generate(12, 5).unwrap().keypoints;
    // The object is at the index fingertip of the middle frame, in the frame of the wrist.
    let place = Hand::new(&hands[6], Side::Right).unwrap().points[keypoint(1, 3)];
    let frames = || hands.iter().map(|hand| (keypoints_json(hand), *hand, vec![0.0; 778])).collect::<Vec<_>>();
    let there = |keypoints: &[glam::DVec3; 21]| {
        let hand = Hand::new(keypoints, Side::Right).unwrap();
        let orientation = glam::DQuat::from_mat3(&hand.axes);
        Some(ObjectPose { position: hand.wrist + hand.axes * place, orientation })
    };
    let about = case_about(Robot::load_with_object("four_finger", None, Some(&shapes)).unwrap(), frames(), there);
    let alone = case("four_finger", frames());
    let last = |case: &Value| -> Vec<f64> { serde_json::from_value(case["frames"][11]["qpos"].clone()).unwrap() };
    let apart = last(&about).iter().zip(last(&alone)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(apart > 0.1, "{apart} rad: the ball is not in the way");
    holds(fact, &about, &["-p", &format!("object:={}", ball.display())]);
}

#[test]
fn joints_and_trajectories_are_published_at_a_fixed_rate() {
    holds("rate", &moving(3), &["-p", "rate_hz:=25.0"]);
}

#[test]
fn no_command_exceeds_the_joint_velocity_limits() {
    let mut jump = moving(2);
    // The second hand is far from the first.
    let far = Trajectory::generate(200, 5).unwrap().keypoints[60];
    jump["frames"][1]["hand"] = keypoints_json(&far);
    holds("velocity", &jump, &[]);
}

#[test]
fn touches_pair_within_the_slop_and_a_hand_waits_for_a_late_one() {
    holds("pairs", &moving(8), &["-p", "touch_wait_ms:=60000.0", "-p", "sync_slop_ms:=12.0"]);
}

#[test]
fn silence_and_malformed_messages_hold_the_last_pose() {
    let printed = holds("bad", &moving(12), &[]);
    for said in ["keypoint 8 (index tip)", "poses", "topology", "expected 0 (left) or 1 (right)"] {
        assert!(printed.contains(said), "{said}: {printed}");
    }
}

#[test]
fn the_first_command_starts_from_the_measured_joints_within_all_limits() {
    holds_with("starts", &far_hands(), &["-p", "publish_positions:=true"]);
}

#[test]
fn silence_brakes_and_holds_the_robot_and_the_next_hand_ramps_up() {
    let slow = ["-p", "start:=rest", "-p", "input_timeout_ms:=200.0", "-p", "ramp_secs:=30.0"];
    holds_with("pauses", &far_hands(), &slow);
}

#[test]
fn a_node_that_is_enabled_again_starts_from_the_measured_joints() {
    holds_with("reenabled", &far_hands(), &[]);
}

#[test]
fn the_robot_moves_only_while_the_deadman_switch_is_held() {
    holds_with("deadman", &far_hands(), &["-p", "start:=rest", "-p", "deadman:=true", "-p", "ramp_secs:=30.0"]);
}

#[test]
fn hands_of_a_best_effort_tracker_are_followed() {
    holds("best_effort", &moving(2), &[]);
}

#[test]
fn a_tracker_that_cannot_reach_the_node_is_an_error() {
    holds("unheard", &json!({}), &["-p", "reliability:=reliable"]);
    let session = Session::new();
    let namespace = session.namespace();
    let name = format!("qos_overrides.{namespace}/keypoints.subscription.reliability:=reliable");
    let path = session.path("case.json");
    std::fs::write(&path, "{}").unwrap();
    let mut node = node(&session, &["-p", &name, "-p", "qos_overrides./nothing.publisher.depth:=3"]);
    session.check(PEER, &["unheard", path.to_str().unwrap()]);
    node.ends_cleanly("INT");
    assert!(node.output().contains("qos_overrides./nothing.publisher.depth is ignored"), "{}", node.output());
}

#[test]
fn a_topic_without_a_publisher_is_named_once_with_those_of_its_type() {
    names_the_silent_topic("misnamed");
}

#[test]
fn topics_of_the_type_of_a_silent_topic_are_named_also_if_they_appear_later() {
    names_the_silent_topic("misnamed_later");
}

fn names_the_silent_topic(case: &str) {
    let session = Session::new();
    let path = session.path("case.json");
    std::fs::write(&path, "{}").unwrap();
    // The peer is there first.
    let mut peer = session.peer(PEER, &[case, path.to_str().unwrap()]);
    peer.prints("publishing");
    let mut node = node(&session, &AT_ONCE);
    let status = peer.wait();
    assert!(status.success(), "{status}\n{}", peer.output());
    node.ends_cleanly("INT");
}

#[test]
fn an_override_of_quality_of_service_that_is_not_allowed_ends_the_node() {
    let session = Session::new();
    let mut node = node(&session, &["-p", "qos_overrides./keypoints.subscription.reliability:=sure"]);
    assert_eq!(node.wait().code(), Some(1));
    assert!(node.output().contains("reliable, best_effort"), "{}", node.output());
}

/// Returns two hands that are far from the rest pose and from each other.
fn far_hands() -> Value {
    let hands = Trajectory::generate(200, 5).unwrap().keypoints;
    let frames = [60, 5].map(|frame| (keypoints_json(&hands[frame]), hands[frame], Vec::new()));
    case("four_finger", frames.into())
}

#[test]
fn set_enabled_stops_and_resumes_commands() {
    holds("switched", &moving(3), &[]);
}

#[test]
fn tracking_restarts_when_stamps_go_back() {
    holds("restarts", &moving(10), &[]);
}

#[test]
fn diagnostics_count_hands_by_outcome() {
    holds("diagnostics", &moving(6), &[]);
}

#[test]
fn an_unknown_robot_ends_the_node_with_the_list_of_known_ones() {
    let session = Session::new();
    let mut node = node(&session, &["-p", "robot:=five_finger"]);
    assert_eq!(node.wait().code(), Some(1));
    let said = node.output();
    assert!(said.contains("parameter robot") && said.contains("four_finger") && said.contains("gripper"), "{said}");
}

#[test]
fn a_mano_hand_needs_the_mano_file() {
    let mut case = closing(2, Side::Right);
    case["frames"][0]["hand"]["topology"] = json!("mano");
    let printed = holds("mano", &case, &[]);
    assert!(printed.contains("mano_right"), "{printed}");
}

#[test]
fn retargeter_follows_the_simulated_hand_and_the_predicted_touch() {
    let session = Session::new();
    let model = format!("model:={}", session.checkpoint(&egotac::model::Config::toy()).display());
    let predictor = ["-p", &model, "-p", "reliability:=reliable", "-r", "image:=image_raw"];
    let mut predictor = session.node(env!("CARGO_BIN_EXE_egotac_predictor"), &predictor);
    predictor.prints("images from");
    let remapped = ["-r", "hand_pose:=truth/hand_pose", "-r", "tactile:=predictor/tactile"];
    // Hands wait for touch as long as a busy machine needs for it.
    let mut retargeter = node(&session, &[&AT_ONCE[..], &remapped, &["-p", "touch_wait_ms:=60000.0"]].concat());
    let seen: PathBuf = session.path("case.json");
    std::fs::write(&seen, "{}").unwrap();
    let mut peer = session.peer(PEER, &["pipeline", seen.to_str().unwrap()]);
    peer.prints("listening");
    let scene = ["-p", "scenes:=[lift_mug]", "-p", "wait_secs:=60.0", "-p", "width:=64", "-p", "height:=64"];
    let mut simulator = session.node(env!("CARGO_BIN_EXE_egotac_simulator"), &scene);
    let status = peer.wait();
    assert!(status.success(), "{status}\n{}", peer.output());
    simulator.ends_cleanly("INT");
    retargeter.ends_cleanly("TERM");
    predictor.ends_cleanly("INT");
}
