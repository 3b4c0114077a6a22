//! Lists a model's elements: bodies, joints, geoms, sites, couplings and actuators, with their names.

use glam::DVec3;
use mujoco_rs::prelude::*;

use super::world::World;

/// Maximum number of points that sample a mesh; a few hundred show its extent.
const MAX_MESH_POINTS: usize = 400;
/// Elements of a model; each list is in the engine's order, so that its indices are the engine's.
#[derive(Debug, Clone, Default)]
pub struct Parts {
    /// Bodies; the first is the world.
    pub bodies: Vec<BodyNode>,
    /// Joints.
    pub joints: Vec<Joint>,
    /// Geoms.
    pub geoms: Vec<Geom>,
    /// Sites.
    pub sites: Vec<Site>,
    /// Active joint couplings.
    pub equalities: Vec<Equality>,
    /// Tendons.
    pub tendons: Vec<Tendon>,
    /// Actuators with one force and one control each; empty if the model has others.
    pub actuators: Vec<Actuator>,
    /// Pairs of bodies that never collide.
    pub excludes: Vec<[usize; 2]>,
}

/// A body's place in the kinematic tree.
#[derive(Debug, Clone)]
pub struct BodyNode {
    /// Name; empty if it has none.
    pub name: String,
    /// Index of the parent; the world is its own.
    pub parent: usize,
    /// Nearest body up the tree (or this one) that has a joint, or the world; bodies with the same value move together.
    pub part: usize,
}

/// Type of a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Motion {
    /// Rotation about an axis, rad.
    Hinge,
    /// Translation along an axis, m.
    Slide,
    /// A ball joint or a free joint.
    Other,
}

/// A joint.
#[derive(Debug, Clone)]
pub struct Joint {
    /// Name; empty if it has none.
    pub name: String,
    /// Body that it moves.
    pub body: usize,
    /// Type of motion.
    pub motion: Motion,
    /// Index of its (first) position.
    pub qpos: usize,
    /// Index of its (first) degree of freedom.
    pub dof: usize,
    /// Lowest and highest position, rad or m; infinite without a limit.
    pub range: [f64; 2],
    /// Spring stiffness, N m/rad or N/m.
    pub stiffness: f64,
    /// Rest position of the spring, rad or m.
    pub spring_ref: f64,
    /// Lowest and highest total force of its actuators, N m or N; infinite without a limit.
    pub force_range: [f64; 2],
}

/// A geom.
#[derive(Debug, Clone)]
pub struct Geom {
    /// Name; empty if it has none.
    pub name: String,
    /// Body that carries it.
    pub body: usize,
    /// Contact bits: type and affinity; both zero for a geom that is only drawn.
    pub bits: [i32; 2],
    /// Radius of the bounding sphere, m; 0 means unbounded.
    pub radius: f64,
    /// True if the geom has a volume, so that the engine computes signed distances to it.
    pub solid: bool,
    /// Surface points in the geom's frame, m: corners of a mesh or a box, samples of a round shape.
    pub points: Vec<DVec3>,
}

/// A site.
#[derive(Debug, Clone)]
pub struct Site {
    /// Name; empty if it has none.
    pub name: String,
    /// Body that carries it.
    pub body: usize,
    /// Position in the body's frame, m.
    pub position: DVec3,
}

/// A joint whose position is a polynomial of another joint's position, both relative to the initial state.
#[derive(Debug, Clone)]
pub struct Equality {
    /// Index of the dependent joint.
    pub joint: usize,
    /// Index of the joint that it depends on; `None` if its position is constant.
    pub of: Option<usize>,
    /// Coefficients, constant first.
    pub polynomial: [f64; 5],
}

/// A tendon.
#[derive(Debug, Clone)]
pub struct Tendon {
    /// Name; empty if it has none.
    pub name: String,
    /// Joint indices and coefficients of a fixed tendon; empty for a spatial tendon.
    pub joints: Vec<(usize, f64)>,
}

/// Element that an actuator acts on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pull {
    /// A joint.
    Joint(usize),
    /// A tendon.
    Tendon(usize),
    /// Another element.
    Other,
}

/// An actuator: force = gain * control + bias + bias_length * length, clipped to the limits. Velocity terms are
/// omitted.
#[derive(Debug, Clone)]
pub struct Actuator {
    /// Name; empty if it has none.
    pub name: String,
    /// Element that it acts on.
    pub pull: Pull,
    /// Index into [`World::actuator_lengths`].
    pub output: usize,
    /// Index into [`World::ctrl`].
    pub ctrl: usize,
    /// Ratio of actuator length to the position of its element.
    pub gear: f64,
    /// Force per unit of control.
    pub gain: f64,
    /// Force at control 0 and length 0.
    pub bias: f64,
    /// Force per unit of length: negative for a position servo, 0 for a motor.
    pub bias_length: f64,
    /// Lowest and highest control; infinite without a limit.
    pub ctrl_range: [f64; 2],
    /// Lowest and highest force; infinite without a limit.
    pub force_range: [f64; 2],
}

