//! A robot hand with an object: links stay out of it, touching fingertips lie on it, in any pose of the world.

#[allow(dead_code)]
use std::path::PathBuf;

use crate::trajectory::Trajectory;
use egotac::hand::Side;
use egotac::mujoco::object::Shapes;
use egotac::retarget::human::{Hand, keypoint};
use egotac::retarget::{Input, ObjectPose, Retargeter, Robot, Touch};
use glam::{DMat3, DQuat, DVec3};
use proptest::prelude::*;

const DT: f64 = 1.0 / 30.0;
/// Radius of the ball, m.
const RADIUS: f64 = 0.018;

fn shapes(name: &str, text: &str) -> Shapes {
    let folder = tempfile::tempdir().unwrap();
    let path: PathBuf = folder.path().join(name);
    std::fs::write(&path, text).unwrap();
    Shapes::read(&path).unwrap()
}

fn ball() -> Shapes {
    let text = format!("<mujoco><worldbody><geom type=\"sphere\" size=\"{RADIUS}\"/></worldbody></mujoco>");
    shapes("ball.xml", &text)
}

fn retargeter(name: &str, object: Option<&Shapes>) -> Retargeter {
    Retargeter::new(Robot::load_with_object(name, None, object).unwrap()).unwrap()
}

/// A frame of the hand, with an object at a position in its wrist frame.
fn input(hands: &Trajectory, frame: usize, place: Option<DVec3>) -> Input {
    let mut input = Input::new(hands.keypoints[frame], frame as f64 * DT);
    let tip_contact = hands.tip_contact[frame];
    input.touch = Some(Touch { tip_contact, tip_force: Some(hands.tip_force[frame]), segments: None });
    input.object = place.map(|place| {
        let hand = Hand::new(&hands.keypoints[frame], Side::Right).unwrap();
        ObjectPose { position: hand.wrist + hand.axes * place, orientation: DQuat::from_mat3(&hand.axes) }
    });
    input
}

/// Middle of thumb and fingertip when they first touch, in the wrist frame.
fn meeting(hands: &Trajectory) -> DVec3 {
    let frame = hands.tip_contact.iter().position(|contact| contact[0] > 0.5).unwrap();
    let finger = (1..5).find(|finger| hands.tip_contact[frame][*finger] > 0.5).unwrap();
    let points = Hand::new(&hands.keypoints[frame], Side::Right).unwrap().points;
    0.5 * (points[keypoint(0, 3)] + points[keypoint(finger, 3)])
}

/// Penetration of the robot into its object, m.
fn depth(robot: &mut Robot) -> f64 {
    let pairs = robot.object_pairs();
    pairs.into_iter().map(|pair| -robot.world.geom_distance(pair, 0.05).0).fold(f64::NEG_INFINITY, f64::max)
}

#[test]
fn links_stay_out_of_the_object_and_touching_fingertips_lie_on_it() {
    let hands = Trajectory::generate(480, 3).unwrap();
    let place = meeting(&hands);
    for name in ["four_finger", "tendon_hand"] {
        let mut with = retargeter(name, Some(&ball()));
        // A control: the same robot beside the same ball, without the ball's pose.
        let mut blind = retargeter(name, Some(&ball()));
        let (mut deepest, mut deepest_blind) = (f64::NEG_INFINITY, f64::NEG_INFINITY);
        let (mut held, mut on) = (0, 0);
        for frame in 0..hands.keypoints.len() {
            with.push(&input(&hands, frame, Some(place))).unwrap();
            let (robot, goal) = with.robot_and_goal_mut();
            deepest = deepest.max(depth(robot));
            let there = robot.world.body_pose(robot.object.as_ref().unwrap().body);
            // Held for half a second: joints need time to get there.
            let contact = hands.tip_contact[frame];
            let before = hands.tip_contact[frame.saturating_sub(15)];
            for (index, finger) in (0..robot.fingers.len()).map(|k| (k, robot.fingers[k].human)).collect::<Vec<_>>() {
                let is_first = frame < 120;
                if is_first && contact[finger] > 0.5 && before[finger] > 0.5 {
                    held += 1;
                    on += usize::from(goal.gap_to_object(robot, index).unwrap().abs() < 1e-3);
                }
            }
            blind.push(&input(&hands, frame, None)).unwrap();
            let (robot, _) = blind.robot_and_goal_mut();
            robot.place_object(Some((there.0, DQuat::from_mat3(&there.1))));
            robot.world.update_poses();
            deepest_blind = deepest_blind.max(depth(robot));
            robot.place_object(None);
        }
        assert!(deepest < 5e-4, "{name}: {deepest} m deep");
        assert!(deepest_blind > 5e-3, "{name}: {deepest_blind} m without the object: no test of anything");
        assert!(held > 10 && on == held, "{name}: {on} of {held} on the object");
    }
}

