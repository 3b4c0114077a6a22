//! Choice of the hands of a scene, in place of the scene's own.

use super::spec::{SceneSpec, SideSpec};
use crate::error::{Error, Result};

/// Hands that a scene has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PresentHands {
    /// None: the objects lie as the scene puts them, and nothing is touched.
    None,
    /// The acting hand alone, as a left hand.
    Left,
    /// The acting hand alone, as a right hand.
    Right,
    /// All hands that the scene has, the idle ones always.
    Both,
}

impl PresentHands {
    /// Names of the choices.
    pub const NAMES: [&'static str; 4] = ["none", "left", "right", "both"];

    /// Returns the choice of this name.
    ///
    /// # Errors
    /// If the name is unknown.
    pub fn from_name(name: &str) -> Result<Self> {
        let all = [Self::None, Self::Left, Self::Right, Self::Both];
        let found = all.into_iter().zip(Self::NAMES).find(|(_, own)| *own == name);
        found.map(|(choice, _)| choice).ok_or_else(|| Error::unknown("hands", name, Self::NAMES))
    }

    /// Changes a scene. What else a seed draws stays the same, but that `left` and `right` mirror the scene for the other hand.
    pub fn apply(self, spec: &mut SceneSpec) {
        let Some((acting, others)) = spec.hands.split_first_mut() else { return };
        acting.presence = if self == Self::None { 0.0 } else { 1.0 };
        others.iter_mut().for_each(|hand| hand.presence = if self == Self::Both { 1.0 } else { 0.0 });
        acting.side = match self {
            Self::Left => SideSpec::Left,
            Self::Right => SideSpec::Right,
            Self::None | Self::Both => return,
        };
        others.iter_mut().for_each(|hand| hand.side = SideSpec::Either);
    }
}
