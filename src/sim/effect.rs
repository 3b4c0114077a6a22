//! Effects that can be simulated, and observations that need them.

use std::fmt;

use serde::de::{self, Deserializer};
use serde::{Deserialize, Serialize, Serializer};

use crate::error::{Error, Result};

/// Part of the physics or of the picture that can be switched on and off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Effect {
    /// Masses, servos and forces; without it hands follow their plan and objects do not move.
    Dynamics,
    /// Collision detection and, with dynamics, contact forces.
    RigidContact,
    /// Sliding friction.
    Friction,
    /// Friction against rotation about the contact normal.
    TorsionalFriction,
    /// Gravity.
    Gravity,
    /// Joints of objects: buttons, knobs, doors.
    Articulation,
    /// Elastic objects as finite elements.
    SoftBody,
    /// Exclusion of bodies at rest until something moves them; their contacts are not listed meanwhile.
    Sleep,
    /// Detection of pairs within 1 cm that exert no force.
    NearContact,
    /// Pictures; without it no OpenGL context is created.
    Rendering,
    /// Shadows in the picture.
    Shadows,
    /// Radial distortion by the lens.
    LensDistortion,
    /// Noise of the camera sensor.
    SensorNoise,
    /// Blur by motion during the exposure time.
    MotionBlur,
    /// Painted skin with nails, or gloves of several kinds.
    SkinDetail,
    /// Procedural textures of table, floor, walls and objects.
    Textures,
    /// Objects in the background, which nothing touches.
    Clutter,
    /// Less light in creases and where one surface lies close to another.
    AmbientOcclusion,
    /// The camera's wearer: trunk, legs, trackers and wires.
    Wearer,
    /// Further lamps of warm and cold colours.
    MoreLamps,
    /// Other head cameras: their place, and the width of their view.
    OtherCamera,
    /// Rows of a picture that are read one after the other.
    RollingShutter,
    /// Exposure, white balance, tone curve, vignetting and JPEG.
    CameraProcessing,
}

impl Effect {
    /// All effects, in the order of tables.
    pub const ALL: [Effect; 23] = [
        Self::Dynamics,
        Self::RigidContact,
        Self::Friction,
        Self::TorsionalFriction,
        Self::Gravity,
        Self::Articulation,
        Self::SoftBody,
        Self::Sleep,
        Self::NearContact,
        Self::Rendering,
        Self::Shadows,
        Self::LensDistortion,
        Self::SensorNoise,
        Self::MotionBlur,
        Self::SkinDetail,
        Self::Textures,
        Self::Clutter,
        Self::AmbientOcclusion,
        Self::Wearer,
        Self::MoreLamps,
        Self::OtherCamera,
        Self::RollingShutter,
        Self::CameraProcessing,
    ];

    /// Returns the name, as in YAML.
    pub fn name(self) -> &'static str {
        match self {
            Self::Dynamics => "dynamics",
            Self::RigidContact => "rigid_contact",
            Self::Friction => "friction",
            Self::TorsionalFriction => "torsional_friction",
            Self::Gravity => "gravity",
            Self::Articulation => "articulation",
            Self::SoftBody => "soft_body",
            Self::Sleep => "sleep",
            Self::NearContact => "near_contact",
            Self::Rendering => "rendering",
            Self::Shadows => "shadows",
            Self::LensDistortion => "lens_distortion",
            Self::SensorNoise => "sensor_noise",
            Self::MotionBlur => "motion_blur",
            Self::SkinDetail => "skin_detail",
            Self::Textures => "textures",
            Self::Clutter => "clutter",
            Self::AmbientOcclusion => "ambient_occlusion",
            Self::Wearer => "wearer",
            Self::MoreLamps => "more_lamps",
            Self::OtherCamera => "other_camera",
            Self::RollingShutter => "rolling_shutter",
            Self::CameraProcessing => "camera_processing",
        }
    }

    /// Returns the effects that this effect requires.
    pub fn needs(self) -> &'static [Effect] {
        match self {
            Self::Dynamics | Self::RigidContact | Self::Rendering => &[],
            Self::Friction => &[Self::Dynamics, Self::RigidContact],
            Self::TorsionalFriction => &[Self::Friction],
            Self::Gravity | Self::Articulation => &[Self::Dynamics],
            Self::SoftBody | Self::Sleep => &[Self::Dynamics, Self::RigidContact],
            Self::NearContact => &[Self::RigidContact],
            Self::Shadows | Self::LensDistortion | Self::SensorNoise | Self::MotionBlur => &[Self::Rendering],
            Self::SkinDetail | Self::Textures | Self::Clutter | Self::Wearer => &[Self::Rendering],
            Self::AmbientOcclusion | Self::MoreLamps => &[Self::Rendering],
            Self::OtherCamera | Self::RollingShutter | Self::CameraProcessing => &[Self::Rendering],
        }
    }
}

