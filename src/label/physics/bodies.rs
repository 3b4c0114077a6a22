//! Bodies of a store's episode: from the scene that it was simulated from, or from the meshes that its import names.

use std::collections::BTreeMap;
use std::path::PathBuf;

use glam::DVec3;
use serde_json::Value;

use crate::dataset::zarr::ZarrReader;
use crate::error::{Error, Result};
use crate::file;
use crate::physics::{DensityClass, Fixed, Pose, RigidBody};

/// Knowledge of bodies that a store does not hold.
#[derive(Debug, Clone, Default)]
pub struct BodyOptions {
    /// Masses by name of the object, kg.
    pub masses: BTreeMap<String, f64>,
    /// Class of the other objects' density; `None` = the simulator's masses, and `household` for recordings.
    pub density: Option<DensityClass>,
    /// Coefficient of friction between hands and objects; `None` = the simulator's, and 0.8 for recordings.
    pub friction: Option<f64>,
    /// Folder with a mesh NAME.obj, .ply, .glb or .stl of each object, in place of those that the import names.
    pub meshes: Option<PathBuf>,
    /// Direction of gravity in the store's world frame; `None` = that of the simulator, or found from resting objects.
    pub gravity: Option<DVec3>,
}

/// Bodies and surroundings of one episode.
pub(super) struct Surroundings {
    /// Bodies in the order of the store's poses.
    pub bodies: Vec<RigidBody>,
    /// Fixed things.
    pub fixed: Vec<Fixed>,
    /// Acceleration of free fall, m/s², where the store tells it.
    pub gravity: Option<DVec3>,
    /// True where zeros in a hand's pose mean that the hand is absent; otherwise they mean unknown.
    pub zeros_are_absent: bool,
}

impl BodyOptions {
    /// Returns the surroundings of episode `index` of a store. `at`: poses of the objects at its first frame.
    ///
    /// # Errors
    /// If neither scene nor meshes are known, or a mesh can't be read.
    pub(super) fn surroundings(&self, store: &ZarrReader, index: usize, at: &[Option<Pose>]) -> Result<Surroundings> {
        let mut found = match store.raw_attributes().get("import").and_then(Value::as_object) {
            Some(import) => self.imported(store, import)?,
            None => simulated(store, index, at)?,
        };
        for body in &mut found.bodies {
            let given = self.masses.get(&body.name);
            *body = match (given, self.density) {
                (Some(kilograms), _) => body.clone().with_mass(*kilograms, 0.0)?,
                (None, Some(class)) => body.clone().with_density(class),
                (None, None) if body.mass.is_none() => body.clone().with_density(DensityClass::by_name("household")?),
                (None, None) => continue,
            };
        }
        for body in &mut found.bodies {
            body.friction = self.friction.unwrap_or(body.friction);
        }
        let names: Vec<&str> = found.bodies.iter().map(|body| body.name.as_str()).collect();
        match self.masses.keys().find(|name| !names.contains(&name.as_str())) {
            Some(name) => Err(Error::unknown("object of --mass", name, names)),
            None => Ok(found),
        }
    }

