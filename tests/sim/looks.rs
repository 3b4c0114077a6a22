//! Styles of the look, own photographs and own meshes change pictures and nothing else.

use std::path::Path;
use std::sync::Arc;

use egotac::sim::scene::LookStyle;
use egotac::sim::{Backgrounds, Effect, EffectSet, PropMeshes, Rollout, RolloutOptions, Scene, SimFrame};

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
    let plain = &frames(&with([]), 3);
    for effect in LookStyle::Photo.effects().iter() {
        // Rows that are read one after the other differ only where something has moved: not in the first frame.
        let other = &frames(&with([effect]), 3);
        let differs = plain.iter().zip(other).any(|(a, b)| a.frame.camera_ego_rgb != b.frame.camera_ego_rgb);
        assert!(differs, "{effect}");
        let moves_the_camera = effect == Effect::OtherCamera;
        assert_eq!(plain[0].camera != other[0].camera, moves_the_camera, "{effect}");
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

/// Share of the pixels whose largest channel is the given one.
fn dominated_by(channel: usize, frame: &SimFrame) -> f64 {
    let picture = &frame.frame.camera_ego_rgb;
    let dominated = picture.pixels().filter(|pixel| (0..3).all(|k| k == channel || pixel.0[channel] > pixel.0[k]));
    dominated.count() as f64 / f64::from(picture.width() * picture.height())
}

#[test]
fn own_photographs_lie_on_walls_floor_and_table() {
    let folder = tempfile::TempDir::new().unwrap();
    let green = image::RgbImage::from_pixel(40, 30, image::Rgb([0, 255, 0]));
    green.save(folder.path().join("green.png")).unwrap();
    let backgrounds = Some(Arc::new(Backgrounds::open(folder.path()).unwrap()));
    let bright = |effects: Vec<Effect>| RolloutOptions { backgrounds: backgrounds.clone(), ..with(effects) };
    let share = |options: &RolloutOptions| dominated_by(1, &frames(options, 1)[0]);
    let (drawn, own) = (share(&with([Effect::Textures])), share(&bright(vec![Effect::Textures])));
    assert!(own > drawn + 0.2, "green: {drawn} without the photograph, {own} with it");
    let touch = |options: &RolloutOptions| frames(options, 30).pop().unwrap().frame.field;
    assert_eq!(touch(&bright(vec![Effect::Textures])), touch(&with([])));
    let error = Rollout::new(&Scene::load("lift_mug").unwrap(), SEED, &bright(vec![])).unwrap_err().to_string();
    assert!(error.contains("backgrounds") && error.contains("textures"), "{error}");
}

#[test]
fn folders_without_usable_pictures_or_meshes_are_refused_by_name() {
    let folder = tempfile::TempDir::new().unwrap();
    let path: &Path = folder.path();
    let refused = |error: String, what: &str| assert!(error.contains(what), "{error}");
    refused(Backgrounds::open(path).unwrap_err().to_string(), "PNG or JPEG");
    refused(PropMeshes::open(path).unwrap_err().to_string(), "OBJ or STL");
    std::fs::write(path.join("flat.obj"), "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\nf 1 2 4\nf 2 3 4\n")
        .unwrap();
    refused(PropMeshes::open(path).unwrap_err().to_string(), "flat.obj");
    std::fs::write(path.join("broken.jpg"), b"\xff\xd8\xff").unwrap();
    let backgrounds = Some(Arc::new(Backgrounds::open(path).unwrap()));
    let options = RolloutOptions { backgrounds, ..options(LookStyle::Photo) };
    let error = Rollout::new(&Scene::load("lift_mug").unwrap(), SEED, &options).unwrap_err();
    refused(error.to_string(), "broken.jpg");
}

#[test]
fn own_meshes_take_the_place_of_the_clutter() {
    let folder = tempfile::TempDir::new().unwrap();
    let tetrahedron = "v 0 0 0\nv 2 0 0\nv 0 2 0\nv 0 0 4\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
    std::fs::write(folder.path().join("tetrahedron.obj"), tetrahedron).unwrap();
    let prop_meshes = Some(Arc::new(PropMeshes::open(folder.path()).unwrap()));
    let own = RolloutOptions { prop_meshes, ..with([Effect::Clutter]) };
    let picture = |options: &RolloutOptions| frames(options, 1).pop().unwrap().frame.camera_ego_rgb;
    assert_ne!(picture(&own), picture(&with([Effect::Clutter])));
    assert_ne!(picture(&own), picture(&with([])));
    let touch = |options: &RolloutOptions| frames(options, 30).pop().unwrap().frame.field;
    assert_eq!(touch(&own), touch(&with([])));
}
