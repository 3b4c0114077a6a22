//! Scenes: what lies on the table, which hands do what, from where it is seen; YAML, with ranges to draw from.

mod act;
mod object;
mod shipped;

use std::path::Path;

use serde::Deserialize;

pub use act::{ActSpec, Channels, ContactSpec, PhaseSpec, Site, WrapSpec};
pub use object::{ObjectSpec, ShapeSpec};
pub use shipped::SHIPPED;

use super::effect::{EffectPlan, EffectsSpec, Observation};
use super::object::mesh_faults;
use super::range::Span;
use crate::error::{Error, Result};
use crate::mujoco::PhysicsOptions;

/// Names that the world itself gives.
const RESERVED: [&str; 4] = ["head", "table", "floor", "sky"];
/// As many as find room around the place where the hands work.
const MOST_DISTRACTORS: f64 = 40.0;
/// No camera is farther away, m.
const FAR_EYE: f64 = 10.0;
/// Any rotation, rad, and some.
const TURN: f64 = 10.0;

/// A checked scene.
///
/// The world frame has its origin on the table's top; the person sits at negative y and looks along +y; z is up.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// Name: of the shipped scene, or of the file without its ending.
    pub name: String,
    /// Everything else.
    pub spec: SceneSpec,
}

/// A scene as written.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneSpec {
    /// One sentence for `egotac sim list`.
    pub description: String,
    /// Frames per second; a frame is a whole number of physics steps.
    #[serde(default = "default_rate")]
    pub rate: f64,
    /// What is wanted of it.
    #[serde(default = "Observation::usual")]
    pub observe: Vec<Observation>,
    /// What is simulated: `auto`, the least that gives what is wanted, or a list.
    #[serde(default)]
    pub effects: EffectsSpec,
    /// Physics.
    #[serde(default)]
    pub physics: PhysicsOptions,
    /// Objects on the table.
    pub objects: Vec<ObjectSpec>,
    /// How many things lie about that no hand deals with.
    #[serde(default = "zero")]
    pub distractors: Span,
    /// Hands; the first is the actor, another one is idle unless it has a script.
    pub hands: Vec<HandSpec>,
    /// The head-mounted camera.
    #[serde(default)]
    pub camera: CameraSpec,
}

/// A hand and what it does.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HandSpec {
    /// Which hand; the second hand of a scene is always the other one.
    #[serde(default)]
    pub side: SideSpec,
    /// Probability that the hand is there at all.
    #[serde(default = "one")]
    pub presence: f64,
    /// What it does; without it the hand is held still above the table.
    pub act: Option<ActSpec>,
}

/// Which hand acts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SideSpec {
    /// The left one.
    Left,
    /// The right one.
    Right,
    /// One of the two, by chance; the scene is mirrored for the left one.
    #[default]
    Either,
}

/// A camera on a head: where the eye is, what it looks at, in the world frame.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraSpec {
    /// Position of the eye, m.
    pub eye: [Span; 3],
    /// Point looked at, m.
    pub target: [Span; 3],
    /// Vertical field of view, degrees.
    pub fovy: Span,
    /// Tilt of the head, rad.
    pub roll: Span,
    /// Amplitude of the head's slow motion, m.
    pub sway: Span,
    /// Standard deviation of the sensor's noise, in steps of the 8-bit picture.
    pub noise: Span,
    /// Radial distortion k1 and k2 of the lens, as in `plumb_bob`; barrels have a negative k1.
    pub distortion: [Span; 2],
    /// How long the shutter is open before a frame's instant, s; what moves meanwhile is blurred.
    pub shutter: Span,
}

impl Default for CameraSpec {
    fn default() -> Self {
        Self {
            eye: [Span::new(-0.06, 0.06), Span::new(-0.36, -0.26), Span::new(0.38, 0.48)],
            target: [Span::new(-0.02, 0.02), Span::new(-0.03, 0.03), Span::new(0.02, 0.06)],
            fovy: Span::new(40.0, 50.0),
            roll: Span::new(-0.06, 0.06),
            sway: Span::new(0.0, 0.008),
            noise: zero(),
            distortion: [zero(); 2],
            shutter: zero(),
        }
    }
}

impl Scene {
    /// Loads a shipped scene by name, or a YAML file by path.
    ///
    /// # Errors
    /// If it is neither, can't be read, or is not a valid scene; the error names file, key and what was expected.
    pub fn load(name_or_path: &str) -> Result<Self> {
        if let Some((name, text)) = SHIPPED.iter().find(|(name, _)| *name == name_or_path) {
            return Self::parse(name, Path::new(name), text);
        }
        let path = Path::new(name_or_path);
        if !path.exists() {
            return Err(Error::unknown("scene", name_or_path, SHIPPED.iter().map(|(name, _)| *name)));
        }
        let text = std::fs::read_to_string(path).map_err(Error::io(path))?;
        let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        Self::parse(&stem, path, &text)
    }