#[test]
fn an_object_out_of_reach_changes_nothing() {
    let hands = Trajectory::generate(90, 4).unwrap();
    let mut alone = retargeter("four_finger", None);
    let mut beside = retargeter("four_finger", Some(&ball()));
    for frame in 0..hands.keypoints.len() {
        let far = Some(DVec3::new(0.8, 0.0, 0.0)).filter(|_| frame % 7 != 3);
        alone.push(&input(&hands, frame, None)).unwrap();
        beside.push(&input(&hands, frame, far)).unwrap();
        assert_eq!(alone.output().qpos, beside.output().qpos, "frame {frame}");
        assert_eq!(alone.output().expected_touch, beside.output().expected_touch, "frame {frame}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_common_motion_of_hand_and_object_makes_no_difference(axis in prop::array::uniform3(-1.0f64..1.0), angle in 0.0f64..6.2, shift in -3.0f64..3.0) {
        let hands = Trajectory::generate(45, 3).unwrap();
        let place = meeting(&Trajectory::generate(90, 3).unwrap());
        let turn = DQuat::from_axis_angle(DVec3::from_array(axis).try_normalize().unwrap_or(DVec3::X), angle);
        let to = |point: DVec3| turn * point + DVec3::new(shift, -shift, 0.3);
        let (mut here, mut there) = (retargeter("four_finger", Some(&ball())), retargeter("four_finger", Some(&ball())));
        for frame in 0..hands.keypoints.len() {
            let given = input(&hands, frame, Some(place));
            let mut moved = given.clone();
            moved.keypoints = given.keypoints.map(to);
            moved.object = given.object.map(|pose| ObjectPose { position: to(pose.position), orientation: turn * pose.orientation });
            moved.touch = None;
            let mut given = given;
            given.touch = None;
            here.push(&given).unwrap();
            there.push(&moved).unwrap();
            let apart = here.output().qpos.iter().zip(&there.output().qpos).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            prop_assert!(apart < 1e-6, "frame {}: {} rad", frame, apart);
        }
    }
}

#[test]
fn a_mesh_and_an_equal_model_are_at_the_same_distance() {
    let half = [0.02, 0.03, 0.01];
    let corner = |k: usize, axis: usize| if k >> axis & 1 == 1 { half[axis] } else { -half[axis] };
    let mut obj = String::new();
    for k in 0..8 {
        obj += &format!("v {} {} {}\n", corner(k, 0) + 0.1, corner(k, 1), corner(k, 2) - 0.05);
    }
    for [a, b, c] in [
        [1, 3, 2],
        [2, 3, 4],
        [5, 6, 7],
        [6, 8, 7],
        [1, 2, 5],
        [2, 6, 5],
        [3, 7, 4],
        [4, 7, 8],
        [1, 5, 3],
        [3, 5, 7],
        [2, 4, 6],
        [4, 8, 6],
    ] {
        obj += &format!("f {a} {b} {c}\n");
    }
    let mjcf = "<mujoco><worldbody><body pos=\"0.1 0 0\"><freejoint/><geom type=\"box\" size=\"0.02 0.03 0.01\" pos=\"0 0 -0.05\"/>\
                <geom type=\"sphere\" size=\"0.3\" contype=\"0\" conaffinity=\"0\"/></body></worldbody></mujoco>";
    let mut robots = [shapes("a.obj", &obj), shapes("a.xml", mjcf)]
        .map(|object| Robot::load_with_object("four_finger", None, Some(&object)).unwrap());
    for step in 0..30 {
        let angle = 0.3 * step as f64;
        let place = DVec3::new(0.15 * angle.sin(), 0.1 * angle.cos(), 0.1 + 0.02 * step as f64 % 0.2);
        let [mesh, model] = robots.each_mut().map(|robot| {
            robot.place_object(Some((place, DQuat::from_rotation_x(angle) * DQuat::from_rotation_y(0.7 * angle))));
            robot.world.update_poses();
            depth(robot)
        });
        assert!((mesh - model).abs() < 1e-5, "step {step}: {mesh} for {model}");
    }
}

#[test]
fn an_invalid_object_pose_is_refused_and_the_last_pose_held() {
    let hands = Trajectory::generate(30, 3).unwrap();
    let place = DVec3::new(0.05, 0.0, 0.1);
    let mut beside = retargeter("four_finger", Some(&ball()));
    beside.push(&input(&hands, 0, Some(place))).unwrap();
    let held = beside.output().qpos.clone();
    let good = input(&hands, 1, Some(place));
    let pose = good.object.unwrap();
    for (bad, said) in [
        (ObjectPose { position: DVec3::NAN, ..pose }, "finite metres"),
        (ObjectPose { orientation: DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), ..pose }, "length 1"),
        (ObjectPose { orientation: pose.orientation * 1.1, ..pose }, "length 1"),
    ] {
        let error = beside.push(&Input { object: Some(bad), ..good.clone() }).unwrap_err().to_string();
        assert!(error.contains("object_pose") && error.contains(said), "{error}");
        assert_eq!(beside.output().qpos, held);
    }
    beside.push(&good).unwrap();
    let error = retargeter("four_finger", None).push(&good).unwrap_err().to_string();
    assert!(error.contains("loaded with an object"), "{error}");
    let left = Trajectory {
        keypoints: hands.keypoints.iter().map(|hand| hand.map(|p| DVec3::new(-p.x, p.y, p.z))).collect(),
        ..hands
    };
    let options = egotac::retarget::Options { side: Some(Side::Left), ..Default::default() };
    let robot = Robot::load_with_object("four_finger", None, Some(&ball())).unwrap();
    let mut other = Retargeter::with_options(robot, options).unwrap();
    let mut mirrored = Input::new(left.keypoints[0], 0.0);
    mirrored.object = Some(ObjectPose { position: DVec3::ZERO, orientation: DQuat::from_mat3(&DMat3::IDENTITY) });
    let error = other.push(&mirrored).unwrap_err().to_string();
    assert!(error.contains("a right hand") && error.contains("a left hand"), "{error}");
}

#[test]
fn files_that_are_not_an_object_are_reported_by_name() {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in [
        ("a.txt", "ball"),
        ("b.xml", "<mujoco><worldbody/></mujoco>"),
        ("c.xml", "<mujoco><worldbody><geom type=\"plane\" size=\"1 1 1\"/></worldbody></mujoco>"),
        ("d.obj", "v 0 0 0\n"),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        let error = Shapes::read(&path).unwrap_err().to_string();
        assert!(error.contains(name), "{error}");
    }
    assert!(Shapes::read(&folder.path().join("absent.stl")).unwrap_err().to_string().contains("absent.stl"));
}
