//! Following a hand: limits and couplings, bad input, independence of the past, mirror images.

#[allow(dead_code)]
use std::sync::LazyLock;

use crate::trajectory::{Noise, Trajectory};
use egotac::mujoco::{PhysicsOptions, World};
use egotac::retarget::robot::spec::RobotSpec;
use egotac::retarget::{Input, Retargeter, Robot, Status};
use glam::{DQuat, DVec3};
use proptest::prelude::*;

const DT: f64 = 1.0 / 30.0;
const OWN: [&str; 3] = ["four_finger", "tendon_hand", "gripper"];

fn retargeter(name: &str) -> Retargeter {
    Retargeter::new(Robot::load(name, None).unwrap()).unwrap()
}

fn robot_of(yaml: &str, mjcf: &str) -> egotac::Result<Robot> {
    let world = World::from_mjcf(mjcf, &PhysicsOptions::default()).unwrap();
    Robot::new(RobotSpec::parse(yaml).unwrap(), world, "a test".into(), Vec::new())
}

fn hands(frames: usize) -> Trajectory {
    static MADE: LazyLock<Trajectory> = LazyLock::new(|| Trajectory::generate(480, 3).unwrap());
    let mut some = MADE.clone();
    some.keypoints.truncate(frames);
    some.tip_contact.truncate(frames);
    some.tip_force.truncate(frames);
    some
}

