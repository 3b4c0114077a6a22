//! What a model is made of: bodies, joints, geoms, sites, couplings and actuators, with their names.

use glam::DVec3;
use mujoco_rs::prelude::*;

use super::world::World;

/// A model's parts, in the engine's order; an index into one of the lists is the engine's.
#[derive(Debug, Clone, Default)]
pub struct Parts {
    /// Bodies; the first is the world.
    pub bodies: Vec<Body>,
    /// Joints.
    pub joints: Vec<Joint>,
    /// Geoms.
    pub geoms: Vec<Geom>,
    /// Sites.
    pub sites: Vec<Site>,
    /// Joints that follow another one, or stand still.
    pub equalities: Vec<Equality>,
    /// Tendons.
    pub tendons: Vec<Tendon>,
    /// Actuators with one force and one control.
    pub actuators: Vec<Actuator>,
    /// Pairs of bodies that never collide.
    pub excludes: Vec<[usize; 2]>,
}

/// A body.
#[derive(Debug, Clone)]
pub struct Body {
    /// Name; empty if it has none.
    pub name: String,
    /// Index of the parent; the world is its own.
    pub parent: usize,
    /// First body up the tree that a joint moves, or the world: bodies of one part move together.
    pub part: usize,
}

/// How a joint moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Motion {
    /// About an axis, rad.
    Hinge,
    /// Along an axis, m.
    Slide,
    /// A ball or a free body.
    Other,
}

/// A joint.
#[derive(Debug, Clone)]
pub struct Joint {
    /// Name; empty if it has none.
    pub name: String,
    /// Body that it moves.
    pub body: usize,
    /// How.
    pub motion: Motion,
    /// Index of its (first) position.
    pub qpos: usize,
    /// Index of its (first) degree of freedom.
    pub dof: usize,
    /// Lowest and highest position, rad or m; infinite where it has no limit.
    pub range: [f64; 2],
    /// Spring stiffness.
    pub stiffness: f64,
    /// Position at which the spring is at rest.
    pub spring_ref: f64,
    /// Least and most force of all its actuators, N m or N; infinite where it has no limit.
    pub force_range: [f64; 2],
}

/// A geom.
#[derive(Debug, Clone)]
pub struct Geom {
    /// Name; empty if it has none.
    pub name: String,
    /// Body that carries it.
    pub body: usize,
    /// Contact bits: type and affinity; both zero = it is for pictures only.
    pub bits: [i32; 2],
    /// Radius of the sphere around it, m; 0 = infinite.
    pub radius: f64,
    /// Whether it has a volume of which a signed distance is known.
    pub solid: bool,
    /// Points of its surface in its own frame, m: the corners of a mesh or of a box, some of anything round.
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

/// A joint whose position is a polynomial of another's, both counted from the initial state.
#[derive(Debug, Clone)]
pub struct Equality {
    /// The joint that follows.
    pub joint: usize,
    /// The joint it follows; None = it stands still.
    pub of: Option<usize>,
    /// Coefficients, constant first.
    pub polynomial: [f64; 5],
}

/// A tendon.
#[derive(Debug, Clone)]
pub struct Tendon {
    /// Name; empty if it has none.
    pub name: String,
    /// Joints and coefficients of a fixed tendon; empty for a tendon in space.
    pub joints: Vec<(usize, f64)>,
}

/// What an actuator pulls at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pull {
    /// A joint.
    Joint(usize),
    /// A tendon.
    Tendon(usize),
    /// Something else.
    Other,
}

/// An actuator: force = gain * control + bias + bias_length * length (velocities left out), between the limits.
#[derive(Debug, Clone)]
pub struct Actuator {
    /// Name; empty if it has none.
    pub name: String,
    /// What it pulls at.
    pub pull: Pull,
    /// Index of its length among all actuators' outputs.
    pub output: usize,
    /// Index of its control.
    pub ctrl: usize,
    /// Ratio of its length to what it pulls at.
    pub gear: f64,
    /// Force per unit of control.
    pub gain: f64,
    /// Force at control 0 and length 0.
    pub bias: f64,
    /// Force per unit of length; negative for a position servo, 0 for a motor.
    pub bias_length: f64,
    /// Least and most control; infinite where it has no limit.
    pub ctrl_range: [f64; 2],
    /// Least and most force; infinite where it has no limit.
    pub force_range: [f64; 2],
}

impl World {
    /// Lists the model's parts.
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

fn bodies(model: &MjModel) -> Vec<Body> {
    let (parents, parts) = (model.body_parentid(), model.body_weldid());
    (0..parents.len())
        .map(|id| Body {
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

/// Corners of meshes and boxes, points on anything round.
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
            // A few hundred tell where a surface ends.
            let stride = count.div_ceil(400).max(1);
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

/// Points on an ellipsoid, its halves moved apart along z.
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
    // Where an actuator has several outputs or inputs, numbers run apart; such ones are left out.
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
