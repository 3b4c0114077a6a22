//! What the commands of `egotac sim` share.

use anyhow::ensure;

use super::Making;
use crate::sim::{RolloutOptions, Scene, mesh_faults, mjcf};

/// A scene; what is wrong with its meshes goes to standard error.
pub fn load(name_or_path: &str) -> anyhow::Result<Scene> {
    let scene = Scene::load(name_or_path)?;
    for line in mesh_faults(&scene)? {
        eprintln!("egotac: warning: {line}");
    }
    Ok(scene)
}

/// A picture of `size` x `size` pixels.
pub fn picture(size: u32) -> anyhow::Result<Option<(u32, u32)>> {
    let most = mjcf::MAX_PICTURE;
    ensure!((8..=most).contains(&size), "--size: expected 8 to {most} pixels, got {size}");
    Ok(Some((size, size)))
}

/// Options of a rollout with pictures of `size` x `size` pixels.
pub fn options(making: &Making, size: u32) -> anyhow::Result<RolloutOptions> {
    Ok(RolloutOptions {
        hands: making.hands.models()?,
        picture: picture(size)?,
        shadows: making.shadows,
        sigma: making.kernel.metres(),
        ..RolloutOptions::default()
    })
}
