//! Motion of a live robot: starts from a measured pose, limits in every command, room to brake.

use std::sync::LazyLock;

use crate::trajectory::Trajectory;
use egotac::retarget::{Input, LiveOptions, Options, Output, Retargeter, Robot};
use glam::DVec3;
use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const PERIOD: f64 = 1.0 / 60.0;
const LIVE: LiveOptions = LiveOptions { acceleration: 50.0, ramp_secs: 1.0, period: PERIOD };
/// Greatest penetration that a command may have, m.
const MAX_PENETRATION: f64 = 5e-4;

fn live(name: &str, live: LiveOptions) -> Retargeter {
    let options = Options { live: Some(live), ..Options::default() };
    Retargeter::with_options(Robot::load(name, None).unwrap(), options).unwrap()
}

static HANDS: LazyLock<Vec<[DVec3; 21]>> = LazyLock::new(|| Trajectory::generate(480, 3).unwrap().keypoints);

/// Returns positions of all joints of a random pose, and how deep its links are in each other, m.
fn random_pose(retargeter: &mut Retargeter, rng: &mut impl Rng) -> (Vec<f64>, f64) {
    let (robot, _) = retargeter.robot_and_goal_mut();
    let u: Vec<f64> =
        robot.coupling.low.iter().zip(&robot.coupling.high).map(|(low, high)| rng.random_range(*low..=*high)).collect();
    let mut all = robot.world.qpos().to_vec();
    robot.coupling.expand(&robot.parts, &u, &mut all);
    let qpos: Vec<f64> = robot.output_joints().map(|joint| all[robot.parts.joints[joint].qpos]).collect();
    retargeter.start_from(&qpos).unwrap();
    (qpos, depth(retargeter))
}

/// Greatest penetration of links in the present pose, m.
fn depth(retargeter: &mut Retargeter) -> f64 {
    let (robot, goal) = retargeter.robot_and_goal_mut();
    goal.deepest(robot)
}

/// Checks the command `after`, which follows `before` by `dt` seconds, against the limits of the robot.
fn keeps_limits(robot: &Robot, before: &Output, after: &Output, dt: f64) -> std::result::Result<(), String> {
    for (index, joint) in robot.output_joints().enumerate() {
        let part = &robot.parts.joints[joint];
        let share = if part.motion == egotac::mujoco::parts::Motion::Slide { 0.1 } else { 1.0 };
        let (speed, acceleration) = (share * robot.spec.limits.velocity, share * LIVE.acceleration);
        let fail = |what: &str, got: f64, most: f64| Err(format!("{}: {what} {got}, most {most}", part.name));
        let [low, high] = part.range;
        for position in [after.qpos[index], after.stop_qpos[index]] {
            if !(low..=high).contains(&position) {
                return fail("position", position, high);
            }
        }
        let moved = (after.qpos[index] - before.qpos[index]).abs();
        if moved > speed * dt + 1e-9 {
            return fail("step", moved / dt, speed);
        }
        if after.qvel[index].abs() > speed * (1.0 + 1e-9) {
            return fail("velocity", after.qvel[index], speed);
        }
        let change = (after.qvel[index] - before.qvel[index]).abs() / dt;
        if change > acceleration * (1.0 + 1e-6) || after.qacc[index].abs() > acceleration * (1.0 + 1e-6) {
            return fail("acceleration", change.max(after.qacc[index].abs()), acceleration);
        }
        // A motion with bounded acceleration covers the mean of both velocities, to within a dt^2 / 4.
        let mean = 0.5 * (before.qvel[index] + after.qvel[index]) * dt;
        let off = (after.qpos[index] - before.qpos[index] - mean).abs();
        if off > 0.25 * acceleration * dt * dt + 1e-9 {
            return fail("position off its velocities", off, 0.25 * acceleration * dt * dt);
        }
        let stopping = (after.stop_qpos[index] - after.qpos[index]).abs();
        if stopping > 0.5 * after.qvel[index].abs() * after.stop_secs + 1e-9 {
            return fail("way to stop", stopping, 0.5 * after.qvel[index].abs() * after.stop_secs);
        }
    }
    Ok(())
}

