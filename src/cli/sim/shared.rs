//! What the commands of `egotac sim` share.

use anyhow::ensure;

use super::Hands;
use crate::sim::{RolloutOptions, Scene, mjcf};

/// A scene; what is wrong with its meshes goes to standard error.
pub fn load(name_or_path: &str) -> anyhow::Result<Scene> {
    let scene = Scene::load(name_or_path)?;
    for line in scene.mesh_faults()? {
        eprintln!("egotac: warning: {line}");
    }
    Ok(scene)
}

/// Options of a rollout with pictures of `size` x `size` pixels.
pub fn options(hands: &Hands, size: u32, shadows: bool) -> anyhow::Result<RolloutOptions> {
    let most = mjcf::MAX_PICTURE;
    ensure!((8..=most).contains(&size), "--size: expected 8 to {most} pixels, got {size}");
    Ok(RolloutOptions { hands: hands.models()?, picture: Some((size, size)), shadows, ..RolloutOptions::default() })
}
