//! A robot as its YAML file has it; every key but `robot` and `model` may be left out.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::hand::Side;

/// Names of the human fingers, thumb to little.
pub const FINGERS: [&str; 5] = ["thumb", "index", "middle", "ring", "little"];

/// A robot's YAML file. Unknown keys are refused.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spec {
    /// Id, for files and messages.
    pub robot: String,
    /// The model.
    #[serde(default)]
    pub model: ModelSpec,
    /// Which hand it is; without it, by the names in the model or by the way the fingers bend.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub side: Option<Side>,
    /// The wrist frame.
    #[serde(default, skip_serializing_if = "WristSpec::is_default")]
    pub wrist: WristSpec,
    /// Human finger -> robot finger; empty = by names, else by geometry.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub fingers: BTreeMap<String, FingerSpec>,
    /// Human finger -> human finger that takes over its force.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub merge: BTreeMap<String, String>,
    /// Robot metres per human metre.
    #[serde(default)]
    pub scale: Scale,
    /// Joints that follow others, beside those that the model itself couples.
    #[serde(default)]
    pub couplings: Couplings,
    /// Joints that stand still, at a position (rad or m).
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub fixed_joints: BTreeMap<String, f64>,
    /// Positions to which joints lean that nothing else decides (rad or m).
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub neutral: BTreeMap<String, f64>,
    /// What counts how much.
    #[serde(default)]
    pub weights: Weights,
    /// Limits beyond the model's.
    #[serde(default)]
    pub limits: Limits,
    /// Links that must not run into each other.
    #[serde(default)]
    pub collision: Collision,
    /// Touch.
    #[serde(default)]
    pub contact: Contact,
    /// Smoothing and outliers.
    #[serde(default)]
    pub filter: FilterSpec,
    /// What is given out.
    #[serde(default)]
    pub output: OutputSpec,
}

/// Where the model is.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelSpec {
    /// MJCF file: absolute, beside the YAML file, or below a folder where models are looked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mjcf: Option<PathBuf>,
    /// URDF file, likewise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub urdf: Option<PathBuf>,
    /// Body that carries the fingers; without it, the lowest one that all fingers share.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub root: Option<String>,
}

/// The wrist frame.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WristSpec {
    /// Body it is fixed to; without it, the model's root.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body: Option<String>,
    /// The point that is the human's wrist, in the body's frame, m, where `scale` is a number; without it, the bases of the
    /// fingers are laid over the human's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pos: Option<[f64; 3]>,
    /// Axes.
    #[serde(default)]
    pub frame: Axes,
}

impl WristSpec {
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// Axes of the wrist frame.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Axes {
    /// From the model.
    #[default]
    #[serde(with = "auto")]
    Auto,
    /// Rows palmar, radial, distal, in the body's frame.
    Rows([[f64; 3]; 3]),
}

/// A robot finger.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FingerSpec {
    /// Its tip.
    pub tip: TipSpec,
    /// Bodies from base to tip that carry the proximal and middle phalanx; without it, by the joints.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub links: Vec<String>,
    /// Geoms of the fingertip; without it, all of the tip's link.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub pad_geoms: Vec<String>,
    /// Outward normal of the pad in the tip body's frame; without it, across the last phalanx on the palm's side.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pad_normal: Option<[f64; 3]>,
}

/// Where a finger ends: one of body, site or geom.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TipSpec {
    /// A body.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body: Option<String>,
    /// A site.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub site: Option<String>,
    /// A geom.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub geom: Option<String>,
    /// The tip in the body's frame, m; without it, a site is the tip, and of a body or geom it is the far end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pos: Option<[f64; 3]>,
}

/// Robot metres per human metre.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Scale {
    /// Each robot finger's length over that of the human finger, as it is seen.
    #[default]
    #[serde(with = "auto")]
    Auto,
    /// One number, whatever the human hand's size.
    Number(f64),
    /// By human finger.
    Fingers(BTreeMap<String, f64>),
}

/// Joints that follow others.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Couplings {
    /// Those of the model.
    #[default]
    #[serde(with = "auto")]
    Auto,
    /// Those of the model and these.
    More(Vec<CouplingSpec>),
}

/// A joint that follows another: joint = ratio * of + offset.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CouplingSpec {
    /// The joint that follows.
    pub joint: String,
    /// The joint it follows.
    pub of: String,
    /// Ratio.
    pub ratio: f64,
    /// Offset, rad or m.
    #[serde(default)]
    pub offset: f64,
}

/// What counts how much; the tips' distance counts as metres, angles as 0.1 m per radian.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Weights {
    /// Fingertips where the human's are.
    pub tip: f64,
    /// Pads of touched fingertips turned as the human's.
    pub pad_normal: f64,
    /// Touching pairs of fingers as far apart as the human's.
    pub pinch: f64,
    /// Touching pairs of fingers meeting from where the human's press each other.
    pub facing: f64,
    /// Phalanges turned as the human's.
    pub posture: f64,
    /// Joints near their neutral positions.
    pub neutral: f64,
    /// Joints near where they were a frame ago; more than 0 makes results depend on the past.
    pub smooth: f64,
}

impl Default for Weights {
    fn default() -> Self {
        Self { tip: 1.0, pad_normal: 0.05, pinch: 1000.0, facing: 3.0, posture: 0.3, neutral: 1e-4, smooth: 0.0 }
    }
}

