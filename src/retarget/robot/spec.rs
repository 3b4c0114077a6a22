//! Schema of a robot's YAML file. Every key but `robot` is optional.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::hand::Side;
use crate::text::parse_yaml;

/// Names of the human fingers, thumb to little.
pub const FINGERS: [&str; 5] = ["thumb", "index", "middle", "ring", "little"];

/// Content of a robot's YAML file. Unknown keys are errors.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotSpec {
    /// Name, for files and messages.
    pub robot: String,
    /// Location of the model: exactly one of `mjcf` and `urdf`, or none if `--model` names it.
    #[serde(default)]
    pub model: ModelSpec,
    /// Side of the hand, `left` or `right`; by default the side to whose palm the fingers close.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub side: Option<Side>,
    /// Wrist frame; by default derived from the fingers and the direction in which they close.
    #[serde(default, skip_serializing_if = "WristSpec::is_default")]
    pub wrist: WristSpec,
    /// Robot finger of each human finger; by default found by the names in the model, otherwise by geometry.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub fingers: BTreeMap<String, FingerSpec>,
    /// For a human finger that the robot lacks, the human finger whose robot finger takes its force, as
    /// in `little: ring`; by default the nearest.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub merge: BTreeMap<String, String>,
    /// Robot metres per human metre (`scaling_factor` of dex-retargeting): one number, one for each human finger, or `auto`, the
    /// length of each robot finger over the measured length of the human finger.
    #[serde(default)]
    pub scale: ScaleSpec,
    /// List of couplings beside those of the model (equalities, mimic joints, actuated tendons), or `auto`, those of the model
    /// alone. A coupling is `joint = ratio * of + offset`.
    #[serde(default)]
    pub couplings: CouplingsSpec,
    /// Positions of joints that stand still, rad or m, by the joints' names. Joints of the arm that carries the hand also stand still.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub fixed_joints: BTreeMap<String, f64>,
    /// Positions to which joints tend if no other term of the cost determines them, rad or m, by the joints' names; by default
    /// the rest pose.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub neutral: BTreeMap<String, f64>,
    /// Weights of the cost's terms. Distances count in metres, angles as 0.1 m per radian.
    #[serde(default)]
    pub weights: Weights,
    /// Limits beside the model's.
    #[serde(default)]
    pub limits: LimitSpec,
    /// Links that must not penetrate each other.
    #[serde(default)]
    pub collision: CollisionSpec,
    /// Parts that take force.
    #[serde(default)]
    pub contact: ContactSpec,
    /// Smoothing and outlier rejection.
    #[serde(default)]
    pub filter: FilterSpec,
    /// Output.
    #[serde(default)]
    pub output: OutputSpec,
}

/// Location of the model.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelSpec {
    /// MJCF file: absolute, or relative to the YAML file or a folder that is searched for models.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mjcf: Option<PathBuf>,
    /// URDF file, in the same form.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub urdf: Option<PathBuf>,
    /// Body that carries the fingers; by default the lowest one that all fingers share.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub root: Option<String>,
}

/// Wrist frame.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WristSpec {
    /// Body that the frame is fixed to (`wrist_link_name` of dex-retargeting); by default the model's root.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body: Option<String>,
    /// Position of the human's wrist in the body's frame, m, if `scale` is a number; by default the bases of the robot's
    /// and the human's fingers coincide on average.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pos: Option<[f64; 3]>,
    /// Axes: rows palmar, radial, distal in the body's frame, or `auto`, derived from the model.
    #[serde(default)]
    pub frame: WristAxes,
}

impl WristSpec {
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// Axes of the wrist frame.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum WristAxes {
    /// Derived from the model.
    #[default]
    #[serde(with = "auto")]
    Auto,
    /// Rows palmar, radial, distal, in the body's frame.
    Rows([[f64; 3]; 3]),
}

/// Robot finger.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FingerSpec {
    /// Tip: exactly one of body (`target_link_names` of dex-retargeting), site or geom.
    pub tip: TipSpec,
    /// Bodies from base to tip that carry the proximal and middle phalanx; by default derived from the joints.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub links: Vec<String>,
    /// Geoms of the fingertip; by default all of the tip's link.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub pad_geoms: Vec<String>,
    /// Outward normal of the pad in the tip body's frame; by default across the last phalanx, in the direction of closing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pad_normal: Option<[f64; 3]>,
}

/// Tip of a finger: exactly one of body (`target_link_names` of dex-retargeting), site or geom.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TipSpec {
    /// Name of a body.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body: Option<String>,
    /// Name of a site.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub site: Option<String>,
    /// Name of a geom.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub geom: Option<String>,
    /// Position of the tip in the body's frame, m; by default the site's, or the far end of the body's or geom's shapes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pos: Option<[f64; 3]>,
}

/// Robot metres per human metre.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum ScaleSpec {
    /// Length of each robot finger over the measured length of the human finger.
    #[default]
    #[serde(with = "auto")]
    Auto,
    /// One number for all fingers, independent of the size of the human hand.
    Number(f64),
    /// One number for each human finger.
    Fingers(BTreeMap<String, f64>),
}

