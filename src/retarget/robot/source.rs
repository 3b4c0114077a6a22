//! Search for robot files and their models.

use std::path::{Path, PathBuf};

use super::spec::RobotSpec;
use super::urdf;
use crate::error::{Error, Result};
use crate::file::{input, limits};
use crate::mujoco::object::{ModelText, Shapes};
use crate::mujoco::{PhysicsOptions, World};

/// Robots that are part of the program: name, YAML, and the model if it is part of the program too.
const SHIPPED: &[(&str, &str, Option<&str>)] = &[
    (
        "four_finger",
        include_str!("../../../sim/robots/four_finger.yaml"),
        Some(include_str!("../../../sim/robots/four_finger.xml")),
    ),
    (
        "gripper",
        include_str!("../../../sim/robots/gripper.yaml"),
        Some(include_str!("../../../sim/robots/gripper.xml")),
    ),
    (
        "tendon_hand",
        include_str!("../../../sim/robots/tendon_hand.yaml"),
        Some(include_str!("../../../sim/robots/tendon_hand.xml")),
    ),
    ("shadow_right", include_str!("../../../sim/robots/shadow_right.yaml"), None),
    ("shadow_left", include_str!("../../../sim/robots/shadow_left.yaml"), None),
    ("shadow_urdf_right", include_str!("../../../sim/robots/shadow_urdf_right.yaml"), None),
    ("shadow_urdf_left", include_str!("../../../sim/robots/shadow_urdf_left.yaml"), None),
    ("allegro_right", include_str!("../../../sim/robots/allegro_right.yaml"), None),
    ("allegro_left", include_str!("../../../sim/robots/allegro_left.yaml"), None),
    ("allegro_urdf_right", include_str!("../../../sim/robots/allegro_urdf_right.yaml"), None),
    ("allegro_urdf_left", include_str!("../../../sim/robots/allegro_urdf_left.yaml"), None),
    ("leap_right", include_str!("../../../sim/robots/leap_right.yaml"), None),
    ("leap_left", include_str!("../../../sim/robots/leap_left.yaml"), None),
    ("leap_urdf_right", include_str!("../../../sim/robots/leap_urdf_right.yaml"), None),
    ("leap_urdf_left", include_str!("../../../sim/robots/leap_urdf_left.yaml"), None),
    ("aero_right", include_str!("../../../sim/robots/aero_right.yaml"), None),
    ("aero_left", include_str!("../../../sim/robots/aero_left.yaml"), None),
    ("sharpa_right", include_str!("../../../sim/robots/sharpa_right.yaml"), None),
    ("sharpa_left", include_str!("../../../sim/robots/sharpa_left.yaml"), None),
    ("inspire_right", include_str!("../../../sim/robots/inspire_right.yaml"), None),
    ("inspire_left", include_str!("../../../sim/robots/inspire_left.yaml"), None),
    ("panda_gripper", include_str!("../../../sim/robots/panda_gripper.yaml"), None),
];

/// Folders of models below a Python environment's `site-packages`.
const PACKAGES: [&str; 5] = [
    "dexi_rs/resources/assets/robots/hands",
    "mujoco/mjx/test_data",
    "robosuite/models/assets/grippers",
    "gymnasium_robotics/envs/assets",
    "cmeel.prefix/share/example-robot-data/robots",
];

/// Content of a robot's YAML file, with its compiled model.
#[derive(Debug)]
pub struct RobotSource {
    /// Content of the YAML file.
    pub spec: RobotSpec,
    /// Compiled model.
    pub world: World,
    /// Origin of the model: a file, or "part of the program".
    pub origin: String,
    /// Mesh files that could not be loaded; their shapes are missing in the model.
    pub missing_meshes: Vec<String>,
}

/// Returns the names of the robots that are part of the program.
pub fn names() -> impl Iterator<Item = &'static str> {
    SHIPPED.iter().map(|(name, ..)| *name)
}

/// True if the robot's model is part of the program.
pub fn has_own_model(name: &str) -> bool {
    SHIPPED.iter().any(|(shipped, _, model)| *shipped == name && model.is_some())
}

/// Returns the file of a robot that is part of the program.
fn shipped_spec(name: &str) -> Result<RobotSpec> {
    let shipped = SHIPPED.iter().find(|(shipped, ..)| *shipped == name);
    let Some((_, yaml, _)) = shipped else { return Err(Error::unknown("robot", name, names())) };
    RobotSpec::parse(yaml)
}

/// Returns the origin of the model of a robot that is part of the program: "part of the program" or a file; None if there is
/// no such file on this machine.
///
/// # Errors
/// If there is no such robot.
pub fn find_model(name: &str) -> Result<Option<String>> {
    if has_own_model(name) {
        return Ok(Some("part of the program".to_owned()));
    }
    let spec = shipped_spec(name)?;
    Ok(locate(&spec, None).ok().map(|path| path.display().to_string()))
}

/// Describes where the model of a robot that is part of the program is to be had.
///
/// # Errors
/// If there is no such robot.
pub fn describe(name: &str) -> Result<String> {
    if has_own_model(name) {
        return Ok("part of the program".to_owned());
    }
    let spec = shipped_spec(name)?;
    Ok(match (spec.model.mjcf, spec.model.urdf) {
        (Some(model), _) => format!(
            "{} of MuJoCo Menagerie (github.com/google-deepmind/mujoco_menagerie); name its folder in MENAGERIE_ROOT",
            model.display()
        ),
        (None, Some(model)) => {
            format!(
                "{} of dex-urdf (PyPI package dexi-rs); name the folder that holds it in EGOTAC_ROBOTS",
                model.display()
            )
        }
        (None, None) => "no model".to_owned(),
    })
}