    /// Reads a scene from YAML; `path` is for messages.
    ///
    /// # Errors
    /// If the text is not a valid scene.
    pub fn parse(name: &str, path: &Path, text: &str) -> Result<Self> {
        let mut spec: SceneSpec = serde_yaml::from_str(text).map_err(|e| Error::file(path, e))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        spec.objects.iter_mut().for_each(|object| object.shape.resolve(folder));
        let scene = Self { name: name.to_owned(), spec };
        scene.check().map_err(|e| Error::file(path, e))?;
        Ok(scene)
    }

    /// What is wrong with the mesh files of its objects, a line per file; empty where all are closed surfaces that
    /// face outwards.
    ///
    /// # Errors
    /// If a file can't be read or holds no surface.
    pub fn mesh_faults(&self) -> Result<Vec<String>> {
        let mut lines = Vec::new();
        for object in &self.spec.objects {
            if let ShapeSpec::Mesh { file, scale } = &object.shape {
                let faults = mesh_faults(file, scale.low())?;
                if !faults.is_empty() {
                    let faults: Vec<String> = faults.iter().map(ToString::to_string).collect();
                    lines.push(format!("{}: the mesh {}", file.display(), faults.join(", ")));
                }
            }
        }
        Ok(lines)
    }

    fn check(&self) -> Result<()> {
        let spec = &self.spec;
        positive("rate", Span::fixed(spec.rate))?;
        spec.physics.steps_in(1.0 / spec.rate)?;
        for (i, object) in spec.objects.iter().enumerate() {
            let key = |field: &str| format!("objects[{i}].{field}");
            if object.name.is_empty() || !object.name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') {
                return Err(Error::value(key("name"), "letters, digits and _", format!("{:?}", object.name)));
            }
            let taken = spec.objects[..i].iter().map(|other| other.name.as_str()).chain(RESERVED);
            if taken.into_iter().any(|name| name == object.name) {
                return Err(Error::value(key("name"), "a name of its own", &object.name));
            }
            object.check(&format!("objects[{i}]"))?;
        }
        if spec.hands.is_empty() || spec.hands.len() > 2 {
            return Err(Error::value("hands", "one or two", spec.hands.len()));
        }
        if let [first, second] = spec.hands.as_slice() {
            let fits = matches!(
                (first.side, second.side),
                (_, SideSpec::Either) | (SideSpec::Left, SideSpec::Right) | (SideSpec::Right, SideSpec::Left)
            );
            if !fits {
                let got = format!("{:?}, beside {:?}", second.side, first.side).to_lowercase();
                return Err(Error::value("hands[1].side", "either, or the other hand's side", got));
            }
        }
        for (i, hand) in spec.hands.iter().enumerate() {
            if !(0.0..=1.0).contains(&hand.presence) {
                return Err(Error::value(format!("hands[{i}].presence"), "0 to 1", hand.presence));
            }
            if let Some(act) = &hand.act {
                act.check(&format!("hands[{i}].act"), &spec.objects)?;
            }
        }
        within("distractors", spec.distractors, 0.0, MOST_DISTRACTORS)?;
        for (name, point) in [("camera.eye", &spec.camera.eye), ("camera.target", &spec.camera.target)] {
            point.iter().try_for_each(|axis| within(name, *axis, -FAR_EYE, FAR_EYE))?;
        }
        within("camera.fovy", spec.camera.fovy, 5.0, 150.0)?;
        within("camera.roll", spec.camera.roll, -TURN, TURN)?;
        within("camera.sway", spec.camera.sway, 0.0, 1.0)?;
        for (name, span) in ["camera.distortion[0]", "camera.distortion[1]"].into_iter().zip(spec.camera.distortion) {
            within(name, span, -1.0, 1.0)?;
        }
        within("camera.noise", spec.camera.noise, 0.0, 255.0)?;
        within("camera.shutter", spec.camera.shutter, 0.0, 1.0 / spec.rate)?;
        EffectPlan::of(spec).map(drop)
    }
}

fn positive(name: &str, span: Span) -> Result<()> {
    within(name, span, 1e-6, 1e6)
}

fn within(name: &str, span: Span, low: f64, high: f64) -> Result<()> {
    if low <= span.low() && span.high() <= high {
        return Ok(());
    }
    Err(Error::value(name, format!("{low} to {high}"), format!("[{}, {}]", span.low(), span.high())))
}

fn default_rate() -> f64 {
    25.0
}

fn zero() -> Span {
    Span::fixed(0.0)
}

fn zero3() -> [Span; 3] {
    [zero(); 3]
}

fn half() -> Span {
    Span::new(0.3, 0.6)
}

fn one() -> f64 {
    1.0
}
