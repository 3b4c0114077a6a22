//! A scene as its YAML file gives it.

use serde::{Deserialize, Serialize};

use super::act::ActSpec;
use super::limits::zero;
use super::look::LookSpec;
use super::object::ObjectSpec;
use crate::mujoco::PhysicsOptions;
use crate::sensor::GloveSpec;
use crate::sim::effect::{EffectsSpec, Observation};
use crate::sim::range::UniformRange;

/// Content of a scene file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneSpec {
    /// One sentence for `egotac sim list`.
    pub description: String,
    /// Frames per second; a frame lasts a whole number of physics steps.
    #[serde(default = "default_rate")]
    pub rate: f64,
    /// Observations to record.
    #[serde(default = "Observation::usual")]
    pub observe: Vec<Observation>,
    /// Effects to simulate: `auto` (the fewest that deliver the observations), or a list.
    #[serde(default)]
    pub effects: EffectsSpec,
    /// Physics options.
    #[serde(default)]
    pub physics: PhysicsOptions,
    /// Objects on the table.
    pub objects: Vec<ObjectSpec>,
    /// Number of additional objects on the table that no hand touches.
    #[serde(default = "zero")]
    pub distractors: UniformRange,
    /// One or two hands; the first one acts, the second one is idle unless it has an `act`.
    pub hands: Vec<HandSpec>,
    /// Head-mounted camera.
    #[serde(default)]
    pub camera: CameraSpec,
    /// Colours, lights, covering of the hands.
    #[serde(default)]
    pub look: LookSpec,
    /// Tactile gloves on both hands, whose taxels are recorded; none by default.
    #[serde(default)]
    pub glove: Option<GloveSpec>,
}

impl SceneSpec {
    /// True if an object deforms.
    pub fn has_soft_object(&self) -> bool {
        self.objects.iter().any(|object| object.shape.is_soft())
    }
}

/// A hand and its act.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HandSpec {
    /// Left or right; the second hand of a scene is always the other one.
    #[serde(default)]
    pub side: SideSpec,
    /// Probability that the hand is present.
    #[serde(default = "one")]
    pub presence: f64,
    /// Contact goals and script; without it the hand is held still above the table.
    pub act: Option<ActSpec>,
}

/// Side of the acting hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SideSpec {
    /// Left hand.
    Left,
    /// Right hand.
    Right,
    /// Drawn at random; the scene is mirrored for the left hand.
    #[default]
    Either,
}

/// Head-mounted camera; positions are in the world frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraSpec {
    /// Position of the eye, m.
    pub eye: [UniformRange; 3],
    /// Point in the middle of the picture, m.
    pub target: [UniformRange; 3],
    /// Vertical field of view, degrees.
    pub fovy: UniformRange,
    /// Tilt of the head, rad.
    pub roll: UniformRange,
    /// Amplitude of the head's slow motion, m.
    pub sway: UniformRange,
    /// Standard deviation of the sensor noise, in units of the 8-bit picture.
    pub noise: UniformRange,
    /// Radial distortion k1 and k2 of the lens, as in `plumb_bob`; a negative k1 is a barrel distortion.
    pub distortion: [UniformRange; 2],
    /// Exposure time, s; it ends at the frame's instant, and motion during it blurs the picture.
    pub shutter: UniformRange,
}

impl Default for CameraSpec {
    fn default() -> Self {
        Self {
            eye: [UniformRange::new(-0.06, 0.06), UniformRange::new(-0.36, -0.26), UniformRange::new(0.38, 0.48)],
            target: [UniformRange::new(-0.02, 0.02), UniformRange::new(-0.03, 0.03), UniformRange::new(0.02, 0.06)],
            fovy: UniformRange::new(40.0, 50.0),
            roll: UniformRange::new(-0.06, 0.06),
            sway: UniformRange::new(0.0, 0.008),
            noise: zero(),
            distortion: [zero(); 2],
            shutter: zero(),
        }
    }
}

fn default_rate() -> f64 {
    25.0
}

fn one() -> f64 {
    1.0
}
