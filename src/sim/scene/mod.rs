//! Scenes: objects on the table, contact goals of the hands, camera; YAML files whose numbers may be ranges.

mod act;
mod effect_plan;
mod limits;
mod look;
mod object;
mod present;
mod shipped;
mod spec;
mod split;

use std::path::Path;

pub(crate) use act::holding_force;
pub use act::{ActSpec, Channels, ContactSpec, HandSite, PhaseSpec, WrapSpec};
pub use effect_plan::EffectPlan;
pub use look::{HandLook, LookSpec, LookStyle, TablePattern};
pub use object::{ObjectSpec, ShapeSpec};
pub use present::PresentHands;
pub use shipped::SHIPPED;
pub use spec::{CameraSpec, HandSpec, SceneSpec, SideSpec};
pub use split::Split;

use super::effect::Observation;
use super::range::UniformRange;
use crate::error::{Error, Result};
use crate::file::{self, input};
use crate::text::parse_yaml;
use limits::{MAX_ANGLE, within};

/// Names of bodies and geoms that every world has; objects cannot take them.
const RESERVED_NAMES: [&str; 4] = ["head", "table", "floor", "sky"];
/// Largest number of distractors: more find no room around the workspace.
const MAX_DISTRACTORS: f64 = 40.0;
/// Largest coordinate of the camera's eye and target, m.
const MAX_CAMERA_COORDINATE: f64 = 10.0;
/// Largest number of objects: more find no room on the table.
const MAX_OBJECTS: usize = 100;
/// Least and greatest number of frames per second; physics steps are finer.
const RATES: [f64; 2] = [0.1, 10_000.0];

/// A checked scene: a family of episodes, from which a seed draws one.
///
/// Scenes are YAML; any number may be a range `[low, high]`, and unknown keys are errors. Lengths are metres, masses
/// kilograms, forces newtons, angles radians, times seconds. The world frame has its origin on the table's top; the
/// person sits at negative y and looks along +y; z is up.
///
/// ```
/// use std::path::Path;
///
/// use egotac::sim::Scene;
///
/// # fn main() -> egotac::Result<()> {
/// let shipped = Scene::load("pinch_cube")?; // a name of `egotac sim list`, or a path to a YAML file
/// assert_eq!(shipped.spec.rate, 25.0); // frames per second
///
/// let text = "
/// description: A hand rests above an empty table.
/// observe: [pose]
/// objects: []
/// hands: [{ side: right }]
/// ";
/// let own = Scene::parse("rest", Path::new("rest.yaml"), text)?;
/// assert_eq!(own.name, "rest");
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// Name of the shipped scene, or of the file without its extension.
    pub name: String,
    /// Content of the file.
    pub spec: SceneSpec,
}

impl Scene {
    /// Loads a shipped scene by name, a scene of a split by `SPLIT/SCENE`, or a YAML file by path.
    ///
    /// # Errors
    /// If it is neither, cannot be read, or is not a valid scene; the error names file, key and the expected value.
    pub fn load(name_or_path: &str) -> Result<Self> {
        if let Some((name, text)) = SHIPPED.iter().find(|(name, _)| *name == name_or_path) {
            return Self::parse(name, Path::new(name), text);
        }
        if let Some(text) = Split::resolve(name_or_path)? {
            return Self::parse(name_or_path, Path::new(name_or_path), &text);
        }
        let path = Path::new(name_or_path);
        if !path.exists() {
            return Err(Error::unknown("scene", name_or_path, SHIPPED.iter().map(|(name, _)| *name)));
        }
        let text = input::read_text(path, file::limits::TEXT)?;
        let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        Self::parse(&stem, path, &text)
    }

    /// Parses a scene from YAML; `path` stands in errors, and relative mesh files start at its folder.
    ///
    /// # Errors
    /// If the text is not a valid scene.
    pub fn parse(name: &str, path: &Path, text: &str) -> Result<Self> {
        let mut spec: SceneSpec = parse_yaml(text).map_err(|e| Error::file(path, e))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        spec.objects.iter_mut().for_each(|object| object.shape.resolve(folder));
        Self::checked(name, spec).map_err(|e| Error::file(path, e))
    }

    /// Creates a scene after checking all its values.
    ///
    /// # Errors
    /// If a value is out of its range; the error names the key.
    pub fn checked(name: &str, spec: SceneSpec) -> Result<Self> {
        check(&spec)?;
        Ok(Self { name: name.to_owned(), spec })
    }
}

/// Checks all values of a scene.
fn check(spec: &SceneSpec) -> Result<()> {
    within("rate", UniformRange::fixed(spec.rate), RATES[0], RATES[1])?;
    spec.physics.steps_in(1.0 / spec.rate)?;
    check_objects(spec)?;
    check_hands(spec)?;
    within("distractors", spec.distractors, 0.0, MAX_DISTRACTORS)?;
    check_camera(&spec.camera, spec.rate)?;
    spec.look.check()?;
    check_glove(spec)?;
    EffectPlan::of(spec).map(drop)
}

fn check_glove(spec: &SceneSpec) -> Result<()> {
    let Some(glove) = &spec.glove else { return Ok(()) };
    if !spec.observe.contains(&Observation::Force) {
        let expected = "`observe` with force, which the taxels read";
        return Err(Error::value(
            "glove",
            expected,
            spec.observe.iter().map(|o| o.name()).collect::<Vec<_>>().join(", "),
        ));
    }
    glove.check()
}

fn check_objects(spec: &SceneSpec) -> Result<()> {
    if spec.objects.len() > MAX_OBJECTS {
        return Err(Error::value("objects", format!("at most {MAX_OBJECTS}"), spec.objects.len()));
    }
    for (i, object) in spec.objects.iter().enumerate() {
        let key = |field: &str| format!("objects[{i}].{field}");
        if object.name.is_empty() || !object.name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') {
            return Err(Error::value(key("name"), "letters, digits and _", format!("{:?}", object.name)));
        }
        let taken = spec.objects[..i].iter().map(|other| other.name.as_str()).chain(RESERVED_NAMES);
        if taken.into_iter().any(|name| name == object.name) {
            return Err(Error::value(key("name"), "a name of its own", &object.name));
        }
        object.check(&format!("objects[{i}]"))?;
    }
    Ok(())
}

fn check_hands(spec: &SceneSpec) -> Result<()> {
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
    Ok(())
}

fn check_camera(camera: &CameraSpec, rate: f64) -> Result<()> {
    for (name, point) in [("camera.eye", &camera.eye), ("camera.target", &camera.target)] {
        point.iter().try_for_each(|axis| within(name, *axis, -MAX_CAMERA_COORDINATE, MAX_CAMERA_COORDINATE))?;
    }
    within("camera.fovy", camera.fovy, 5.0, 150.0)?;
    within("camera.roll", camera.roll, -MAX_ANGLE, MAX_ANGLE)?;
    within("camera.sway", camera.sway, 0.0, 1.0)?;
    for (name, range) in ["camera.distortion[0]", "camera.distortion[1]"].into_iter().zip(camera.distortion) {
        within(name, range, -1.0, 1.0)?;
    }
    within("camera.noise", camera.noise, 0.0, 255.0)?;
    within("camera.shutter", camera.shutter, 0.0, 1.0 / rate)
}
