//! The hands of a scene can be chosen: none, one, or both.

use egotac::hand::Side;
use egotac::sim::scene::PresentHands;
use egotac::sim::{Rollout, RolloutOptions, Scene};

fn rollout(scene: &str, hands: Option<&str>, seed: u64) -> Rollout {
    let mut scene = Scene::load(scene).unwrap();
    if let Some(name) = hands {
        PresentHands::from_name(name).unwrap().apply(&mut scene.spec);
    }
    Rollout::new(&scene, seed, &RolloutOptions { picture: None, ..RolloutOptions::default() }).unwrap()
}

fn sides(rollout: &Rollout) -> Vec<Side> {
    let mut sides: Vec<Side> = rollout.episode().hands.iter().map(|hand| hand.side).collect();
    sides.sort_by_key(|side| *side as usize);
    sides
}

#[test]
fn a_scene_has_the_hands_that_are_asked_for() {
    for seed in 0..6 {
        // One idle hand beside the acting one, or two that act.
        for scene in ["hover", "carry_box"] {
            assert_eq!(sides(&rollout(scene, Some("none"), seed)), [], "{scene} {seed}");
            assert_eq!(sides(&rollout(scene, Some("left"), seed)), [Side::Left], "{scene} {seed}");
            assert_eq!(sides(&rollout(scene, Some("right"), seed)), [Side::Right], "{scene} {seed}");
            assert_eq!(sides(&rollout(scene, Some("both"), seed)), Side::BOTH, "{scene} {seed}");
        }
    }
    let error = PresentHands::from_name("three").unwrap_err().to_string();
    assert!(PresentHands::NAMES.iter().all(|name| error.contains(name)), "{error}");
}

#[test]
fn a_scene_without_hands_keeps_its_objects_and_touches_nothing() {
    for seed in [3, 4] {
        let (whole, mut none) = (rollout("lift_mug", None, seed), rollout("lift_mug", Some("none"), seed));
        let places = |rollout: &Rollout| -> Vec<_> {
            let own = rollout.episode().objects.iter().filter(|object| !object.name.starts_with("distractor"));
            own.map(|object| (object.name.clone(), object.position, object.orientation)).collect()
        };
        assert_eq!(places(&whole), places(&none));
        let mut frames = 0;
        while let Some(frame) = none.next_frame().unwrap() {
            assert!(frame.frame.field.force.iter().all(|force| *force == 0.0));
            assert!(frame.frame.left_hand_pose.is_none() && frame.frame.right_hand_pose.is_none());
            // A hand that is not in the scene is known: zeros that count.
            assert!(frame.frame.force_valid.iter().all(|valid| *valid == 1));
            frames += 1;
        }
        assert!(frames >= 25, "{frames} frames");
    }
}
