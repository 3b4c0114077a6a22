//! Adds a rigid object to a model, as a mocap body that the caller moves.

use std::path::Path;

use glam::{DQuat, DVec3};
use mujoco_rs::prelude::*;
use mujoco_rs::wrappers::mj_editing::MjtMeshInertia;

use super::named_files::check_named_files;
use super::options::PhysicsOptions;
use super::world::{World, disable_log_file};
use crate::error::{Error, Result};
use crate::file::input;
use crate::trial::Trial;

/// Name of the mocap body that carries the object.
pub const OBJECT: &str = "egotac_object";

/// Source of a model.
#[derive(Debug, Clone, Copy)]
pub enum ModelText<'a> {
    /// MJCF or URDF text.
    Text(&'a str),
    /// MJCF or URDF file.
    File(&'a Path),
}

/// Collision shapes of a rigid object in the object's frame; a mesh counts as its convex hull.
#[derive(Debug, Clone)]
pub struct Shapes(Vec<ObjectGeom>);

#[derive(Debug, Clone)]
struct ObjectGeom {
    kind: MjtGeomBase,
    size: [f64; 3],
    place: DVec3,
    orientation: DQuat,
    mesh: Option<MeshData>,
}

/// Flattened vertices, m, and triangles.
#[derive(Debug, Clone)]
struct MeshData {
    vertices: Vec<f32>,
    faces: Vec<i32>,
}

impl Shapes {
    /// Reads an object from a mesh (OBJ or STL), or from a model (MJCF or URDF) in its initial state, whose world frame
    /// is the object's frame.
    ///
    /// Of a model it takes the shapes that can collide, or all shapes if none can.
    ///
    /// # Errors
    /// If the file can't be read or compiled, or holds no solid shape.
    pub fn read(path: &Path) -> Result<Self> {
        Trial::Object(path.to_path_buf()).run()?;
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        let options = PhysicsOptions::default();
        let world = match extension.as_str() {
            "obj" | "stl" => {
                input::open(path)?;
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
            ObjectGeom { kind, size: model.geom_size()[geom], place, orientation: DQuat::from_mat3(&rotation), mesh }
        };
        Self(solid.into_iter().filter(|geom| touches(*geom) || !any).map(shape).collect())
    }

    /// Adds the shapes to an uncompiled model, on a mocap body; they collide with nothing.
    fn add_to(&self, spec: &mut MjSpec) {
        let name = |index: usize| format!("{OBJECT}_{index}");
        for (index, shape) in self.0.iter().enumerate() {
            if let Some(MeshData { vertices, faces }) = &shape.mesh {
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
            // The model's default class would apply its own values otherwise.
            geom.with_contype(0).with_conaffinity(0).with_margin(0.0).with_gap(0.0);
            let _ = match shape.mesh {
                Some(_) => geom.with_meshname(&name(index)),
                None => geom.with_size(shape.size),
            };
        }
    }
}

/// Returns the mesh of a geom, in the geom's frame.
fn mesh(model: &MjModel, geom: usize) -> Option<MeshData> {
    let mesh = usize::try_from(model.geom_dataid()[geom]).ok()?;
    let at = |first: i32, count: i32| first as usize..(first + count) as usize;
    let vertices = model.mesh_vert().get(at(model.mesh_vertadr()[mesh], model.mesh_vertnum()[mesh]))?;
    let faces = model.mesh_face().get(at(model.mesh_faceadr()[mesh], model.mesh_facenum()[mesh]))?;
    Some(MeshData { vertices: vertices.concat(), faces: faces.concat() })
}

impl World {
    /// Compiles a model with an additional object, which [`World::set_mocap`] moves; see [`World::from_mjcf`].
    ///
    /// # Errors
    /// As [`World::from_mjcf`].
    pub fn with_object(text: ModelText, object: &Shapes, options: &PhysicsOptions) -> Result<Self> {
        disable_log_file();
        let engine = |error: MjEditError| Error::Engine(error.to_string());
        let mut spec = match text {
            ModelText::Text(text) => MjSpec::from_xml_string(text),
            ModelText::File(path) => {
                check_named_files(path)?;
                MjSpec::from_xml(path)
            }
        }
        .map_err(engine)?;
        object.add_to(&mut spec);
        Self::from_model(spec.compile().map_err(engine)?, options)
    }
}
