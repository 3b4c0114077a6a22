//! Options of a rollout beside the scene itself.

use std::sync::Arc;

use crate::error::{Error, Result};
use crate::geometry::{ForceSpreader, SIGMA};
use crate::hand::{HandModel, N_BETAS, Side};
use crate::mujoco::PhysicsOptions;
use crate::sim::effect::{Effect, EffectSet};
use crate::sim::photo::{Backgrounds, PropMeshes};
use crate::sim::rig::HandRig;
use crate::sim::scene::{EffectPlan, LookStyle, SceneSpec};

/// Hands, picture, labels and physics of a rollout.
#[derive(Debug, Clone)]
pub struct RolloutOptions {
    /// Left and right hand; both have the same topology.
    pub hands: [HandModel; 2],
    /// Shape coefficients of both hands.
    pub betas: [f32; N_BETAS],
    /// Width and height of the picture, pixels; `None` never creates an OpenGL context, and pictures are 1 x 1.
    pub picture: Option<(u32, u32)>,
    /// True to draw shadows even where the scene does not list them.
    pub shadows: bool,
    /// Style of the look instead of the scene's.
    pub style: Option<LookStyle>,
    /// Photographs for walls, floor and table; they need [`Effect::Textures`].
    pub backgrounds: Option<Arc<Backgrounds>>,
    /// Meshes for the clutter; they need [`Effect::Clutter`].
    pub prop_meshes: Option<Arc<PropMeshes>>,
    /// Effects instead of those of the scene; for measuring the cost of an effect.
    pub effects: Option<EffectSet>,
    /// Standard deviation of the kernel that spreads contact forces, m.
    pub sigma: f64,
    /// Physics options instead of those of the scene and its effects; for measuring the cost of an option.
    pub physics: Option<PhysicsOptions>,
    /// Largest number of corners of a link's collision hull; `None` keeps all.
    pub hull_corners: Option<usize>,
    /// True if guards check every step; otherwise they check only at the frames' instants.
    pub guards: bool,
}

impl Default for RolloutOptions {
    fn default() -> Self {
        Self {
            hands: Side::BOTH.map(HandModel::builtin),
            betas: [0.0; N_BETAS],
            picture: Some((224, 224)),
            shadows: false,
            style: None,
            backgrounds: None,
            prop_meshes: None,
            effects: None,
            sigma: SIGMA,
            physics: None,
            hull_corners: None,
            guards: true,
        }
    }
}

impl RolloutOptions {
    /// Creates the rigs of the left and the right hand.
    ///
    /// # Errors
    /// If the hands differ in topology, are not left and right, or cannot be rigged.
    pub(super) fn rigs(&self) -> Result<[HandRig; 2]> {
        let [left, right] = &self.hands;
        left.topology.must_match(right.topology)?;
        for (model, side) in self.hands.iter().zip(Side::BOTH) {
            if model.side != side {
                return Err(Error::value("hands", "left, then right", model.side.name()));
            }
        }
        let mut rigs = [HandRig::new(left.clone(), self.betas)?, HandRig::new(right.clone(), self.betas)?];
        if let Some(corners) = self.hull_corners {
            rigs.iter_mut().try_for_each(|rig| rig.limit_corners(corners))?;
        }
        Ok(rigs)
    }

    /// Creates the force spreaders of the left and the right hand.
    ///
    /// # Errors
    /// If `sigma` is not a positive length.
    pub(super) fn spreaders(&self) -> Result<[ForceSpreader; 2]> {
        let [left, right] = &self.hands;
        Ok([ForceSpreader::new(left, self.sigma)?, ForceSpreader::new(right, self.sigma)?])
    }

    /// Selects effects and physics for a scene.
    ///
    /// # Errors
    /// If an effect lacks one that it requires, or the physics options are not valid.
    pub(crate) fn effects_and_physics(&self, scene: &SceneSpec) -> Result<(EffectSet, PhysicsOptions)> {
        let plan = EffectPlan::of(scene)?;
        let effects = self.select_effects(&plan)?;
        let physics = match &self.physics {
            Some(physics) => physics.clone(),
            None => plan.physics(effects, &scene.physics)?,
        };
        Ok((effects, physics))
    }

    fn select_effects(&self, plan: &EffectPlan) -> Result<EffectSet> {
        let mut effects = self.effects.unwrap_or(plan.effects());
        if let Some(style) = self.style.filter(|_| effects.contains(Effect::Rendering)) {
            effects = LookStyle::Photo.effects().iter().fold(effects, EffectSet::without);
            effects = style.effects().iter().fold(effects, EffectSet::with);
        }
        if self.shadows && effects.contains(Effect::Rendering) {
            effects = effects.with(Effect::Shadows);
        }
        if self.picture.is_none() {
            let of_pictures = |effect: &Effect| effect.needs().contains(&Effect::Rendering);
            let pictures = Effect::ALL.into_iter().filter(of_pictures).chain([Effect::Rendering]);
            effects = pictures.fold(effects, EffectSet::without);
        }
        effects.check()?;
        let own = [
            ("backgrounds", self.backgrounds.is_some(), Effect::Textures),
            ("objects of the background", self.prop_meshes.is_some(), Effect::Clutter),
        ];
        if let Some((what, _, effect)) = own.iter().find(|(_, given, effect)| *given && !effects.contains(*effect)) {
            return Err(Error::value(*what, format!("a look with {effect}: varied or photo"), "a look without it"));
        }
        Ok(effects)
    }
}