#[test]
fn the_first_command_of_a_live_robot_is_within_a_step_of_the_measured_pose() {
    let fist = HANDS[60];
    let input = Input::new(fist, 0.0);
    let mut offline = Retargeter::new(Robot::load("four_finger", None).unwrap()).unwrap();
    let rest = offline.output().qpos.clone();
    let most = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let jump = most(&rest, &offline.push(&input).unwrap().qpos);
    assert!(jump > 0.3, "{jump} rad: the hand of this test is no challenge");

    let mut live = live("four_finger", LIVE);
    let open: Vec<f64> = rest.iter().map(|position| position + 0.05).collect();
    let far = live.start_from(&open).unwrap();
    let start = live.output().qpos.clone();
    assert!(most(&start, &open) <= far);
    let first = live.push(&input).unwrap();
    assert!(most(&start, &first.qpos) <= 0.5 * LIVE.acceleration * PERIOD * PERIOD + 1e-12);
}

#[test]
fn no_command_exceeds_a_limit_from_ten_thousand_starts() {
    // (robot, starts, commands after each)
    for (name, starts, commands) in [("gripper", 8000, 10), ("tendon_hand", 1500, 8), ("four_finger", 500, 10)] {
        let mut retargeter = live(name, LIVE);
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        for start in 0..starts {
            let (measured, start_depth) = random_pose(&mut retargeter, &mut rng);
            assert!(measured.iter().zip(&retargeter.output().qpos).all(|(a, b)| (a - b).abs() < 1e-9));
            let mut now = 0.0;
            let mut before = retargeter.output().clone();
            for command in 0..commands {
                now += PERIOD;
                // A hand comes every second command, and jumps anywhere.
                if command % 2 == 0 {
                    let hand = HANDS[rng.random_range(0..HANDS.len())];
                    let _ = retargeter.push_at(&Input::new(hand, now), now);
                } else {
                    retargeter.advance(now).unwrap();
                }
                let after = retargeter.output().clone();
                let kept = keeps_limits(retargeter.robot(), &before, &after, PERIOD);
                kept.unwrap_or_else(|broken| panic!("{name}, start {start}, command {command}: {broken}"));
                let depth = depth(&mut retargeter);
                let most = start_depth.max(MAX_PENETRATION) + 1e-6;
                assert!(depth <= most, "{name}, start {start}, command {command}: {depth} m, most {most}");
                before = after;
            }
        }
    }
}

#[test]
fn limits_hold_over_pauses_brakes_and_late_commands() {
    for name in ["four_finger", "tendon_hand", "gripper"] {
        let mut retargeter = live(name, LIVE);
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let (mut now, mut frame) = (0.0, 0);
        let mut before = retargeter.output().clone();
        let mut paused = 0;
        for command in 0..800 {
            // Clocks of control loops are uneven, and stall at times.
            let late = if rng.random_bool(0.02) { 40.0 } else { rng.random_range(0.5..1.5) };
            let dt = late * PERIOD;
            now += dt;
            if paused == 0 && rng.random_bool(0.01) {
                paused = rng.random_range(1..40);
            }
            if paused > 0 {
                paused -= 1;
                retargeter.brake(now).unwrap();
                if paused == 0 {
                    retargeter.begin_ramp();
                }
            } else if command % 3 == 0 {
                frame =
                    if rng.random_bool(0.05) { rng.random_range(0..HANDS.len()) } else { (frame + 1) % HANDS.len() };
                let mut hand = HANDS[frame];
                if rng.random_bool(0.05) {
                    hand[4] = DVec3::NAN;
                }
                let _ = retargeter.push_at(&Input::new(hand, now), now);
            } else {
                retargeter.advance(now).unwrap();
            }
            let after = retargeter.output().clone();
            let kept = keeps_limits(retargeter.robot(), &before, &after, dt.min(PERIOD));
            kept.unwrap_or_else(|broken| panic!("{name}, command {command}: {broken}"));
            before = after;
        }
    }
}