/// Limits beyond the model's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Distance kept from the model's joint limits, rad or m.
    pub margin: f64,
    /// Speed of a joint at most, rad/s (slides: a tenth of it in m/s).
    pub velocity: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { margin: 0.0, velocity: 10.0 }
    }
}

/// Links that must not run into each other.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Collision {
    /// Which pairs.
    pub pairs: Pairs,
    /// Distance kept, m.
    pub margin: f64,
    /// Pairs of bodies that may touch.
    pub ignore: Vec<[String; 2]>,
}

impl Default for Collision {
    fn default() -> Self {
        Self { pairs: Pairs::Auto, margin: 0.0005, ignore: Vec::new() }
    }
}

/// Which pairs of links are kept apart.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Pairs {
    /// All geoms that the model lets collide, of different fingers or of a finger and the palm.
    #[default]
    Auto,
    /// None.
    None,
}

/// Touch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Contact {
    /// Which parts of the robot take force.
    pub regions: Regions,
    /// Friction coefficient of the robot's skin.
    pub friction: f64,
    /// Most normal force of a link, N; without it, only the actuators limit it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_force: Option<f64>,
}

impl Default for Contact {
    fn default() -> Self {
        Self { regions: Regions::Palm, friction: 0.8, max_force: None }
    }
}

/// Which parts of the robot take force; each choice holds those before it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Regions {
    /// Fingertips.
    Fingertips,
    /// All phalanges.
    Phalanges,
    /// The palm too.
    #[default]
    Palm,
}

/// Smoothing and outliers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FilterSpec {
    /// Delay of slow motion behind the input, s; 0 = no smoothing.
    pub time_constant: f64,
    /// A keypoint further than this from where it was expected is left out at first, m; 0 = none is.
    pub outlier: f64,
}

impl Default for FilterSpec {
    fn default() -> Self {
        Self { time_constant: 0.03, outlier: 0.03 }
    }
}

/// What is given out.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OutputSpec {
    /// Order of `ctrl`.
    pub order: Order,
}

/// Order of the commands.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Order {
    /// The model's actuators; of a model without any, the joints that are free to move.
    #[default]
    Actuators,
    /// The joints that are free to move.
    Joints,
}

impl Spec {
    /// Reads a YAML text.
    ///
    /// # Errors
    /// If it is no YAML, has an unknown key or a value outside its range.
    pub fn parse(text: &str) -> Result<Self> {
        let spec: Self = serde_yaml::from_str(text).map_err(|e| Error::value("robot file", "a robot in YAML", e))?;
        spec.check()?;
        Ok(spec)
    }

    fn check(&self) -> Result<()> {
        for finger in self.fingers.keys().chain(self.merge.keys()).chain(self.merge.values()) {
            finger_index(finger)?;
        }
        let Weights { tip, pad_normal, pinch, facing, posture, neutral, smooth } = self.weights;
        let checks = [
            ("weights.tip", tip, 0.0, 1e6),
            ("weights.pad_normal", pad_normal, 0.0, 1e6),
            ("weights.pinch", pinch, 0.0, 1e6),
            ("weights.facing", facing, 0.0, 1e6),
            ("weights.posture", posture, 0.0, 1e6),
            ("weights.neutral", neutral, 0.0, 1e6),
            ("weights.smooth", smooth, 0.0, 1e6),
            ("limits.margin", self.limits.margin, 0.0, 1.0),
            ("limits.velocity", self.limits.velocity, 1e-3, 1e3),
            ("collision.margin", self.collision.margin, 0.0, 0.02),
            ("contact.friction", self.contact.friction, 0.01, 10.0),
            ("contact.max_force", self.contact.max_force.unwrap_or(1.0), 0.0, 1e6),
            ("filter.time_constant", self.filter.time_constant, 0.0, 2.0),
            ("filter.outlier", self.filter.outlier, 0.0, 1.0),
        ];
        for (name, value, least, most) in checks {
            if !(least..=most).contains(&value) {
                return Err(Error::value(name, format!("{least} to {most}"), value));
            }
        }
        let scales: Vec<f64> = match &self.scale {
            Scale::Auto => Vec::new(),
            Scale::Number(scale) => vec![*scale],
            Scale::Fingers(scales) => {
                scales.keys().try_for_each(|finger| finger_index(finger).map(|_| ()))?;
                scales.values().copied().collect()
            }
        };
        match scales.iter().find(|scale| !(0.05..=20.0).contains(*scale)) {
            Some(bad) => Err(Error::value("scale", "0.05 to 20", bad)),
            None => Ok(()),
        }
    }
}

/// Index of a human finger, thumb 0 to little 4.
///
/// # Errors
/// If there is no such finger.
pub fn finger_index(name: &str) -> Result<usize> {
    FINGERS.iter().position(|finger| *finger == name).ok_or_else(|| Error::unknown("finger", name, FINGERS))
}

/// The word `auto`.
mod auto {
    use serde::{Deserialize, Deserializer, Serializer, de::Error as _};

    pub fn serialize<S: Serializer>(serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str("auto")
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<(), D::Error> {
        match String::deserialize(deserializer)?.as_str() {
            "auto" => Ok(()),
            other => Err(D::Error::custom(format!("expected auto, got {other:?}"))),
        }
    }
}