/// Largest difference of two poses, rad.
fn apart(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Holds a pose until nothing moves.
fn settle(retargeter: &mut Retargeter, keypoints: [DVec3; 21], time: &mut f64) -> Vec<f64> {
    for _ in 0..60 {
        *time += DT;
        retargeter.push(&Input::new(keypoints, *time)).unwrap();
    }
    retargeter.output().qpos.clone()
}

#[test]
fn limits_speeds_and_couplings_hold_for_any_input() {
    let noisy = hands(240).with(Noise::White(0.03), 1);
    for name in OWN {
        let mut retargeter = retargeter(name);
        let mut last: Option<Vec<f64>> = None;
        for (frame, keypoints) in noisy.keypoints.iter().enumerate() {
            // Some frames are refused; the pose held for them must keep the limits as well.
            let _ = retargeter.push(&Input::new(*keypoints, frame as f64 * DT));
            let output = retargeter.output().clone();
            let robot = retargeter.robot();
            assert!(robot.coupling.violation(&robot.parts, robot.world.qpos()) < 1e-9, "{name}, frame {frame}");
            for (joint, position) in robot.output_joints().zip(&output.qpos) {
                let [low, high] = robot.parts.joints[joint].range;
                assert!((low..=high).contains(position), "{name}, {}", robot.parts.joints[joint].name);
            }
            if let Some(last) = last {
                let most = robot.spec.limits.velocity * DT;
                assert!(apart(&last, &output.qpos) <= most + 1e-9, "{name}, frame {frame}");
            }
            last = Some(output.qpos);
        }
    }
}

#[test]
fn no_link_penetrates_another_for_any_input() {
    let inputs = [Noise::White(0.005), Noise::White(0.02), Noise::Spikes];
    for (seed, noise) in (0..).zip(inputs) {
        let hands = hands(480).with(noise, seed);
        for name in OWN {
            let mut retargeter = retargeter(name);
            // Every fifth frame is from another time, which no joint is fast enough for.
            for frame in 0..hands.keypoints.len() {
                let of = if frame % 5 == 4 { (frame * 37) % hands.keypoints.len() } else { frame };
                let _ = retargeter.push(&Input::new(hands.keypoints[of], frame as f64 * DT));
                let (robot, goal) = retargeter.robot_and_goal_mut();
                let deepest = goal.deepest(robot);
                assert!(deepest <= 5e-4, "{name}, {noise:?}, frame {frame}: {deepest} m deep");
            }
        }
    }
}

#[test]
fn advance_moves_within_the_speed_limit_and_then_stays() {
    let hands = hands(80).keypoints;
    for name in OWN {
        let (mut often, mut once) = (retargeter(name), retargeter(name));
        for retargeter in [&mut often, &mut once] {
            retargeter.push(&Input::new(hands[0], 0.0)).unwrap();
        }
        // A jump, far enough that no joint gets there at once; `once` has a second for it.
        let late = Input::new(hands[60], 10.0);
        let there = once.push_at(&late, 1.0).unwrap().qpos.clone();
        let mut last = often.output().qpos.clone();
        let most = often.robot().spec.limits.velocity * 0.01;
        let mut now = 0.01;
        often.push_at(&late, now).unwrap();
        for _ in 0..100 {
            assert!(apart(&last, &often.output().qpos) <= most + 1e-9, "{name} at {now} s");
            last = often.output().qpos.clone();
            now += 0.01;
            often.advance(now).unwrap();
        }
        assert!(apart(&last, &there) < 1e-3, "{name}: {last:?} {there:?}");
        assert_eq!(often.output().qpos, last, "{name} stays");
        assert!(often.advance(f64::NAN).is_err());
        // A time in the past moves nothing, and later times still work.
        often.advance(0.0).unwrap();
        assert_eq!(often.output().qpos, last);
        often.reset();
        often.push_at(&Input::new(hands[0], 0.0), 0.0).unwrap();
        assert!(apart(&last, &often.output().qpos) > 0.0, "{name} moves after a reset");
    }
}

#[test]
fn a_bad_frame_is_reported_held_and_forgotten_within_three_frames() {
    let good = hands(80).keypoints;
    type Spoil = fn(&mut [DVec3; 21]);
    let cases: [(&str, &str, Spoil); 7] = [
        ("NaN", "keypoint 8 (index tip)", |k| k[8].y = f64::NAN),
        ("infinite", "keypoint 20 (little tip)", |k| k[20].x = f64::INFINITY),
        ("all zero", "keypoints 0 (wrist)", |k| *k = [DVec3::ZERO; 21]),
        ("far away", "keypoint 12", |k| k[12].z += 1e9),
        ("a finger far away", "keypoint 4 (thumb tip)", |k| k[4].z += 10.0),
        ("on a line", "keypoints 5", |k| (0..21).for_each(|i| k[i] = DVec3::X * 0.01 * i as f64)),
        ("mirrored", "keypoints", |k| k.iter_mut().for_each(|p| p.x = -p.x)),
    ];
    for name in ["four_finger", "tendon_hand"] {
        for (what, says, spoil) in cases {
            let (mut spoilt, mut clean) = (retargeter(name), retargeter(name));
            for (frame, keypoints) in good.iter().enumerate() {
                let time = frame as f64 * DT;
                clean.push(&Input::new(*keypoints, time)).unwrap();
                let mut keypoints = *keypoints;
                if frame == 60 {
                    let before = spoilt.output().qpos.clone();
                    spoil(&mut keypoints);
                    let error = spoilt.push(&Input::new(keypoints, time)).unwrap_err().to_string();
                    assert!(error.contains(says), "{name}, {what}: {error}");
                    assert_eq!((spoilt.output().status, &spoilt.output().qpos), (Status::Held, &before), "{what}");
                    continue;
                }
                spoilt.push(&Input::new(keypoints, time)).unwrap();
                let output = spoilt.output();
                assert!(output.qpos.iter().chain(&output.ctrl).all(|x| x.is_finite()), "{what}");
                if frame >= 63 {
                    let off = apart(&output.qpos, &clean.output().qpos);
                    assert!(off < 0.02, "{name}, {what}: {off} rad off at frame {frame}");
                }
            }
        }
    }
}

#[test]
fn a_spike_moves_the_robot_less_than_the_hand() {
    let good = hands(80).keypoints;
    let (mut spoilt, mut clean) = (retargeter("four_finger"), retargeter("four_finger"));
    for (frame, keypoints) in good.iter().enumerate() {
        clean.push(&Input::new(*keypoints, frame as f64 * DT)).unwrap();
        let mut keypoints = *keypoints;
        if frame == 60 {
            keypoints[8] += DVec3::new(0.0, 0.1, 0.0);
        }
        spoilt.push(&Input::new(keypoints, frame as f64 * DT)).unwrap();
        if frame == 60 {
            assert_eq!(spoilt.output().status, Status::Repaired);
        }
        assert!(apart(&spoilt.output().qpos, &clean.output().qpos) < 0.05, "frame {frame}");
    }
}

#[test]
fn the_same_pose_by_two_paths_ends_in_the_same_joints() {
    let trajectory = hands(400).keypoints;
    for name in OWN {
        let (mut a, mut b) = (retargeter(name), retargeter(name));
        let (mut time_a, mut time_b) = (0.0, 0.0);
        for keypoints in &trajectory[..120] {
            time_a += DT;
            a.push(&Input::new(*keypoints, time_a)).unwrap();
        }
        for keypoints in trajectory[200..380].iter().rev() {
            time_b += DT;
            b.push(&Input::new(*keypoints, time_b)).unwrap();
        }
        for target in [0, 90, 150, 300] {
            let a = settle(&mut a, trajectory[target], &mut time_a);
            let b = settle(&mut b, trajectory[target], &mut time_b);
            assert!(apart(&a, &b) < 0.02, "{name}, pose {target}: {} rad", apart(&a, &b));
        }
    }
}

#[test]
fn an_old_frame_is_refused_and_a_gap_is_not() {
    let good = hands(3).keypoints;
    let mut retargeter = retargeter("four_finger");
    retargeter.push(&Input::new(good[0], 1.0)).unwrap();
    for time in [1.0, 0.5, f64::NAN] {
        let error = retargeter.push(&Input::new(good[1], time)).unwrap_err().to_string();
        assert!(error.contains("timestamp"), "{error}");
    }
    retargeter.push(&Input::new(good[1], 3.0)).unwrap();
    assert_eq!(retargeter.output().qpos.len(), 16);
}

/// Robot hand as MJCF; `mirrored_hand` fills in the fingers.
const HAND: &str = r#"<mujoco><compiler angle="radian"/><worldbody><body name="palm"><geom type="box" size=".01 .04 .04" pos="0 0 .05"/>
    INDEX MIDDLE RING THUMB</body></worldbody></mujoco>"#;

fn mirrored_hand(sign: f64) -> String {
    let finger = |name: &str, y: f64| {
        format!(
            r#"<body name="{name}_proximal" pos="0 {y} .09">
            <joint name="{name}_spread" axis="{sign} 0 0" range="-.4 .4"/><joint name="{name}_mcp" axis="0 1 0" range="-.2 1.6"/>
            <geom type="capsule" size=".008" fromto="0 0 .01 0 0 .04"/><body name="{name}_distal" pos="0 0 .045">
            <joint name="{name}_pip" axis="0 1 0" range="0 1.6"/><geom type="capsule" size=".008" fromto="0 0 .005 0 0 .03"/>
            <site name="{name}_tip" pos="0 0 .038"/></body></body>"#,
            y = sign * y
        )
    };
    let thumb = format!(
        r#"<body name="thumb_proximal" pos=".01 {y} .03"><joint name="thumb_turn" axis="0 0 {sign}" range="-1.5 .3"/>
        <joint name="thumb_mcp" axis="{sign} 0 0" range="-.3 1.5"/><geom type="capsule" size=".009" fromto="0 0 0 0 {end} .02"/>
        <body name="thumb_distal" pos="0 {next} .03"><joint name="thumb_ip" axis="{sign} 0 0" range="0 1.5"/>
        <geom type="capsule" size=".009" fromto="0 0 0 0 {end} .015"/><site name="thumb_tip" pos="0 {next} .025"/></body></body>"#,
        y = sign * 0.04,
        end = sign * 0.02,
        next = sign * 0.03,
    );
    HAND.replace("INDEX", &finger("index", 0.03))
        .replace("MIDDLE", &finger("middle", 0.0))
        .replace("RING", &finger("ring", -0.03))
        .replace("THUMB", &thumb)
}

#[test]
fn a_mirrored_hand_on_the_mirrored_robot_gives_the_same_joints() {
    let robot = |sign| robot_of("robot: test", &mirrored_hand(sign)).unwrap();
    let (mut right, mut left) = (Retargeter::new(robot(1.0)).unwrap(), Retargeter::new(robot(-1.0)).unwrap());
    assert_ne!(right.robot().side(), left.robot().side());
    for (frame, keypoints) in hands(200).keypoints.iter().enumerate() {
        let mirrored = keypoints.map(|point| DVec3::new(point.x, -point.y, point.z));
        right.push(&Input::new(*keypoints, frame as f64 * DT)).unwrap();
        left.push(&Input::new(mirrored, frame as f64 * DT)).unwrap();
        let off = apart(&right.output().qpos, &left.output().qpos);
        assert!(off < 1e-6, "frame {frame}: {off} rad");
    }
}

#[test]
fn robots_of_one_joint_a_locked_joint_or_no_range_are_followed() {
    let chain = |joints: &str| {
        format!(
            r#"<mujoco><compiler angle="radian"/><worldbody><body name="palm"><geom type="box" size=".02 .02 .02"/><body name="index_proximal" pos="0 0 .03">
            {joints}<geom type="capsule" size=".008" fromto="0 0 .01 0 0 .05"/><site name="index_tip" pos="0 0 .06"/></body></body>
            </worldbody></mujoco>"#
        )
    };
    let frame = "wrist: { frame: [[1, 0, 0], [0, 1, 0], [0, 0, 1]] }";
    for (yaml, joints) in [
        (format!("robot: one\n{frame}"), r#"<joint name="bend" axis="0 1 0" range="0 1.5"/>"#),
        (format!("robot: none\n{frame}"), r#"<joint name="bend" axis="0 1 0" range="0.3 0.3001"/>"#),
        (
            format!("robot: locked\n{frame}\nfixed_joints: {{ spread: 0.1 }}"),
            r#"<joint name="spread" axis="1 0 0" range="-.3 .3"/><joint name="bend" axis="0 1 0" range="0 1.5"/>"#,
        ),
    ] {
        let mut retargeter = Retargeter::new(robot_of(&yaml, &chain(joints)).unwrap()).unwrap();
        for (frame, keypoints) in hands(30).keypoints.iter().enumerate() {
            retargeter.push(&Input::new(*keypoints, frame as f64 * DT)).unwrap();
            assert!(retargeter.output().qpos.iter().all(|x| x.is_finite()), "{yaml}");
        }
        if yaml.contains("locked") {
            assert_eq!(retargeter.output().qpos[0], 0.1);
        }
    }
    let error =
        robot_of("robot: x\nfixed_joints: { bend: 0 }", &chain(r#"<joint name="bend" axis="0 1 0" range="0 1"/>"#));
    assert!(error.is_err());
}

#[test]
fn fingertips_touch_if_the_humans_do_and_stay_apart_otherwise() {
    let trajectory = hands(480);
    let mut retargeter = retargeter("four_finger");
    let (mut touching, mut closed) = (0, 0);
    for frame in 0..trajectory.keypoints.len() {
        let mut input = Input::new(trajectory.keypoints[frame], frame as f64 * DT);
        let contact = trajectory.tip_contact[frame];
        input.touch = Some(egotac::retarget::Touch { tip_contact: contact, ..Default::default() });
        retargeter.push(&input).unwrap();
        let (robot, goal) = retargeter.robot_and_goal_mut();
        for finger in 0..robot.fingers.len() {
            let Some(gap) = goal.gap_to_thumb(robot, finger) else { continue };
            match contact[0] > 0.5 && contact[robot.fingers[finger].human] > 0.5 {
                true => {
                    touching += 1;
                    closed += usize::from(gap.abs() < 1e-3);
                }
                false => assert!(gap > 1e-3, "frame {frame}, finger {finger}: {gap} m though nothing touches"),
            }
        }
    }
    assert!(touching > 50 && closed * 100 >= touching * 99, "{closed} of {touching}");
}

#[test]
fn smoothing_is_the_same_at_any_frame_rate() {
    use egotac::retarget::filter::Smoother;
    // A ramp comes out late by exactly the delay.
    for rate in [15.0, 30.0, 60.0, 120.0] {
        let (mut smoother, mut out) = (Smoother::new(0.045), 0.0);
        for frame in 0..(3.0 * rate) as usize {
            let at = frame as f64 / rate;
            out = smoother.push(&[DVec3::X * at; 21], 1.0 / rate)[7].x;
        }
        let late = ((3.0 * rate) as usize - 1) as f64 / rate - out;
        assert!((late - 0.045).abs() < 0.05 * 0.045, "{rate} Hz: {late} s");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn the_pose_of_the_wrist_makes_no_difference(
        x in -5.0f64..5.0, y in -5.0f64..5.0, angle in 0.0f64..std::f64::consts::TAU, a in -1.0f64..1.0, b in -1.0f64..1.0, frame in 0usize..200,
    ) {
        let keypoints = hands(200).keypoints[frame];
        let turn = DQuat::from_axis_angle(DVec3::new(a, b, 0.3).normalize(), angle);
        let moved = keypoints.map(|point| turn * point + DVec3::new(x, y, 1.0));
        let (mut still, mut other) = (retargeter("four_finger"), retargeter("four_finger"));
        still.push(&Input::new(keypoints, 0.0)).unwrap();
        other.push(&Input::new(moved, 0.0)).unwrap();
        prop_assert!(apart(&still.output().qpos, &other.output().qpos) < 1e-6);
    }

    #[test]
    fn a_hand_of_another_size_bends_the_robot_the_same(size in 0.5f64..1.6, frame in 0usize..200) {
        let keypoints = hands(200).keypoints[frame];
        let scaled = keypoints.map(|point| size * point);
        let (mut a, mut b) = (retargeter("four_finger"), retargeter("four_finger"));
        // Without pinches, whose gap does not scale with the hand.
        a.robot_and_goal_mut().0.spec.weights.pinch = 0.0;
        b.robot_and_goal_mut().0.spec.weights.pinch = 0.0;
        a.push(&Input::new(keypoints, 0.0)).unwrap();
        b.push(&Input::new(scaled, 0.0)).unwrap();
        prop_assert!(apart(&a.output().qpos, &b.output().qpos) < 2e-3);
    }
}
