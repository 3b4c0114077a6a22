//! Closed-loop control of a scene's hand.

use std::path::Path;

use egotac::hand::Side;
use egotac::sim::{ChannelValues, Environment, RolloutOptions, Scene, SimFrame};
use glam::DVec3;

/// Environment of a shipped scene, without pictures.
fn environment(scene: &str) -> Environment {
    let options = RolloutOptions { picture: None, ..RolloutOptions::default() };
    Environment::new(Scene::load(scene).unwrap(), options)
}

/// Steps from one command to another in `frames` equal parts; returns the last frame.
fn go(environment: &mut Environment, from: ChannelValues, to: ChannelValues, frames: u32) -> SimFrame {
    let mut last = None;
    for frame in 1..=frames {
        let share = f64::from(frame) / f64::from(frames);
        let mix = |a: f64, b: f64| a + (b - a) * share;
        let command = ChannelValues {
            standoff: mix(from.standoff, to.standoff),
            opening: mix(from.opening, to.opening),
            squeeze: mix(from.squeeze, to.squeeze),
            shift: from.shift.lerp(to.shift, share),
            ..to
        };
        last = environment.step(command).unwrap();
    }
    last.expect("the episode is longer than the commands")
}

/// Pinches the cube of `pinch_cube`, lifts it by 3 cm and holds it.
fn pinch_and_lift(environment: &mut Environment, seed: u64) -> SimFrame {
    environment.reset(seed).unwrap();
    let open = ChannelValues { opening: 0.02, ..ChannelValues::default() };
    let away = ChannelValues { standoff: 0.05, ..open };
    let closed = ChannelValues::default();
    let pinched = ChannelValues { squeeze: 1.5, ..closed };
    let lifted = ChannelValues { shift: DVec3::Z * 0.03, ..pinched };
    go(environment, away, open, 8);
    go(environment, open, closed, 8);
    go(environment, closed, pinched, 8);
    go(environment, pinched, lifted, 15);
    go(environment, lifted, lifted, 8)
}

#[test]
fn a_commanded_hand_lifts_the_cube_and_carries_its_weight() {
    let mut environment = environment("pinch_cube");
    for seed in [0, 1, 5] {
        let first = environment.reset(seed).unwrap();
        let last = pinch_and_lift(&mut environment, seed);
        let rise = last.objects[0].position.z - first.objects[0].position.z;
        assert!((rise - 0.03).abs() < 0.006, "seed {seed}: {rise} m");
        let rollout = environment.rollout().unwrap();
        let body = rollout.objects()[0].body().unwrap();
        let upward = |contact: egotac::mujoco::Contact| match contact.bodies {
            [_, second] if second == body => contact.force.z,
            [first, _] if first == body => -contact.force.z,
            _ => 0.0,
        };
        let carried: f64 = rollout.world().contacts().map(upward).sum();
        let weight = 9.81 * rollout.episode().objects[0].mass;
        assert!((carried - weight).abs() < 0.05 * weight, "seed {seed}: {carried} N of {weight} N");
    }
}

#[test]
fn the_same_commands_give_the_same_frames_also_after_another_episode() {
    let mut a = environment("pinch_cube");
    let mut b = environment("pinch_cube");
    b.reset(3).unwrap();
    let (a, b) = (pinch_and_lift(&mut a, 2), pinch_and_lift(&mut b, 2));
    assert_eq!(a.frame.field, b.frame.field);
    assert_eq!(a.objects, b.objects);
}

#[test]
fn a_command_replaces_the_script() {
    let mut environment = environment("pinch_cube");
    let first = environment.reset(0).unwrap();
    let open = ChannelValues { standoff: 0.06, opening: 0.02, ..ChannelValues::default() };
    let mut last = first.clone();
    while let Some(frame) = environment.step(open).unwrap() {
        last = frame;
    }
    // The script pinches and lifts the cube; the open hand never touches it.
    assert_eq!(Side::BOTH.map(|side| last.frame.field.total_force(side)), [0.0, 0.0]);
    assert!((last.objects[0].position - first.objects[0].position).length() < 1e-3);
    assert!(last.frame.timestamp > 2.0, "the episode has the length of the script");
}

#[test]
fn commands_that_cannot_be_followed_are_refused() {
    let mut pinch = environment("pinch_cube");
    let early = pinch.step(ChannelValues::default()).unwrap_err().to_string();
    assert!(early.contains("reset"), "{early}");
    pinch.reset(0).unwrap();
    let wrong = ChannelValues { squeeze: f64::NAN, ..ChannelValues::default() };
    assert!(pinch.step(wrong).unwrap_err().to_string().contains("finite"));

    let text = "description: A hand rests.\nobserve: [pose]\nobjects: []\nhands: [{ side: right }]\n";
    let rest = Scene::parse("rest", Path::new("rest.yaml"), text).unwrap();
    let mut rest = Environment::new(rest, RolloutOptions { picture: None, ..RolloutOptions::default() });
    assert!(rest.reset(0).unwrap_err().to_string().contains("hands[0].act"));
}