    fn imported(&self, store: &ZarrReader, import: &serde_json::Map<String, Value>) -> Result<Surroundings> {
        let names = import.get("objects").and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_str);
        let meshes = import.get("object_meshes").and_then(Value::as_array);
        let mut bodies = Vec::new();
        for (index, name) in names.enumerate() {
            let recorded = meshes.and_then(|meshes| meshes.get(index)).filter(|mesh| !mesh.is_null());
            let recorded = recorded.and_then(|mesh| {
                // A relative path is one in the store.
                Some((store.path().join(mesh.get("file")?.as_str()?), mesh.get("to_metres")?.as_f64()? as f32))
            });
            let (path, scale) = match (self.in_folder(name), recorded) {
                (Some(path), recorded) => (path, recorded.map_or(1.0, |(_, scale)| scale)),
                (None, Some(recorded)) => recorded,
                (None, None) => {
                    bodies.push(unknown(name));
                    continue;
                }
            };
            let (mut vertices, triangles) = file::mesh::read(&path)?;
            vertices.iter_mut().for_each(|vertex| *vertex *= scale);
            bodies.push(RigidBody::from_mesh(name, vertices, triangles).map_err(|error| Error::file(&path, error))?);
        }
        if bodies.is_empty() || bodies.iter().all(|body| body.solid.is_none()) {
            return Err(Error::file(
                store.path(),
                "names no mesh of an object: import it again with this version, or give --meshes FOLDER",
            ));
        }
        for joint in import.get("object_joints").and_then(Value::as_array).into_iter().flatten() {
            let index = |end: usize| joint.get(end)?.as_u64().map(|index| index as usize);
            match (index(0), index(1)) {
                (Some(first), Some(second)) if first < second && second < bodies.len() => {
                    bodies[second].joined_to = Some(first);
                }
                _ => {
                    let expected = format!("two indices of {} objects, the smaller one first", bodies.len());
                    return Err(Error::file(store.path(), Error::value("import.object_joints", expected, joint)));
                }
            }
        }
        Ok(Surroundings { bodies, fixed: Vec::new(), gravity: None, zeros_are_absent: false })
    }

    /// Returns the mesh of an object in the folder of meshes.
    fn in_folder(&self, name: &str) -> Option<PathBuf> {
        let folder = self.meshes.as_ref()?;
        let file = |ending: &&str| folder.join(format!("{name}.{ending}"));
        ["obj", "ply", "glb", "stl"].iter().map(file).find(|path| path.is_file())
    }
}

/// A body of unknown shape.
fn unknown(name: &str) -> RigidBody {
    RigidBody {
        name: name.into(),
        solid: None,
        samples: Vec::new(),
        mass: None,
        friction: 0.8,
        held: None,
        joined_to: None,
    }
}

/// Builds the bodies of the scene that an episode was simulated from.
#[cfg(feature = "sim")]
fn simulated(store: &ZarrReader, index: usize, at: &[Option<Pose>]) -> Result<Surroundings> {
    use crate::hand::{HandModel, Side};
    use crate::sim::randomize::EpisodeDraw;
    use crate::sim::rig::HandRig;
    use crate::sim::{physical, stored_scene};

    /// Largest distance of a stored pose from the one that the seed gives, m.
    const TOLERANCE: f64 = 2e-3;
    let (Some(name), Some(seed)) = stored_scene::origin(store, index) else { return Err(nameless(store)) };
    let [left, right] = Side::BOTH.map(|side| HandRig::new(HandModel::builtin(side), [0.0; crate::hand::N_BETAS]));
    let drawn = EpisodeDraw::sample(&stored_scene::scene(store, name)?, seed, &[left?, right?])?;
    for (object, pose) in drawn.objects.iter().filter(|object| object.solid).zip(at) {
        let off = pose.map_or(0.0, |pose| pose.position.distance(object.position));
        if off > TOLERANCE {
            let expected = format!("{} at {}, as the store has it", object.name, object.position);
            return Err(Error::value(format!("scene {name} with seed {seed}"), expected, format!("{off} m away")));
        }
    }
    let (bodies, fixed) = physical::bodies(&drawn)?;
    let gravity = Some(DVec3::NEG_Z * crate::physics::gravity::FREE_FALL);
    Ok(Surroundings { bodies, fixed, gravity, zeros_are_absent: true })
}

#[cfg(not(feature = "sim"))]
fn simulated(store: &ZarrReader, _: usize, _: &[Option<Pose>]) -> Result<Surroundings> {
    match store.raw_attributes().contains_key("episodes") {
        true => Err(Error::file(store.path(), "is a store of the simulator: its objects need the feature `sim`")),
        false => Err(nameless(store)),
    }
}

fn nameless(store: &ZarrReader) -> Error {
    let expected = "expected attribute `import` with meshes of objects, or `episodes` with scene and seed, as \
        `egotac data import` and `egotac sim run` write them; got neither";
    Error::file(store.path(), expected)
}