impl World {
    /// Lists the model's elements.
    pub fn parts(&self) -> Parts {
        let model = self.model();
        Parts {
            bodies: bodies(model),
            joints: joints(model),
            geoms: geoms(model),
            sites: sites(model),
            equalities: equalities(model),
            tendons: tendons(model),
            actuators: actuators(model),
            excludes: model
                .exclude_signature()
                .iter()
                .map(|signature| [(signature >> 16) as usize, (signature & 0xffff) as usize])
                .collect(),
        }
    }
}

fn name(model: &MjModel, kind: MjtObjBase, id: usize) -> String {
    model.id_to_name(kind, id).unwrap_or_default().to_owned()
}

fn limits(limited: bool, range: [f64; 2]) -> [f64; 2] {
    if limited { range } else { [f64::NEG_INFINITY, f64::INFINITY] }
}

fn bodies(model: &MjModel) -> Vec<BodyNode> {
    let (parents, parts) = (model.body_parentid(), model.body_weldid());
    (0..parents.len())
        .map(|id| BodyNode {
            name: name(model, MjtObjBase::mjOBJ_BODY, id),
            parent: parents[id] as usize,
            part: parts[id] as usize,
        })
        .collect()
}

fn joints(model: &MjModel) -> Vec<Joint> {
    let joint = |id: usize| {
        let (qpos, dof) = (model.jnt_qposadr()[id] as usize, model.jnt_dofadr()[id] as usize);
        Joint {
            name: name(model, MjtObjBase::mjOBJ_JOINT, id),
            body: model.jnt_bodyid()[id] as usize,
            motion: match model.jnt_type()[id] {
                MjtJoint::mjJNT_HINGE => Motion::Hinge,
                MjtJoint::mjJNT_SLIDE => Motion::Slide,
                _ => Motion::Other,
            },
            qpos,
            dof,
            range: limits(model.jnt_limited()[id], model.jnt_range()[id]),
            stiffness: model.jnt_stiffness()[id],
            spring_ref: model.qpos_spring()[qpos],
            force_range: limits(model.jnt_actfrclimited()[id], model.jnt_actfrcrange()[id]),
        }
    };
    (0..model.jnt_type().len()).map(joint).collect()
}

fn geoms(model: &MjModel) -> Vec<Geom> {
    let geom = |id: usize| {
        let kind = model.geom_type()[id];
        Geom {
            name: name(model, MjtObjBase::mjOBJ_GEOM, id),
            body: model.geom_bodyid()[id] as usize,
            bits: [model.geom_contype()[id], model.geom_conaffinity()[id]],
            radius: model.geom_rbound()[id],
            solid: matches!(
                kind,
                MjtGeomBase::mjGEOM_SPHERE
                    | MjtGeomBase::mjGEOM_CAPSULE
                    | MjtGeomBase::mjGEOM_ELLIPSOID
                    | MjtGeomBase::mjGEOM_CYLINDER
                    | MjtGeomBase::mjGEOM_BOX
                    | MjtGeomBase::mjGEOM_MESH
            ),
            points: surface_points(model, id, kind),
        }
    };
    (0..model.geom_type().len()).map(geom).collect()
}

/// Returns the corners of meshes and boxes, and samples of round shapes.
fn surface_points(model: &MjModel, id: usize, kind: MjtGeomBase) -> Vec<DVec3> {
    let [x, y, z] = model.geom_size()[id];
    let corners = |half: DVec3| {
        (0..8).map(move |k| half * DVec3::new(sign(k & 1), sign(k & 2), sign(k & 4))).collect::<Vec<DVec3>>()
    };
    match kind {
        MjtGeomBase::mjGEOM_MESH => {
            let Ok(mesh) = usize::try_from(model.geom_dataid()[id]) else { return Vec::new() };
            let first = model.mesh_vertadr()[mesh] as usize;
            let count = model.mesh_vertnum()[mesh] as usize;
            let stride = count.div_ceil(MAX_MESH_POINTS).max(1);
            let vertices = &model.mesh_vert()[first..first + count];
            vertices.iter().step_by(stride).map(|v| DVec3::from_array(v.map(f64::from))).collect()
        }
        MjtGeomBase::mjGEOM_BOX => corners(DVec3::new(x, y, z)),
        MjtGeomBase::mjGEOM_SPHERE => round(DVec3::splat(x), 0.0),
        MjtGeomBase::mjGEOM_ELLIPSOID => round(DVec3::new(x, y, z), 0.0),
        MjtGeomBase::mjGEOM_CAPSULE => round(DVec3::splat(x), y),
        MjtGeomBase::mjGEOM_CYLINDER => corners(DVec3::new(x, x, y)),
        _ => Vec::new(),
    }
}