/// Reads a robot: a name of [`names`], a YAML file, or a model (MJCF or URDF) without one. `model` replaces the model that
/// the YAML file names; `object` is added to the model.
///
/// # Errors
/// If there is no such robot, or its model can't be found, read or compiled; the error lists the folders searched.
pub fn open(robot: &str, model: Option<&Path>, object: Option<&Shapes>) -> Result<RobotSource> {
    if let Some((_, yaml, own)) = SHIPPED.iter().find(|(name, ..)| *name == robot) {
        let spec = RobotSpec::parse(yaml)?;
        return match (model, own) {
            (Some(path), _) => compile(spec, path, object),
            (None, Some(xml)) => {
                let world = build(ModelText::Text(xml), object)?;
                Ok(RobotSource {
                    spec,
                    world,
                    origin: format!("{robot}, part of the program"),
                    missing_meshes: Vec::new(),
                })
            }
            (None, None) => {
                let path = locate(&spec, None)?;
                compile(spec, &path, object)
            }
        };
    }
    let path = Path::new(robot);
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    if !path.exists() {
        return match extension.as_str() {
            "" => Err(Error::unknown("robot", robot, names())),
            _ => Err(Error::io(path)(std::io::ErrorKind::NotFound.into())),
        };
    }
    match extension.as_str() {
        "yaml" | "yml" => {
            let text = input::read_text(path, limits::TEXT)?;
            let spec = RobotSpec::parse(&text).map_err(|error| Error::file(path, error))?;
            let found = match model {
                Some(model) => model.to_owned(),
                None => locate(&spec, path.parent())?,
            };
            compile(spec, &found, object).map_err(|error| Error::file(path, error))
        }
        "xml" | "mjcf" | "urdf" => {
            let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
            compile(RobotSpec { robot: stem, ..RobotSpec::default() }, model.unwrap_or(path), object)
        }
        _ => Err(Error::file(path, "expected a robot's .yaml, or a model: .xml (MJCF) or .urdf")),
    }
}

/// Compiles a model file, MJCF or URDF.
fn compile(spec: RobotSpec, path: &Path, object: Option<&Shapes>) -> Result<RobotSource> {
    let is_urdf = input::read_text(path, limits::TEXT)?.contains("<robot");
    let (world, missing_meshes) = match is_urdf {
        true => {
            let prepared = urdf::prepare(path)?;
            let world = build(ModelText::Text(&prepared.xml), object).map_err(|error| Error::file(path, error))?;
            (world, prepared.missing_meshes)
        }
        false => (build(ModelText::File(path), object)?, Vec::new()),
    };
    Ok(RobotSource { spec, world, origin: path.display().to_string(), missing_meshes })
}

/// Compiles a model, with an object beside it if there is one.
fn build(text: ModelText, object: Option<&Shapes>) -> Result<World> {
    let options = PhysicsOptions::default();
    match (text, object) {
        (ModelText::Text(_), Some(object)) => World::with_object(text, object, &options),
        (ModelText::File(path), Some(object)) => {
            World::with_object(text, object, &options).map_err(|error| Error::file(path, error))
        }
        (ModelText::Text(text), None) => World::from_mjcf(text, &options),
        (ModelText::File(path), None) => World::from_file(path, &options),
    }
}

/// Finds the model that a YAML file names; `beside`: the folder of that file.
fn locate(spec: &RobotSpec, beside: Option<&Path>) -> Result<PathBuf> {
    let name = match (&spec.model.mjcf, &spec.model.urdf) {
        (Some(name), None) | (None, Some(name)) => name,
        (Some(_), Some(_)) => return Err(Error::value("model", "one of mjcf and urdf", "both")),
        (None, None) => return Err(Error::value("model", "mjcf or urdf", "neither")),
    };
    let folders = folders(beside);
    let found = folders.iter().map(|folder| folder.join(name)).find(|path| path.is_file());
    found.ok_or_else(|| {
        let looked: Vec<String> = folders.iter().map(|folder| folder.display().to_string()).collect();
        let expected = format!(
            "a file; give --model, or name its folder in EGOTAC_ROBOTS or MENAGERIE_ROOT (searched: {})",
            if looked.is_empty() { "nowhere".to_owned() } else { looked.join(", ") }
        );
        Error::value(format!("model of {}", spec.robot), expected, name.display())
    })
}

/// Returns the folders that are searched for models, in order.
fn folders(beside: Option<&Path>) -> Vec<PathBuf> {
    let mut folders: Vec<PathBuf> = beside.map(Path::to_path_buf).into_iter().collect();
    let mut add_root = |root: PathBuf| {
        folders.extend(PACKAGES.iter().map(|package| root.join(package)).filter(|folder| folder.is_dir()));
        folders.push(root);
    };
    for variable in ["EGOTAC_ROBOTS", "MENAGERIE_ROOT"] {
        let Some(value) = std::env::var_os(variable) else { continue };
        std::env::split_paths(&value).filter(|root| !root.as_os_str().is_empty()).for_each(&mut add_root);
    }
    if let Some(python) = std::env::var_os("EGOTAC_PYTHON") {
        let libraries = Path::new(&python).ancestors().nth(2).map(|venv| venv.join("lib"));
        let versions = libraries.and_then(|lib| std::fs::read_dir(lib).ok()).into_iter().flatten().flatten();
        for version in versions {
            let packages = version.path().join("site-packages");
            folders.extend(PACKAGES.iter().map(|package| packages.join(package)).filter(|folder| folder.is_dir()));
        }
    }
    folders
}