#[test]
fn no_link_penetrates_another_while_a_robot_brakes() {
    for name in ["four_finger", "tendon_hand"] {
        let mut retargeter = live(name, LiveOptions { ramp_secs: 0.0, ..LIVE });
        let mut rng = ChaCha8Rng::seed_from_u64(17);
        let mut now = 0.0;
        let mut stopped_in_motion = 0;
        for round in 0..60 {
            // Each hand is far from the last one, so the robot is fast when it has to brake.
            for command in 0..rng.random_range(3..20) {
                now += PERIOD;
                let hand = HANDS[rng.random_range(0..HANDS.len())];
                if command % 4 == 0 {
                    let _ = retargeter.push_at(&Input::new(hand, now), now);
                } else {
                    retargeter.advance(now).unwrap();
                }
            }
            let stop = retargeter.output().stop_qpos.clone();
            let secs = retargeter.output().stop_secs;
            stopped_in_motion += usize::from(secs > 2.0 * PERIOD);
            let mut commands = 0;
            while retargeter.is_moving() {
                now += PERIOD;
                retargeter.brake(now).unwrap();
                let depth = depth(&mut retargeter);
                assert!(depth <= MAX_PENETRATION + 1e-6, "{name}, round {round}: {depth} m");
                commands += 1;
            }
            let apart = stop.iter().zip(&retargeter.output().qpos).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(apart < 1e-9, "{name}, round {round}: stops {apart} rad from where it was said to");
            assert!((f64::from(commands) * PERIOD - secs).abs() <= PERIOD + 1e-9);
        }
        assert!(stopped_in_motion > 20, "{name}: {stopped_in_motion} of 60 brakes were from speed");
    }
}

#[test]
fn a_live_robot_arrives_where_an_unlimited_one_does() {
    let mut offline = Retargeter::new(Robot::load("four_finger", None).unwrap()).unwrap();
    let mut live = live("four_finger", LIVE);
    let mut now = 0.0;
    let mut far = Vec::new();
    for hand in HANDS.iter().step_by(48) {
        for _ in 0..100 {
            now += PERIOD;
            let _ = offline.push(&Input::new(*hand, now));
            let _ = live.push(&Input::new(*hand, now));
        }
        let apart = offline.output().qpos.iter().zip(&live.output().qpos).map(|(a, b)| (a - b).abs());
        far.push(apart.fold(0.0, f64::max));
    }
    far.sort_by(f64::total_cmp);
    // Ways differ, so that a few hands may end in another local minimum.
    assert!(far[far.len() * 3 / 4] < 0.02, "{far:?}");
    // At rest it is exactly at rest.
    let pose = live.output().qpos.clone();
    assert_eq!(live.advance(now + PERIOD).unwrap().qpos, pose);
    assert!(live.output().qvel.iter().all(|velocity| *velocity == 0.0));
}

#[test]
fn a_joint_takes_the_time_of_a_trapezoid_to_its_target() {
    // Acceleration a to speed v and back over the way s takes s / v + v / a.
    let mut robot = Robot::load("gripper", None).unwrap();
    robot.spec.limits.velocity = 0.2;
    let options = LiveOptions { acceleration: 10.0, ramp_secs: 0.0, period: 1e-3 };
    let mut retargeter =
        Retargeter::with_options(robot, Options { live: Some(options), ..Options::default() }).unwrap();
    // The hands that close and open the gripper most.
    let mut unlimited = Retargeter::new(Robot::load("gripper", None).unwrap()).unwrap();
    let jaw: Vec<(f64, usize)> = (0..HANDS.len())
        .step_by(8)
        .filter_map(|frame| Some((unlimited.push(&Input::new(HANDS[frame], frame as f64)).ok()?.qpos[0], frame)))
        .collect();
    let closed = jaw.iter().min_by(|a, b| a.0.total_cmp(&b.0)).unwrap().1;
    let open = jaw.iter().max_by(|a, b| a.0.total_cmp(&b.0)).unwrap().1;
    retargeter.push_at(&Input::new(HANDS[closed], 0.0), 0.0).unwrap();
    let mut now = 1e-3;
    retargeter.advance(now).unwrap();
    while retargeter.is_moving() {
        now += 1e-3;
        retargeter.advance(now).unwrap();
        assert!(now < 10.0);
    }
    let from = retargeter.output().qpos.clone();
    retargeter.push_at(&Input::new(HANDS[open], now), now).unwrap();
    let began = now;
    loop {
        now += 1e-3;
        let output = retargeter.advance(now).unwrap();
        if output.qvel.iter().all(|velocity| *velocity == 0.0) {
            break;
        }
        assert!(now < began + 10.0);
    }
    let moved = from.iter().zip(&retargeter.output().qpos).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    // A slide's limits are a tenth of a hinge's.
    let (v, a): (f64, f64) = (0.02, 1.0);
    assert!(moved > v * v / a, "{moved} m: the jaw does not reach its speed");
    let expected = moved / v + v / a;
    assert!((now - began - expected).abs() < 5e-3, "{} s for {moved} m, expected {expected} s", now - began);
}

