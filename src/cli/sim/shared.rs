//! Loading of scenes and options, shared by the commands of `egotac sim`.

use std::sync::Arc;

use anyhow::ensure;

use super::RolloutArgs;
use crate::sim::scene::{LookStyle, PresentHands};
use crate::sim::{Backgrounds, PropMeshes, RolloutOptions, Scene, mesh_faults, mjcf};
use crate::text::tell;

/// Loads a scene; prints faults of its mesh files to standard error.
pub fn load(name_or_path: &str) -> anyhow::Result<Scene> {
    let scene = Scene::load(name_or_path)?;
    for line in mesh_faults(&scene)? {
        tell(format_args!("egotac: warning: {line}"));
    }
    Ok(scene)
}

/// Gives a scene the hands of `--hands`.
pub fn with_hands(mut scene: Scene, rollout: &RolloutArgs) -> anyhow::Result<Scene> {
    if let Some(name) = &rollout.present {
        PresentHands::from_name(name)?.apply(&mut scene.spec);
    }
    Ok(scene)
}

/// Checks `--size` and returns the size of a square picture, pixels.
pub fn picture(size: u32) -> anyhow::Result<Option<(u32, u32)>> {
    let max = mjcf::MAX_PICTURE;
    ensure!((8..=max).contains(&size), "--size: expected 8 to {max} pixels, got {size}");
    Ok(Some((size, size)))
}

/// Returns the options of a rollout with pictures of `size` x `size` pixels.
pub fn options(rollout: &RolloutArgs, size: u32) -> anyhow::Result<RolloutOptions> {
    Ok(RolloutOptions {
        hands: rollout.hands.models()?,
        picture: picture(size)?,
        shadows: rollout.shadows,
        style: rollout.look.as_deref().map(LookStyle::from_name).transpose()?,
        backgrounds: rollout.backgrounds.as_deref().map(Backgrounds::open).transpose()?.map(Arc::new),
        prop_meshes: rollout.objects.as_deref().map(PropMeshes::open).transpose()?.map(Arc::new),
        sigma: rollout.kernel.metres(),
        ..RolloutOptions::default()
    })
}
