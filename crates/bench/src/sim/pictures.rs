//! The knobs `size` and `shadows`: time of a picture.

use std::time::Instant;

use egotac::error::Result;
use egotac::mujoco::Renderer;
use egotac::sim::mjcf::HEAD;
use egotac::sim::{Rollout, RolloutOptions, Scene};

use super::knob::Knob;

/// Kinds of pictures: knob, name, width and height in pixels, shadows.
const PICTURES: [(Knob, &str, u32, u32, bool); 6] = [
    (Knob::Size, "112 x 112", 112, 112, false),
    (Knob::Size, "224 x 224", 224, 224, false),
    (Knob::Size, "448 x 448", 448, 448, false),
    (Knob::Size, "640 x 480", 640, 480, false),
    (Knob::Shadows, "off, 224 x 224", 224, 224, false),
    (Knob::Shadows, "on, 224 x 224", 224, 224, true),
];
/// Pictures of each kind in a round; the least counts.
const PICTURES_PER_ROUND: usize = 6;

/// Knob and name of a kind of picture, and its time per simulated second, s, or the reason why it can't be drawn.
pub type PictureResult = (Knob, &'static str, Result<f64>);

/// Draws the middle of an episode as each kind of the given knobs.
pub fn picture_kinds(
    scene: &Scene,
    seed: u64,
    knobs: &[Knob],
    options: &RolloutOptions,
    rounds: usize,
) -> Vec<PictureResult> {
    let kinds: Vec<_> = PICTURES.iter().filter(|(knob, ..)| knobs.contains(knob)).collect();
    let mut least: Vec<Result<f64>> = kinds.iter().map(|_| Ok(f64::INFINITY)).collect();
    for _ in 0..rounds.max(1) {
        for ((_, _, width, height, shadows), least) in kinds.iter().zip(&mut least) {
            if let Ok(before) = least {
                *least = seconds_per_picture(scene, seed, (*width, *height), *shadows, options).map(|s| s.min(*before));
            }
        }
    }
    let rate = scene.spec.rate;
    kinds.iter().zip(least).map(|((knob, name, ..), least)| (*knob, *name, least.map(|s| s * rate))).collect()
}

fn seconds_per_picture(
    scene: &Scene,
    seed: u64,
    (width, height): (u32, u32),
    shadows: bool,
    options: &RolloutOptions,
) -> Result<f64> {
    let mut rollout =
        Rollout::new(scene, seed, &RolloutOptions { shadows, picture: Some((width, height)), ..options.clone() })?;
    for _ in 0..rollout.frame_count() / 2 {
        rollout.skip_frame();
    }
    let mut world = rollout.into_world();
    let mut renderer = Renderer::new(&world, world.camera(HEAD)?, width, height, false)?;
    renderer.render(&mut world)?;
    let mut least = f64::INFINITY;
    for _ in 0..PICTURES_PER_ROUND {
        let begun = Instant::now();
        renderer.render(&mut world)?;
        least = least.min(begun.elapsed().as_secs_f64());
    }
    Ok(least)
}
