//! Scenes: what lies on the table, which hands do what, from where it is seen; YAML, with ranges to draw from.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;

use super::span::Span;
use crate::error::{Error, Result};
use crate::mujoco::PhysicsOptions;

/// Names that the world itself gives.
const RESERVED: [&str; 4] = ["head", "table", "floor", "sky"];
/// No hand presses harder, N.
const MOST_FORCE: f64 = 1000.0;
/// No hand is sent further, m.
const FAR: f64 = 1.0;

/// Scenes that are part of the program: name and text.
pub const SHIPPED: [(&str, &str); 3] = [
    ("pinch_cube", include_str!("../../sim/scenes/pinch_cube.yaml")),
    ("lift_mug", include_str!("../../sim/scenes/lift_mug.yaml")),
    ("hover", include_str!("../../sim/scenes/hover.yaml")),
];

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
    /// Physics.
    #[serde(default)]
    pub physics: PhysicsOptions,
    /// Objects on the table.
    pub objects: Vec<ObjectSpec>,
    /// Hands; the first is the actor, another one is idle unless it has a script.
    pub hands: Vec<HandSpec>,
    /// The head-mounted camera.
    #[serde(default)]
    pub camera: CameraSpec,
}

/// An object that lies on the table and can move.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectSpec {
    /// Name.
    pub name: String,
    /// Shape; its frame has the centre of the shape as origin and z up.
    #[serde(with = "serde_yaml::with::singleton_map")]
    pub shape: ShapeSpec,
    /// Mass, kg.
    pub mass: Span,
    /// Coefficient of sliding friction.
    pub friction: Span,
    /// Where on the table, m: x and y; x is mirrored for the left hand.
    pub position: [Span; 2],
    /// Rotation about z, rad, for the right hand; mirrored for the left one.
    #[serde(default = "zero")]
    pub yaw: Span,
}

/// Shapes; lengths in metres. All are symmetric in their frame's y.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum ShapeSpec {
    /// A cuboid with the given edges along x, y and z.
    Box {
        /// Edges.
        size: [Span; 3],
    },
    /// A cuboid with three equal edges.
    Cube {
        /// Edge.
        size: Span,
    },
    /// A ball.
    Ball {
        /// Radius.
        radius: Span,
    },
    /// An upright cylinder.
    Cylinder {
        /// Radius.
        radius: Span,
        /// Height.
        height: Span,
    },
    /// A mug of convex pieces, open above, its handle along +x.
    Mug {
        /// Outer radius.
        radius: Span,
        /// Height.
        height: Span,
        /// Thickness of wall and floor.
        wall: Span,
    },
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

/// Contact goals of a hand and their course in time. Directions are those of the right hand, in the object's frame.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActSpec {
    /// Name of the object the hand deals with.
    pub object: String,
    /// Where the stretched fingers would point.
    pub fingers: [f64; 3],
    /// Where the palm faces.
    pub palm: [f64; 3],
    /// Random turn of the whole hand about a random axis, rad.
    #[serde(default = "zero")]
    pub turn: Span,
    /// Direction from which the hand comes and to which it leaves, in the world frame.
    pub from: [f64; 3],
    /// Random turn of `from`, rad.
    #[serde(default = "zero")]
    pub from_turn: Span,
    /// Goals by site.
    pub contacts: BTreeMap<Site, ContactSpec>,
    /// Grip force as a multiple of what just holds the object against gravity; 0 leaves `force` alone.
    #[serde(default = "zero")]
    pub grip: Span,
    /// Curl of fingers without goal: 0 stretched, 1 fist.
    #[serde(default = "half")]
    pub curl: Span,
    /// Channels at the start.
    pub start: Channels,
    /// Phases, one after another.
    pub script: Vec<PhaseSpec>,
}

/// A part of a hand that can be given a contact goal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize)]
#[serde(rename_all = "lowercase")]
#[allow(missing_docs)]
pub enum Site {
    Thumb,
    Index,
    Middle,
    Ring,
    Little,
    Palm,
}

impl Site {
    /// The five fingers in anatomical order.
    pub const FINGERS: [Site; 5] = [Site::Thumb, Site::Index, Site::Middle, Site::Ring, Site::Little];
}

/// A goal: where a site touches the object, and how hard.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContactSpec {
    /// Direction from the object's axis to the point, in its frame; the outermost surface that way is touched.
    pub at: [f64; 3],
    /// Height of the point above the object's centre, m.
    #[serde(default = "zero")]
    pub height: Span,
    /// Normal force, N, in addition to the grip's share.
    #[serde(default = "zero")]
    pub force: Span,
    /// Share of the grip force that this site carries.
    #[serde(default)]
    pub share: f64,
}

/// One phase: the channels that change, and how long that takes. Channels not named keep their value.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhaseSpec {
    /// Name, for the reader.
    pub phase: String,
    /// Duration, s.
    pub seconds: Span,
    /// See [`Channels`].
    pub standoff: Option<Span>,
    /// See [`Channels`].
    pub opening: Option<Span>,
    /// See [`Channels`].
    pub squeeze: Option<Span>,
    /// See [`Channels`].
    pub shift: Option<[Span; 3]>,
}