/// Returns points on an ellipsoid whose halves are moved apart along z by `half_length` each.
fn round(radii: DVec3, half_length: f64) -> Vec<DVec3> {
    const RINGS: usize = 8;
    let mut points = Vec::with_capacity(RINGS * (RINGS + 1));
    for ring in 0..=RINGS {
        let latitude = std::f64::consts::PI * (ring as f64 / RINGS as f64 - 0.5);
        for step in 0..RINGS {
            let longitude = std::f64::consts::TAU * step as f64 / RINGS as f64;
            let unit = DVec3::new(latitude.cos() * longitude.cos(), latitude.cos() * longitude.sin(), latitude.sin());
            points.push(radii * unit + DVec3::Z * half_length * latitude.signum());
        }
    }
    points
}

fn sign(bit: i32) -> f64 {
    if bit == 0 { -1.0 } else { 1.0 }
}

fn sites(model: &MjModel) -> Vec<Site> {
    let site = |id: usize| Site {
        name: name(model, MjtObjBase::mjOBJ_SITE, id),
        body: model.site_bodyid()[id] as usize,
        position: DVec3::from_array(model.site_pos()[id]),
    };
    (0..model.site_bodyid().len()).map(site).collect()
}

fn equalities(model: &MjModel) -> Vec<Equality> {
    let is_joint = |id: &usize| model.eq_type()[*id] == MjtEq::mjEQ_JOINT && model.eq_active0()[*id];
    (0..model.eq_type().len())
        .filter(is_joint)
        .map(|id| Equality {
            joint: model.eq_obj1id()[id] as usize,
            of: usize::try_from(model.eq_obj2id()[id]).ok(),
            polynomial: std::array::from_fn(|k| model.eq_data()[id][k]),
        })
        .collect()
}

fn tendons(model: &MjModel) -> Vec<Tendon> {
    let tendon = |id: usize| {
        let (first, count) = (model.tendon_adr()[id] as usize, model.tendon_num()[id] as usize);
        let joints = (first..first + count)
            .filter(|wrap| model.wrap_type()[*wrap] == MjtWrap::mjWRAP_JOINT)
            .map(|wrap| (model.wrap_objid()[wrap] as usize, model.wrap_prm()[wrap]));
        Tendon { name: name(model, MjtObjBase::mjOBJ_TENDON, id), joints: joints.collect() }
    };
    (0..model.tendon_adr().len()).map(tendon).collect()
}

fn actuators(model: &MjModel) -> Vec<Actuator> {
    let ffi = model.ffi();
    // With several outputs or inputs per actuator, the indices of actuators, controls and lengths differ.
    if ffi.nactuator != ffi.nu || ffi.nactuator != ffi.nout {
        return Vec::new();
    }
    let actuator = |id: usize| {
        let [target, _] = model.actuator_trnid()[id];
        let target = usize::try_from(target).unwrap_or(0);
        let pull = match model.actuator_trntype()[id] {
            MjtTrn::mjTRN_JOINT | MjtTrn::mjTRN_JOINTINPARENT => Pull::Joint(target),
            MjtTrn::mjTRN_TENDON => Pull::Tendon(target),
            _ => Pull::Other,
        };
        let affine = model.actuator_biastype()[id] == MjtBias::mjBIAS_AFFINE;
        let [bias, bias_length, ..] = model.actuator_biasprm()[id];
        Actuator {
            name: name(model, MjtObjBase::mjOBJ_ACTUATOR, id),
            pull,
            output: id,
            ctrl: id,
            gear: model.actuator_gear()[id][0],
            gain: model.actuator_gainprm()[id][0],
            bias: if affine { bias } else { 0.0 },
            bias_length: if affine { bias_length } else { 0.0 },
            ctrl_range: limits(model.actuator_ctrllimited()[id], model.actuator_ctrlrange()[id]),
            force_range: limits(model.actuator_forcelimited()[id], model.actuator_forcerange()[id]),
        }
    };
    (0..ffi.nactuator as usize).map(actuator).collect()
}
