//! Styles of the look change pictures and nothing else.

use egotac::sim::scene::LookStyle;
use egotac::sim::{Effect, EffectSet, Rollout, RolloutOptions, Scene, SimFrame};

const SEED: u64 = 5;

fn options(style: LookStyle) -> RolloutOptions {
    RolloutOptions { style: Some(style), picture: Some((64, 64)), ..RolloutOptions::default() }
}

/// Simulates the first frames of an episode with looks of all kinds: a hand with a tracker, props, gloves or skin.
fn frames(options: &RolloutOptions, count: usize) -> Vec<SimFrame> {
    let mut rollout = Rollout::new(&Scene::load("lift_mug").unwrap(), SEED, options).unwrap();
    (0..count).map(|_| rollout.next_frame().unwrap().unwrap()).collect()
}

fn with(effects: impl IntoIterator<Item = Effect>) -> RolloutOptions {
    let plain = Rollout::new(&Scene::load("lift_mug").unwrap(), SEED, &options(LookStyle::Plain)).unwrap().effects();
    let effects: EffectSet = effects.into_iter().fold(plain, EffectSet::with);
    RolloutOptions { effects: Some(effects), style: None, ..options(LookStyle::Plain) }
}

#[test]
fn touch_and_motion_are_the_same_in_all_styles() {
    let plain = frames(&options(LookStyle::Plain), 40);
    assert!(plain.iter().any(|frame| frame.frame.field.force.iter().any(|force| *force > 0.05)), "nothing touches");
    for style in [LookStyle::Varied, LookStyle::Photo] {
        for (a, b) in plain.iter().zip(frames(&options(style), 40)) {
            assert_eq!(a.frame.field, b.frame.field);
            assert_eq!(a.objects, b.objects);
            assert_eq!(a.frame.right_hand_pose, b.frame.right_hand_pose);
            assert_ne!(a.frame.camera_ego_rgb, b.frame.camera_ego_rgb, "{}", style.name());
        }
    }
}

#[test]
fn each_effect_of_the_photo_style_changes_the_picture() {
    let plain = &frames(&with([]), 1)[0];
    for effect in LookStyle::Photo.effects().iter() {
        let other = &frames(&with([effect]), 1)[0];
        assert_ne!(plain.frame.camera_ego_rgb, other.frame.camera_ego_rgb, "{effect}");
        let moves_the_camera = effect == Effect::OtherCamera;
        assert_eq!(plain.camera != other.camera, moves_the_camera, "{effect}");
    }
}

#[test]
fn a_seed_gives_the_same_pictures_again() {
    let of = || frames(&options(LookStyle::Photo), 2);
    for (a, b) in of().iter().zip(of()) {
        assert_eq!(a.frame.camera_ego_rgb, b.frame.camera_ego_rgb);
    }
}

#[test]
fn a_scene_file_chooses_the_style_and_an_unknown_one_is_refused() {
    let scene = |style: &str| {
        let text = format!("description: test\nobjects: []\nhands: [{{ side: right }}]\nlook: {{ style: {style} }}");
        Scene::parse("test", std::path::Path::new("test.yaml"), &text)
    };
    let effects = |style: &str| {
        let rollout =
            Rollout::new(&scene(style).unwrap(), 1, &RolloutOptions { style: None, ..options(LookStyle::Plain) });
        rollout.unwrap().effects()
    };
    assert!(effects("photo").contains(Effect::CameraProcessing) && effects("photo").contains(Effect::Wearer));
    assert!(effects("varied").contains(Effect::Textures) && !effects("varied").contains(Effect::Wearer));
    assert!(!effects("plain").contains(Effect::Textures));
    let error = scene("shiny").unwrap_err().to_string();
    assert!(error.contains("shiny") && error.contains("photo"), "{error}");
}
