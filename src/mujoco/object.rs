//! An object beside a model: its shapes, and a body of the model that carries them and is placed from outside.

use std::path::Path;

use glam::{DQuat, DVec3};
use mujoco_rs::prelude::*;
use mujoco_rs::wrappers::mj_editing::MjtMeshInertia;

use super::options::PhysicsOptions;
use super::world::{World, keep_quiet};
use crate::error::{Error, Result};

/// Name of the body that carries the object.
pub const OBJECT: &str = "egotac_object";

/// A model's text.
#[derive(Debug, Clone, Copy)]
pub enum ModelText<'a> {
    /// MJCF or URDF.
    Text(&'a str),
    /// A file of one of them.
    File(&'a Path),
}

/// Shapes of a rigid object, in a frame of its own; of a mesh the convex hull.
#[derive(Debug, Clone)]
pub struct Shapes(Vec<Shape>);

#[derive(Debug, Clone)]
struct Shape {
    kind: MjtGeomBase,
    size: [f64; 3],
    place: DVec3,
    orientation: DQuat,
    mesh: Option<Mesh>,
}

/// Corners, m, and triangles.
#[derive(Debug, Clone)]
struct Mesh {
    vertices: Vec<f32>,
    faces: Vec<i32>,
}

impl Shapes {
    /// Reads an object: a model (MJCF or URDF) whose world is the object's frame, as it is at first; or a mesh (OBJ or STL).
    ///
    /// Of a model those shapes count that can touch; all, if none can.
    ///
    /// # Errors
    /// If the file can't be read or compiled, or holds no solid shape.
    pub fn read(path: &Path) -> Result<Self> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        let options = PhysicsOptions::default();
        let world = match extension.as_str() {
            "obj" | "stl" => {
                let file = std::path::absolute(path).map_err(Error::io(path))?;
                let xml = format!(
                    "<mujoco><asset><mesh name=\"object\" inertia=\"shell\" file=\"{}\"/></asset><worldbody>\
                     <geom type=\"mesh\" mesh=\"object\"/></worldbody></mujoco>",
                    file.to_string_lossy().replace('&', "&amp;").replace('"', "&quot;").replace('<', "&lt;")
                );
                World::from_mjcf(&xml, &options).map_err(|error| Error::file(path, error))?
            }
            "xml" | "mjcf" | "urdf" => World::from_file(path, &options)?,
            _ => return Err(Error::file(path, "expected an object: .xml (MJCF), .urdf, .obj or .stl")),
        };
        let shapes = Self::of(&world);
        match shapes.0.is_empty() {
            true => Err(Error::file(path, "expected an object with a solid shape: sphere, capsule, box, mesh ...")),
            false => Ok(shapes),
        }
    }

    fn of(world: &World) -> Self {
        let (model, parts) = (world.model(), world.parts());
        let touches = |geom: usize| parts.geoms[geom].bits != [0, 0];
        let solid: Vec<usize> = (0..parts.geoms.len()).filter(|geom| parts.geoms[*geom].solid).collect();
        let any = solid.iter().any(|geom| touches(*geom));
        let shape = |geom: usize| {
            let (place, rotation) = world.geom_pose(geom);
            let kind = model.geom_type()[geom];
            let mesh = (kind == MjtGeomBase::mjGEOM_MESH).then(|| mesh(model, geom)).flatten();
            Shape { kind, size: model.geom_size()[geom], place, orientation: DQuat::from_mat3(&rotation), mesh }
        };
        Self(solid.into_iter().filter(|geom| touches(*geom) || !any).map(shape).collect())
    }

    /// Puts the shapes onto a body of a model that is yet to be compiled; they collide with nothing.
    fn add_to(&self, spec: &mut MjSpec) {
        let name = |index: usize| format!("{OBJECT}_{index}");
        for (index, shape) in self.0.iter().enumerate() {
            if let Some(Mesh { vertices, faces }) = &shape.mesh {
                let mesh = spec.add_mesh();
                mesh.with_name(&name(index)).set_inertia(MjtMeshInertia::mjMESH_INERTIA_SHELL);
                mesh.set_uservert(vertices);
                mesh.set_userface(faces);
            }
        }
        let body = spec.world_body_mut().add_body();
        body.with_name(OBJECT).set_mocap(true);
        for (index, shape) in self.0.iter().enumerate() {
            let DQuat { x, y, z, w } = shape.orientation;
            let geom = body.add_geom();
            geom.with_name(&name(index)).with_pos(shape.place.to_array()).with_quat([w, x, y, z]);
            geom.set_type(shape.kind);
            // What the model says of its own shapes by default is not this one's.
            geom.with_contype(0).with_conaffinity(0).with_margin(0.0).with_gap(0.0);
            let _ = match shape.mesh {
                Some(_) => geom.with_meshname(&name(index)),
                None => geom.with_size(shape.size),
            };
        }
    }
}

/// The mesh of a geom, in the geom's frame.
fn mesh(model: &MjModel, geom: usize) -> Option<Mesh> {
    let mesh = usize::try_from(model.geom_dataid()[geom]).ok()?;
    let at = |first: i32, count: i32| first as usize..(first + count) as usize;
    let vertices = model.mesh_vert().get(at(model.mesh_vertadr()[mesh], model.mesh_vertnum()[mesh]))?;
    let faces = model.mesh_face().get(at(model.mesh_faceadr()[mesh], model.mesh_facenum()[mesh]))?;
    Some(Mesh { vertices: vertices.concat(), faces: faces.concat() })
}

impl World {
    /// Compiles a model with an object beside it, which [`World::set_mocap`] places; see [`World::from_mjcf`].
    ///
    /// # Errors
    /// As [`World::from_mjcf`].
    pub fn with_object(text: ModelText, object: &Shapes, options: &PhysicsOptions) -> Result<Self> {
        keep_quiet();
        let engine = |error: MjEditError| Error::Engine(error.to_string());
        let mut spec = match text {
            ModelText::Text(text) => MjSpec::from_xml_string(text),
            ModelText::File(path) => MjSpec::from_xml(path),
        }
        .map_err(engine)?;
        object.add_to(&mut spec);
        Self::from_model(spec.compile().map_err(engine)?, options)
    }
}
