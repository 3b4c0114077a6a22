//! Scenes of the split `ood`, and looks of scenes.

use std::path::Path;

use crate::common::egotac;
use egotac::sim::scene::Split;
use egotac::sim::{Rollout, RolloutOptions, SHIPPED, Scene};

/// Returns the force on all vertices, frame by frame, N.
fn forces(scene: &Scene, seed: u64) -> Vec<Vec<f32>> {
    let options = RolloutOptions { picture: None, ..RolloutOptions::default() };
    let mut rollout = Rollout::new(scene, seed, &options).unwrap();
    let mut forces = Vec::new();
    while let Some(frame) = rollout.next_frame().unwrap() {
        forces.push(frame.frame.field.force);
    }
    forces
}

#[test]
fn held_out_scenes_touch_as_their_relatives_do() {
    for name in Split::named("ood").unwrap().scene_names("ood") {
        let scene = Scene::load(&name).unwrap();
        let touches = (0..2).filter(|seed| forces(&scene, *seed).iter().flatten().any(|force| *force > 0.05)).count();
        assert_eq!(touches, if name == "ood/reach_past" { 0 } else { 2 }, "{name}");
    }
}

#[test]
fn what_covers_the_hands_changes_no_force() {
    let (_, text) = SHIPPED.iter().find(|(name, _)| *name == "pinch_cube").unwrap();
    let scene = |more: &str| Scene::parse("pinch_cube", Path::new("own.yaml"), &format!("{text}{more}\n")).unwrap();
    let (bare, gloved) = (scene(""), scene("look: { hands: glove, ambient: 0.3, table_patterns: [flat] }"));
    assert_eq!(forces(&bare, 2), forces(&gloved, 2));
    let error = Scene::parse("own", Path::new("own.yaml"), &format!("{text}look: {{ ambient: 3 }}\n")).unwrap_err();
    assert!(error.to_string().contains("look.ambient"), "{error}");
}

#[test]
fn scenes_of_a_split_are_listed_and_generated_under_their_names() {
    let output = egotac(&["sim", "list", "--split", "ood"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success() && text.lines().count() == 6 && text.contains("ood/tripod"), "{text}");
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("ood.zarr");
    let store = store.to_str().unwrap();
    let output = egotac(&["sim", "generate", "--split", "ood", "--episodes", "2", "--size", "16", "--out", store]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let attributes = std::fs::read_to_string(Path::new(store).join(".zattrs")).unwrap();
    assert!(attributes.contains("ood/tripod") && attributes.contains("ood/power_grasp"), "{attributes}");
    for (arguments, word) in
        [(vec!["--split", "test"], "ood, train"), (vec!["--split", "ood", "poke"], "cannot be used")]
    {
        let output = egotac(&[&["sim", "generate"], &arguments[..], &["--out", "never.zarr"]].concat());
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && error.contains(word), "{error}");
    }
}
