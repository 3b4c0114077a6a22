//! What a scene simulates: only the effects that it calls for, each with the reason.

mod plan;

use std::fmt;

use serde::{Deserialize, Serialize};

pub use plan::{EffectPlan, EffectsSpec};

use crate::error::{Error, Result};

/// Something that can be simulated, or left away.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Effect {
    /// Masses, servos and forces; without it hands follow their plan and objects stay where they are.
    Dynamics,
    /// Detection of touching bodies and, with dynamics, the forces between them.
    RigidContact,
    /// Sliding friction.
    Friction,
    /// Friction against spinning about the contact's normal.
    TorsionalFriction,
    /// Weight.
    Gravity,
    /// Joints inside objects: buttons, knobs, doors.
    Articulation,
    /// Elastic objects, as finite elements.
    SoftBody,
    /// Bodies at rest that are left out until something moves them; their contacts leave the list meanwhile.
    Sleep,
    /// Detection of pairs within 1 cm, without force.
    NearContact,
    /// Pictures; without it no OpenGL context is made.
    Rendering,
    /// Shadows in the picture.
    Shadows,
    /// A lens that bends straight lines.
    LensDistortion,
    /// Noise of the camera's sensor.
    SensorNoise,
    /// Blur by motion while the shutter is open.
    MotionBlur,
}

impl Effect {
    /// All effects, in the order in which tables show them.
    pub const ALL: [Effect; 14] = [
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
    ];

    /// Its name, as in YAML.
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
        }
    }

    /// Effects without which it means nothing.
    pub fn needs(self) -> &'static [Effect] {
        match self {
            Self::Dynamics | Self::RigidContact | Self::Rendering => &[],
            Self::Friction => &[Self::Dynamics, Self::RigidContact],
            Self::TorsionalFriction => &[Self::Friction],
            Self::Gravity | Self::Articulation => &[Self::Dynamics],
            Self::SoftBody | Self::Sleep => &[Self::Dynamics, Self::RigidContact],
            Self::NearContact => &[Self::RigidContact],
            Self::Shadows | Self::LensDistortion | Self::SensorNoise | Self::MotionBlur => &[Self::Rendering],
        }
    }
}

/// Something that a scene records.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Observation {
    /// The camera's picture.
    Rgb,
    /// Distance from the camera per pixel, m.
    Depth,
    /// Poses of hands and objects.
    Pose,
    /// Which vertices touch.
    Contact,
    /// Normal force per vertex, N.
    Force,
    /// Speed at which touching surfaces slide, per vertex, m/s.
    Slip,
}

impl Observation {
    /// What is recorded unless the scene says otherwise.
    pub fn usual() -> Vec<Self> {
        vec![Self::Rgb, Self::Pose, Self::Contact, Self::Force]
    }

    /// Its name, as in YAML.
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

    /// Effects without which there is nothing to record.
    pub fn needs(self) -> &'static [Effect] {
        match self {
            Self::Rgb | Self::Depth => &[Effect::Rendering],
            Self::Pose => &[],
            Self::Contact => &[Effect::RigidContact],
            Self::Force | Self::Slip => &[Effect::Dynamics, Effect::RigidContact],
        }
    }
}

/// A set of effects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct EffectSet(u16);

impl EffectSet {
    /// Whether `effect` is in it.
    pub fn contains(self, effect: Effect) -> bool {
        self.0 & (1 << effect as u16) != 0
    }

    /// The set with `effect` in it.
    #[must_use]
    pub fn with(self, effect: Effect) -> Self {
        Self(self.0 | 1 << effect as u16)
    }

    /// The set without `effect`.
    #[must_use]
    pub fn without(self, effect: Effect) -> Self {
        Self(self.0 & !(1 << effect as u16))
    }

    /// Its effects, in the order of [`Effect::ALL`].
    pub fn iter(self) -> impl Iterator<Item = Effect> {
        Effect::ALL.into_iter().filter(move |effect| self.contains(*effect))
    }

    /// Checks that no effect lacks what it needs.
    ///
    /// # Errors
    /// If one does; the error names both.
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