/// Couplings of joints.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum CouplingsSpec {
    /// Those of the model.
    #[default]
    #[serde(with = "auto")]
    Auto,
    /// Those of the model and these.
    More(Vec<CouplingSpec>),
}

/// Coupling of one joint to another: joint = ratio * of + offset.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CouplingSpec {
    /// Joint that follows.
    pub joint: String,
    /// Joint that leads.
    pub of: String,
    /// Change of `joint` per change of `of`.
    pub ratio: f64,
    /// Offset, rad or m.
    #[serde(default)]
    pub offset: f64,
}

/// Weights of the cost's terms. Distances count in metres, angles as 0.1 m per radian.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Weights {
    /// Positions of the fingertips.
    pub tip: f64,
    /// Orientations of the pads of touched fingertips.
    pub pad_normal: f64,
    /// Distances between thumb and fingertips.
    pub pinch: f64,
    /// Directions in which touching thumb and fingertip press each other.
    pub facing: f64,
    /// Directions of the phalanges.
    pub posture: f64,
    /// Distances of the free coordinates from their neutral positions.
    pub neutral: f64,
    /// Distances of the free coordinates from the last frame's; above 0, results depend on the past.
    pub smooth: f64,
}

impl Default for Weights {
    fn default() -> Self {
        Self { tip: 1.0, pad_normal: 0.05, pinch: 1000.0, facing: 3.0, posture: 0.3, neutral: 1e-4, smooth: 0.0 }
    }
}

/// Limits beside the model's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LimitSpec {
    /// Distance to keep from the model's joint limits, rad or m.
    pub margin: f64,
    /// Greatest speed of a hinge, rad/s; a slide's, in m/s, is a tenth of the number.
    pub velocity: f64,
}

impl Default for LimitSpec {
    fn default() -> Self {
        Self { margin: 0.0, velocity: 10.0 }
    }
}

/// Links that must not penetrate each other.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CollisionSpec {
    /// Pairs of links that are kept apart: `auto` (all that the model lets collide, of different fingers or of a finger and the
    /// palm) or `none`.
    pub pairs: PairSelection,
    /// Distance to keep, m.
    pub margin: f64,
    /// Pairs of bodies that may penetrate each other.
    pub ignore: Vec<[String; 2]>,
}

impl Default for CollisionSpec {
    fn default() -> Self {
        Self { pairs: PairSelection::Auto, margin: 0.0005, ignore: Vec::new() }
    }
}

/// Selection of the pairs of links that are kept apart.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PairSelection {
    /// All geoms that the model lets collide, of different fingers or of a finger and the palm.
    #[default]
    Auto,
    /// No pairs.
    None,
}

/// Parts of the robot that take force.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ContactSpec {
    /// Regions that take force; each choice includes those before it.
    pub regions: ContactRegions,
    /// Friction coefficient of the robot's skin.
    pub friction: f64,
    /// Greatest normal force of a link, N; by default limited by the actuators only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_force: Option<f64>,
}

impl Default for ContactSpec {
    fn default() -> Self {
        Self { regions: ContactRegions::Palm, friction: 0.8, max_force: None }
    }
}

/// Regions of the robot that take force; each choice includes those before it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ContactRegions {
    /// Fingertips.
    Fingertips,
    /// All phalanges.
    Phalanges,
    /// All phalanges and the palm.
    #[default]
    Palm,
}

/// Smoothing and outlier rejection.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FilterSpec {
    /// Delay of slow motion behind the input, s; 0 = no smoothing. (`low_pass_alpha` of dex-retargeting smooths per frame, so
    /// its delay depends on the frame rate.)
    pub time_constant: f64,
    /// Distance from its expected position at which a keypoint counts as an outlier, m; 0 = never.
    pub outlier: f64,
}

impl Default for FilterSpec {
    fn default() -> Self {
        Self { time_constant: 0.03, outlier: 0.03 }
    }
}

/// Output.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OutputSpec {
    /// Order of `ctrl`: that of the model's actuators, if all are position servos (otherwise as `joints`), or that of the joints
    /// of the free coordinates.
    pub order: CommandOrder,
}

/// Order of the commands.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CommandOrder {
    /// The model's actuators, if all are position servos; otherwise as `joints`.
    #[default]
    Actuators,
    /// The master joints of the free coordinates.
    Joints,
}

impl RobotSpec {
    /// Parses and checks a YAML text.
    ///
    /// # Errors
    /// If it is not YAML, has an unknown key or a value outside its range.
    pub fn parse(text: &str) -> Result<Self> {
        let spec: Self = parse_yaml(text).map_err(|e| Error::value("robot file", "a robot in YAML", e))?;
        spec.check()?;
        Ok(spec)
    }

    /// Checks names of fingers and ranges of values.
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
            ScaleSpec::Auto => Vec::new(),
            ScaleSpec::Number(scale) => vec![*scale],
            ScaleSpec::Fingers(scales) => {
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

/// Returns the index of a human finger, thumb 0 to little 4.
///
/// # Errors
/// If there is no such finger.
pub fn finger_index(name: &str) -> Result<usize> {
    FINGERS.iter().position(|finger| *finger == name).ok_or_else(|| Error::unknown("finger", name, FINGERS))
}

/// Serialises a unit variant as the word `auto`.
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