/// What a script drives.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Channels {
    /// How far the hand is from its place at the object, along `from`, m.
    #[serde(default = "zero")]
    pub standoff: Span,
    /// How far the sites with goals are from the surface, m.
    #[serde(default = "zero")]
    pub opening: Span,
    /// Share of the goal forces applied, 0 to 1.
    #[serde(default = "zero")]
    pub squeeze: Span,
    /// Displacement of the hand in the world frame, m; x is mirrored for the left hand.
    #[serde(default = "zero3")]
    pub shift: [Span; 3],
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
}

impl Default for CameraSpec {
    fn default() -> Self {
        Self {
            eye: [Span::new(-0.06, 0.06), Span::new(-0.36, -0.26), Span::new(0.38, 0.48)],
            target: [Span::new(-0.02, 0.02), Span::new(-0.03, 0.03), Span::new(0.02, 0.06)],
            fovy: Span::new(40.0, 50.0),
            roll: Span::new(-0.06, 0.06),
            sway: Span::new(0.0, 0.008),
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
        let spec: SceneSpec = serde_yaml::from_str(text).map_err(|e| Error::file(path, e))?;
        let scene = Self { name: name.to_owned(), spec };
        scene.check().map_err(|e| Error::file(path, e))?;
        Ok(scene)
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
            positive(&key("mass"), object.mass)?;
            positive(&key("friction"), object.friction)?;
            object.shape.check(&key("shape"))?;
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
        within("camera.fovy", spec.camera.fovy, 5.0, 150.0)
    }
}

impl ShapeSpec {
    fn check(&self, key: &str) -> Result<()> {
        let length = |name: &str, span: Span| within(&format!("{key}.{name}"), span, 1e-3, 10.0);
        match self {
            Self::Box { size } => size.iter().try_for_each(|s| length("size", *s)),
            Self::Cube { size } => length("size", *size),
            Self::Ball { radius } => length("radius", *radius),
            Self::Cylinder { radius, height } => length("radius", *radius).and(length("height", *height)),
            Self::Mug { radius, height, wall } => {
                length("radius", *radius)?;
                length("height", *height)?;
                within(&format!("{key}.wall"), *wall, 1e-3, 0.5 * radius.low().min(height.low()))
            }
        }
    }
}

impl ActSpec {
    fn check(&self, key: &str, objects: &[ObjectSpec]) -> Result<()> {
        if !objects.iter().any(|object| object.name == self.object) {
            return Err(Error::unknown("object", &self.object, objects.iter().map(|o| o.name.as_str())));
        }
        let directions = [("fingers", self.fingers), ("palm", self.palm), ("from", self.from)];
        let goals = self.contacts.values().map(|contact| ("contacts.at", contact.at));
        for (name, [x, y, z]) in directions.into_iter().chain(goals) {
            let length = (x * x + y * y + z * z).sqrt();
            if !(length.is_finite() && length > 1e-6) {
                return Err(Error::value(format!("{key}.{name}"), "a direction", format!("[{x}, {y}, {z}]")));
            }
        }
        if self.contacts.is_empty() {
            return Err(Error::value(format!("{key}.contacts"), "at least one goal", "none"));
        }
        if self.script.is_empty() {
            return Err(Error::value(format!("{key}.script"), "at least one phase", "none"));
        }
        within(&format!("{key}.grip"), self.grip, 0.0, MOST_FORCE)?;
        within(&format!("{key}.curl"), self.curl, 0.0, 1.0)?;
        for (site, contact) in &self.contacts {
            let key = format!("{key}.contacts.{site:?}").to_lowercase();
            within(&format!("{key}.force"), contact.force, 0.0, MOST_FORCE)?;
            within(&format!("{key}.height"), contact.height, -FAR, FAR)?;
            if !(0.0..=1.0).contains(&contact.share) {
                return Err(Error::value(format!("{key}.share"), "0 to 1", contact.share));
            }
        }
        let Channels { standoff, opening, squeeze, shift } = &self.start;
        channels(&format!("{key}.start"), Some(*standoff), Some(*opening), Some(*squeeze), Some(shift))?;
        for (i, phase) in self.script.iter().enumerate() {
            let key = format!("{key}.script[{i}]");
            within(&format!("{key}.seconds"), phase.seconds, 0.0, 600.0)?;
            channels(&key, phase.standoff, phase.opening, phase.squeeze, phase.shift.as_ref())?;
        }
        Ok(())
    }
}

/// Checks the channels that are given.
fn channels(
    key: &str,
    standoff: Option<Span>,
    opening: Option<Span>,
    squeeze: Option<Span>,
    shift: Option<&[Span; 3]>,
) -> Result<()> {
    let check = |name: &str, span: Option<Span>, low: f64, high: f64| match span {
        Some(span) => within(&format!("{key}.{name}"), span, low, high),
        None => Ok(()),
    };
    check("standoff", standoff, -FAR, FAR)?;
    check("opening", opening, -FAR, FAR)?;
    check("squeeze", squeeze, 0.0, 1.0)?;
    shift.into_iter().flatten().try_for_each(|axis| check("shift", Some(*axis), -FAR, FAR))
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