/// Quantity that a scene records.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Observation {
    /// Picture of the camera.
    Rgb,
    /// Distance from the camera plane per pixel, m.
    Depth,
    /// Poses of hands and objects.
    Pose,
    /// Contact per vertex.
    Contact,
    /// Normal force per vertex, N.
    Force,
    /// Sliding speed of touching surfaces per vertex, m/s.
    Slip,
}

impl Observation {
    /// Returns the observations of a scene that lists none.
    pub fn usual() -> Vec<Self> {
        vec![Self::Rgb, Self::Pose, Self::Contact, Self::Force]
    }

    /// Returns the name, as in YAML.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rgb => "rgb",
            Self::Depth => "depth",
            Self::Pose => "pose",
            Self::Contact => "contact",
            Self::Force => "force",
            Self::Slip => "slip",
        }
    }

    /// Returns the effects that this observation requires.
    pub fn needs(self) -> &'static [Effect] {
        match self {
            Self::Rgb | Self::Depth => &[Effect::Rendering],
            Self::Pose => &[],
            Self::Contact => &[Effect::RigidContact],
            Self::Force | Self::Slip => &[Effect::Dynamics, Effect::RigidContact],
        }
    }
}

/// Set of effects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct EffectSet(u32);

impl EffectSet {
    /// Returns true if `effect` is in the set.
    pub fn contains(self, effect: Effect) -> bool {
        self.0 & (1 << effect as u32) != 0
    }

    /// Returns the set with `effect` added.
    #[must_use]
    pub fn with(self, effect: Effect) -> Self {
        Self(self.0 | 1 << effect as u32)
    }

    /// Returns the set with `effect` removed.
    #[must_use]
    pub fn without(self, effect: Effect) -> Self {
        Self(self.0 & !(1 << effect as u32))
    }

    /// Iterates over the effects in the order of [`Effect::ALL`].
    pub fn iter(self) -> impl Iterator<Item = Effect> {
        Effect::ALL.into_iter().filter(move |effect| self.contains(*effect))
    }

    /// Checks that each effect has the effects it requires.
    ///
    /// # Errors
    /// If a required effect is missing; the error names both.
    pub fn check(self) -> Result<()> {
        for effect in self.iter() {
            if let Some(missing) = effect.needs().iter().find(|needed| !self.contains(**needed)) {
                return Err(Error::value("effects", format!("{missing}, which {effect} needs"), self));
            }
        }
        Ok(())
    }
}

impl FromIterator<Effect> for EffectSet {
    fn from_iter<I: IntoIterator<Item = Effect>>(effects: I) -> Self {
        effects.into_iter().fold(Self::default(), Self::with)
    }
}

impl fmt::Display for Effect {
    fn fmt(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

impl fmt::Display for EffectSet {
    fn fmt(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        let names: Vec<&str> = self.iter().map(Effect::name).collect();
        write!(formatter, "[{}]", names.join(", "))
    }
}

/// Effects as a scene file gives them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EffectsSpec {
    /// `auto`: the fewest effects that deliver the observations.
    #[default]
    Auto,
    /// List: these effects and no others.
    Listed(EffectSet),
}

impl Serialize for EffectsSpec {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        match self {
            Self::Auto => serializer.serialize_str("auto"),
            Self::Listed(effects) => serializer.collect_seq(effects.iter().map(Effect::name)),
        }
    }
}

impl<'de> Deserialize<'de> for EffectsSpec {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Written {
            Word(String),
            List(Vec<String>),
        }
        let expected = || {
            let names: Vec<&str> = Effect::ALL.into_iter().map(Effect::name).collect();
            format!("`auto` or a list of {}", names.join(", "))
        };
        let names = match Written::deserialize(deserializer) {
            Ok(Written::Word(word)) if word == "auto" => return Ok(Self::Auto),
            Ok(Written::Word(word)) => return Err(de::Error::custom(format!("expected {}, got {word:?}", expected()))),
            Ok(Written::List(names)) => names,
            Err(_) => return Err(de::Error::custom(format!("expected {}", expected()))),
        };
        let find = |name: &String| {
            let effect = Effect::ALL.into_iter().find(|effect| effect.name() == name);
            effect.ok_or_else(|| de::Error::custom(format!("expected {}, got {name:?}", expected())))
        };
        Ok(Self::Listed(names.iter().map(find).collect::<std::result::Result<EffectSet, D::Error>>()?))
    }
}
