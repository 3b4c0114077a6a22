//! Look of a scene: colours, lights, and what covers the hands.

use serde::{Deserialize, Serialize};

use super::limits::within;
use crate::error::{Error, Result};
use crate::sim::effect::{Effect, EffectSet};
use crate::sim::range::UniformRange;

/// Look of a scene, from which each seed draws; the defaults are those of the shipped scenes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LookSpec {
    /// Effects that make pictures richer.
    pub style: LookStyle,
    /// Covering of both hands.
    pub hands: HandLook,
    /// Patterns of the table, of which each seed takes one.
    pub table_patterns: Vec<TablePattern>,
    /// Saturation of the table's colours, 0 to 1.
    pub table_saturation: UniformRange,
    /// Saturation of background and floor, 0 to 1; without it 0 to 0.4 and 0 to 0.5.
    pub surroundings_saturation: Option<UniformRange>,
    /// Brightness of the ambient light, 0 to 1.
    pub ambient: UniformRange,
    /// Factor on the brightness of both lamps.
    pub lamps: UniformRange,
    /// Height of the lamps above the table, m.
    pub lamp_height: UniformRange,
}

/// Set of effects that make pictures richer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LookStyle {
    /// None of them: colours without texture.
    #[default]
    Plain,
    /// Painted skin and gloves, textures, clutter, more lamps, shade in creases.
    Varied,
    /// All of them: also the wearer, other cameras, their rolling shutter, and the processing of a real camera.
    Photo,
}

impl LookStyle {
    /// Effects of the richest style.
    const ALL: [Effect; 9] = [
        Effect::SkinDetail,
        Effect::Textures,
        Effect::Clutter,
        Effect::MoreLamps,
        Effect::AmbientOcclusion,
        Effect::Wearer,
        Effect::OtherCamera,
        Effect::RollingShutter,
        Effect::CameraProcessing,
    ];
    /// Number of them that the varied style has, from the first one.
    const VARIED: usize = 5;

    /// Returns the style of this name.
    ///
    /// # Errors
    /// If the name is unknown.
    pub fn from_name(name: &str) -> Result<Self> {
        let all = [Self::Plain, Self::Varied, Self::Photo];
        let found = all.into_iter().find(|style| style.name() == name);
        found.ok_or_else(|| Error::unknown("look", name, all.map(Self::name)))
    }

    /// Returns the name, as in YAML.
    pub fn name(self) -> &'static str {
        match self {
            Self::Plain => "plain",
            Self::Varied => "varied",
            Self::Photo => "photo",
        }
    }

    /// Returns the effects of this style.
    pub fn effects(self) -> EffectSet {
        let count = match self {
            Self::Plain => 0,
            Self::Varied => Self::VARIED,
            Self::Photo => Self::ALL.len(),
        };
        Self::ALL[..count].iter().copied().collect()
    }
}

/// Covering of the hands in the picture. Touch and collision are those of the bare hand in all cases.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum HandLook {
    /// Skin.
    #[default]
    Bare,
    /// Dark, matt glove, 1.5 mm thick, with a grid of sensor pads.
    Glove,
    /// The glove, painted in the tone of the person's skin: the best that recolouring a picture can reach, since the
    /// edge of the glove is exactly known.
    Recoloured,
}

/// Pattern of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TablePattern {
    /// One colour.
    Flat,
    /// Squares of two colours.
    Checker,
    /// Gradient between two colours.
    Gradient,
}

impl TablePattern {
    /// Returns the engine's name.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Flat => "flat",
            Self::Checker => "checker",
            Self::Gradient => "gradient",
        }
    }
}

impl Default for LookSpec {
    fn default() -> Self {
        Self {
            style: LookStyle::Plain,
            hands: HandLook::Bare,
            table_patterns: vec![TablePattern::Flat, TablePattern::Checker, TablePattern::Gradient],
            table_saturation: UniformRange::new(0.05, 0.55),
            surroundings_saturation: None,
            ambient: UniformRange::new(0.2, 0.4),
            lamps: UniformRange::fixed(1.0),
            lamp_height: UniformRange::new(0.9, 1.8),
        }
    }
}

impl LookSpec {
    /// Checks ranges.
    pub(super) fn check(&self) -> Result<()> {
        if self.table_patterns.is_empty() {
            return Err(Error::value("look.table_patterns", "at least one of flat, checker, gradient", "none"));
        }
        within("look.table_saturation", self.table_saturation, 0.0, 1.0)?;
        if let Some(saturation) = self.surroundings_saturation {
            within("look.surroundings_saturation", saturation, 0.0, 1.0)?;
        }
        within("look.ambient", self.ambient, 0.0, 1.0)?;
        within("look.lamps", self.lamps, 0.0, 10.0)?;
        within("look.lamp_height", self.lamp_height, 0.1, 10.0)
    }
}