#[test]
fn the_speed_limit_grows_over_the_ramp() {
    let fastest = |ramp_secs: f64, secs: f64| {
        let mut retargeter = live("four_finger", LiveOptions { ramp_secs, ..LIVE });
        let (mut now, mut fastest) = (0.0, 0.0f64);
        let _ = retargeter.push_at(&Input::new(HANDS[60], 0.0), now);
        while now < secs {
            now += PERIOD;
            let output = retargeter.advance(now).unwrap();
            fastest = output.qvel.iter().fold(fastest, |most, velocity| most.max(velocity.abs()));
        }
        fastest
    };
    // 10 rad/s is the limit; after eight periods of a ramp of 10 s, 0.133 rad/s.
    assert!(fastest(10.0, 0.1) <= 0.134, "{}", fastest(10.0, 0.1));
    assert!(fastest(0.0, 0.1) > 1.0, "{}", fastest(0.0, 0.1));
}

#[test]
fn a_start_that_is_no_pose_is_refused() {
    let mut retargeter = live("four_finger", LIVE);
    let before = retargeter.output().qpos.clone();
    assert!(retargeter.start_from(&[0.0; 3]).unwrap_err().to_string().contains("qpos"));
    let mut bad = before.clone();
    bad[2] = f64::NAN;
    let error = retargeter.start_from(&bad).unwrap_err().to_string();
    assert!(error.contains(retargeter.robot().joint_names()[2]), "{error}");
    assert_eq!(retargeter.output().qpos, before);
    let mut beyond = before.clone();
    let joint = retargeter.robot().output_joints().next().unwrap();
    beyond[0] = retargeter.robot().parts.joints[joint].range[1] + 0.3;
    assert!((retargeter.start_from(&beyond).unwrap() - 0.3).abs() < 1e-9);
    for (acceleration, ramp_secs, period) in
        [(0.0, 1.0, 0.01), (f64::NAN, 1.0, 0.01), (1.0, -1.0, 0.01), (1.0, 1.0, 0.0)]
    {
        let options = Options { live: Some(LiveOptions { acceleration, ramp_secs, period }), ..Options::default() };
        assert!(Retargeter::with_options(Robot::load("gripper", None).unwrap(), options).is_err());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn periods_and_accelerations_of_any_size_keep_the_limits(
        period in 1e-3..0.05f64, frames in proptest::collection::vec(0usize..480, 3..8),
    ) {
        let mut retargeter = live("gripper", LiveOptions { period, ..LIVE });
        let mut before = retargeter.output().clone();
        let mut now = 0.0;
        for frame in frames {
            for command in 0..10 {
                now += period;
                if command == 0 {
                    let _ = retargeter.push_at(&Input::new(HANDS[frame], now), now);
                } else {
                    retargeter.advance(now).unwrap();
                }
                let after = retargeter.output().clone();
                let kept = keeps_limits(retargeter.robot(), &before, &after, period);
                prop_assert!(kept.is_ok(), "{:?}", kept);
                before = after;
            }
        }
    }
}
