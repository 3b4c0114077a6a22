//! A scene file is checked in full before anything is simulated, and the message says what is wrong where.
#![cfg(feature = "sim")]

use std::path::Path;

use egotac::sim::{SHIPPED, Scene};

fn edited(from: &str, to: &str) -> String {
    let text = SHIPPED.iter().find(|(name, _)| *name == "pinch_cube").unwrap().1;
    assert!(text.contains(from), "{from}");
    let text = text.replacen(from, to, 1);
    Scene::parse("edited", Path::new("edited.yaml"), &text).unwrap_err().to_string()
}

#[test]
fn every_shipped_scene_loads_by_name() {
    for (name, _) in SHIPPED {
        let scene = Scene::load(name).unwrap();
        assert_eq!(scene.name, name);
        assert!(!scene.spec.description.is_empty());
    }
}

#[test]
fn an_unknown_scene_lists_the_known_ones() {
    let error = Scene::load("pinch_kube").unwrap_err().to_string();
    assert!(error.contains("pinch_kube") && error.contains("pinch_cube"), "{error}");
}

#[test]
fn an_unknown_key_is_refused_by_file_and_name() {
    let error = edited("mass:", "weight: 3\n    mass:");
    assert!(error.contains("edited.yaml") && error.contains("weight") && error.contains("friction"), "{error}");
    let error = edited("squeeze: 1", "squeze: 1");
    assert!(error.contains("squeze") && error.contains("squeeze"), "{error}");
}

#[test]
fn a_value_out_of_range_says_what_was_expected() {
    let error = edited("mass: [0.02, 0.08]", "mass: [0.08, 0.02]");
    assert!(error.contains("low <= high"), "{error}");
    let error = edited("mass: [0.02, 0.08]", "mass: 0");
    assert!(error.contains("objects[0].mass"), "{error}");
    let error = edited("mass: [0.02, 0.08]", "mass: heavy");
    assert!(error.contains("a number or a range"), "{error}");
    let error = edited("hands:", "rate: 30\nhands:");
    assert!(error.contains("whole number") && error.contains("0.002"), "{error}");
    let error = edited("hands:", "physics: { timestep: 0 }\nhands:");
    assert!(error.contains("timestep"), "{error}");
    let error = edited("object: cube", "object: ball");
    assert!(error.contains("ball") && error.contains("cube"), "{error}");
    let error = edited("at: [-1, 0, 0]", "at: [0, 0, 0]");
    assert!(error.contains("direction"), "{error}");
    let error = edited("force: [0.4, 1.2]", "force: [-2, -1]");
    assert!(error.contains("contacts.thumb.force") && error.contains("0 to 1000"), "{error}");
    let error = edited("share: 1", "share: .nan");
    assert!(error.contains("share"), "{error}");
    let error = edited("name: cube", "name: table").replace("object: cube", "object: table");
    assert!(error.contains("objects[0].name") && error.contains("a name of its own"), "{error}");
    let error = edited("- presence: 0.3", "- { side: left, presence: 0.3 }");
    assert!(error.contains("hands[1].side"), "{error}");
}
