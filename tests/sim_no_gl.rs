//! Without pictures no OpenGL context is created. The test has its own file because the count is per process.
#![cfg(feature = "sim")]

use std::path::Path;

use egotac::mujoco::Renderer;
use egotac::sim::{Rollout, RolloutOptions, Scene};

#[test]
fn scene_without_pictures_creates_no_opengl_context() {
    let text = std::fs::read_to_string("sim/scenes/pinch_cube.yaml").unwrap();
    let run = |text: &str| {
        let scene = Scene::parse("pinch_cube", Path::new("pinch_cube.yaml"), text).unwrap();
        let mut rollout = Rollout::new(&scene, 1, &RolloutOptions::default()).unwrap();
        let frame = rollout.next_frame().unwrap().unwrap();
        frame.frame.camera_ego_rgb.dimensions()
    };
    assert_eq!(run(&format!("{text}observe: [pose, contact, force]\n")), (1, 1));
    assert_eq!(Renderer::contexts_opened(), 0);
    assert_eq!(run(&text), (224, 224));
    assert_eq!(Renderer::contexts_opened(), 1);
}
