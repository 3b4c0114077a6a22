//! Robot hands: a model and the facts derived from it, which a YAML file overrides.

pub mod catalogue;
mod collision_pairs;
pub mod commands;
pub mod coupling;
pub mod fingers;
pub(crate) mod kinematics;
mod labels;
pub mod lookup;
pub mod source;
pub mod spec;
mod tip;
mod urdf;
pub mod wrist_frame;

use std::path::Path;

use glam::{DMat3, DQuat, DVec3};

use self::collision_pairs::collision_pairs;
use self::commands::Commands;
use self::coupling::{Coupling, JointCoupling};
use self::fingers::Finger;
use self::spec::{CouplingsSpec, FINGERS, RobotSpec, ScaleSpec, WristAxes, finger_index};
use self::wrist_frame::WristFrame;
use crate::error::{Error, Result};
use crate::hand::Side;
use crate::mujoco::World;
use crate::mujoco::object::{OBJECT, Shapes};
use crate::mujoco::parts::{Motion, Parts};
use crate::trial::Trial;

/// Robot hand with everything that retargeting needs to know of it.
///
/// A pose is given by the free coordinates u, from which [`Coupling`] derives `qpos`; positions are in metres, angles in
/// radians. Directions are given in the wrist frame ([`WristFrame`]) or in the world of `world`.
#[derive(Debug)]
pub struct Robot {
    /// Content of its YAML file.
    pub spec: RobotSpec,
    /// Origin of its model: a file, or "part of the program".
    pub origin: String,
    /// Mesh files that could not be loaded; their shapes are missing in the model.
    pub missing_meshes: Vec<String>,
    /// Compiled model in its present pose.
    pub world: World,
    /// Bodies, joints, geoms, ... of the model.
    pub parts: Parts,
    /// Map from the free coordinates to the joints.
    pub coupling: Coupling,
    /// Fingers, thumb first.
    pub fingers: Vec<Finger>,
    /// For each human finger, the robot finger (an index into `fingers`) that takes its force.
    pub takes_force: [Option<usize>; 5],
    /// Body that carries the fingers.
    pub root: usize,
    /// Wrist frame.
    pub wrist: WristFrame,
    /// Position of the human's wrist in the wrist body's frame, m; None = the bases of the fingers coincide instead.
    pub wrist_position: Option<DVec3>,
    /// Robot metres per human metre for each human finger; None = the ratio of the fingers' lengths.
    pub scale: [Option<f64>; 5],
    /// Pairs of geoms that must not penetrate each other.
    pub collision_pairs: Vec<[usize; 2]>,
    /// Object beside the robot, if it was loaded with one.
    pub object: Option<ObjectBody>,
    /// Commands for the drivers.
    pub commands: Commands,
    /// Free coordinates of the rest pose, in which all facts were derived.
    pub rest: Vec<f64>,
}

/// Object beside a robot, in the robot's model.
#[derive(Debug, Clone)]
pub struct ObjectBody {
    /// Body that carries it.
    pub body: usize,
    /// Its geoms.
    pub geoms: Vec<usize>,
    mocap: usize,
}

/// Position of an absent object in the world, m: far beyond any hand's reach.
const AWAY: DVec3 = DVec3::new(0.0, 0.0, 1e3);

impl Robot {
    /// Loads a robot: a name of `egotac retarget list` or its start, a YAML file, or a model (MJCF or URDF) without one. `model`
    /// replaces the model that the YAML file names.
    ///
    /// # Errors
    /// If it can't be found or read, the YAML file names something that the model lacks (the error lists the known names),
    /// or the model is not a hand.
    pub fn load(robot: &str, model: Option<&Path>) -> Result<Self> {
        Self::load_with_object(robot, model, None)
    }

    /// Loads a robot with an object beside it, which is absent until it is placed; otherwise as [`Self::load`].
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn load_with_object(robot: &str, model: Option<&Path>, object: Option<&Shapes>) -> Result<Self> {
        let robot = &catalogue::complete(robot)?;
        if model.is_some() || !source::has_own_model(robot) {
            Trial::Robot { robot: robot.to_owned(), model: model.map(Path::to_path_buf) }.run()?;
        }
        let source::RobotSource { spec, world, origin, missing_meshes } = source::open(robot, model, object)?;
        let missing = missing_meshes.clone();
        Self::new(spec, world, origin.clone(), missing_meshes)
            .map_err(|error| urdf::without_meshes(&origin, &missing, error))
    }

    /// Derives a robot from its spec and compiled model.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn new(spec: RobotSpec, mut world: World, origin: String, missing_meshes: Vec<String>) -> Result<Self> {
        let parts = world.parts();
        let object = find_object(&mut world, &parts);
        let initial = world.qpos().to_vec();
        let root = spec.model.root.as_deref().map(|name| lookup::body(&parts, name)).transpose()?;
        let mut fixed = fixed_joints(&spec, &parts, &initial, root)?;
        let mut qpos = rest_qpos(&parts, &initial, &fixed);
        world.set_qpos(&qpos)?;
        world.update_poses();
        let moves: Vec<bool> = (0..parts.joints.len())
            .map(|joint| fixed[joint].is_none() && parts.joints[joint].motion != Motion::Other)
            .collect();
        let mut fingers = fingers::find(&world, &parts, &spec, &moves)?;
        let root = root.unwrap_or_else(|| common_body(&parts, &fingers));
        fix_arm(&parts, root, &qpos, &mut fixed, &mut fingers)?;
        let more = more_couplings(&spec, &parts)?;
        let coupling = Coupling::derive(&mut world, &parts, &initial, &fixed, &more, spec.limits.margin)?;
        let mut rest = vec![0.0; coupling.len()];
        coupling.reduce(&parts, &qpos, &mut rest);
        coupling.expand(&parts, &rest, &mut qpos);
        world.set_qpos(&qpos)?;
        world.update_poses();
        let wrist = wrist_frame(&spec, &world, &parts, &fingers, root)?;
        for name in spec.neutral.keys() {
            lookup::joint(&parts, name)?;
        }
        Ok(Self {
            takes_force: takers(&spec, &fingers)?,
            collision_pairs: collision_pairs(&spec.collision, &parts, &fingers)?,
            commands: Commands::new(&parts, &coupling, spec.output.order),
            wrist_position: spec.wrist.pos.map(DVec3::from_array),
            scale: scales(&spec),
            spec,
            origin,
            missing_meshes,
            world,
            parts,
            coupling,
            fingers,
            root,
            wrist,
            object,
            rest,
        })
    }

    /// Side of the hand.
    pub fn side(&self) -> Side {
        self.wrist.side
    }

    /// Returns the names of all hinges and slides, in the order of [`super::Output::qpos`].
    pub fn joint_names(&self) -> Vec<&str> {
        self.output_joints().map(|joint| self.parts.joints[joint].name.as_str()).collect()
    }

    /// Returns the indices of all hinges and slides, in the order of [`super::Output::qpos`].
    pub fn output_joints(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.parts.joints.len()).filter(|joint| self.parts.joints[*joint].motion != Motion::Other)
    }

    /// Returns the positions of the rest pose, rad or m, in the order of [`super::Output::qpos`].
    pub fn rest_positions(&self) -> Vec<f64> {
        let mut all = self.world.qpos().to_vec();
        self.coupling.expand(&self.parts, &self.rest, &mut all);
        self.output_joints().map(|joint| all[self.parts.joints[joint].qpos]).collect()
    }

    /// Position of a finger's base knuckle relative to the wrist body's origin, m, in the axes of the wrist frame.
    pub fn base(&self, finger: &Finger) -> DVec3 {
        let (origin, _) = self.world.body_pose(self.wrist.body);
        let to_wrist: DMat3 = self.wrist.world_axes(&self.world).transpose();
        let first = finger.knuckles.len().saturating_sub(3);
        let joint = finger.knuckles.get(first).or(finger.joints.first());
        to_wrist * (joint.map_or(origin, |joint| self.world.joint_axis(*joint).0) - origin)
    }

    /// Mean of [`Self::base`] over the selected fingers, m.
    pub fn bases(&self, which: impl Fn(&Finger) -> bool) -> DVec3 {
        let chosen: Vec<&Finger> = self.fingers.iter().filter(|finger| which(finger)).collect();
        chosen.iter().map(|finger| self.base(finger)).sum::<DVec3>() / chosen.len().max(1) as f64
    }

    /// Moves to the pose of free coordinates `u`; updates poses of bodies and geoms, no velocities or contacts.
    pub(crate) fn set_pose(&mut self, u: &[f64]) {
        self.coupling.expand(&self.parts, u, self.world.qpos_mut());
        self.world.update_poses();
    }

    /// Places the object in the world (m, rotation from its axes to the world's); None = absent. Takes effect with the next
    /// `world.update_poses()`.
    pub fn place_object(&mut self, pose: Option<(DVec3, DQuat)>) {
        if let Some(object) = &self.object {
            let (position, orientation) = pose.unwrap_or((AWAY, DQuat::IDENTITY));
            self.world.set_mocap(object.mocap, position, orientation);
        }
    }

    /// Returns the pairs of a geom of the hand and one of the object; empty without object.
    pub fn object_pairs(&self) -> Vec<[usize; 2]> {
        let Some(object) = &self.object else { return Vec::new() };
        let of_hand = |geom: &usize| {
            let geom = &self.parts.geoms[*geom];
            geom.solid && geom.bits != [0, 0] && is_above(&self.parts, self.root, geom.body)
        };
        let hand = (0..self.parts.geoms.len()).filter(of_hand);
        hand.flat_map(|a| object.geoms.iter().map(move |b| [a, *b])).collect()
    }

    /// True for two jaws with one joint each, which can only open and close.
    pub fn is_gripper(&self) -> bool {
        self.fingers.len() == 2 && self.fingers.iter().all(|finger| finger.joints.len() == 1)
    }
}

/// Finds the object in a model and moves it away.
fn find_object(world: &mut World, parts: &Parts) -> Option<ObjectBody> {
    let body = parts.bodies.iter().position(|body| body.name == OBJECT)?;
    let mocap = world.mocap(OBJECT).ok()?;
    let geoms = (0..parts.geoms.len()).filter(|geom| parts.geoms[*geom].body == body).collect();
    world.set_mocap(mocap, AWAY, DQuat::IDENTITY);
    Some(ObjectBody { body, geoms, mocap })
}

/// Returns the position of each joint that stands still, rad or m; None = it moves.
fn fixed_joints(spec: &RobotSpec, parts: &Parts, initial: &[f64], root: Option<usize>) -> Result<Vec<Option<f64>>> {
    let mut fixed = vec![None; parts.joints.len()];
    for (name, position) in &spec.fixed_joints {
        let joint = lookup::joint(parts, name)?;
        let [low, high] = parts.joints[joint].range;
        if !(low..=high).contains(position) {
            return Err(Error::value(format!("fixed_joints.{name}"), format!("{low} to {high}"), position));
        }
        fixed[joint] = Some(*position);
    }
    let Some(root) = root else { return Ok(fixed) };
    for (index, joint) in parts.joints.iter().enumerate().filter(|(_, joint)| joint.motion != Motion::Other) {
        // The arm below the hand and another hand beside it stand still.
        let is_of_hand = joint.body != root && is_above(parts, root, joint.body);
        if !is_of_hand {
            fixed[index].get_or_insert(initial[joint.qpos].clamp(joint.range[0], joint.range[1]));
        }
    }
    Ok(fixed)
}

/// Returns `qpos` of the rest pose: fixed joints at their positions, all others at their initial ones, within limits.
fn rest_qpos(parts: &Parts, initial: &[f64], fixed: &[Option<f64>]) -> Vec<f64> {
    let mut qpos = initial.to_vec();
    for (joint, position) in parts.joints.iter().zip(fixed).filter(|(joint, _)| joint.motion != Motion::Other) {
        qpos[joint.qpos] = position.unwrap_or(qpos[joint.qpos].clamp(joint.range[0], joint.range[1]));
    }
    qpos
}

/// Fixes the joints below the fingers, which belong to the arm, and removes fixed joints from the fingers.
///
/// # Errors
/// If a finger has no joint left.
fn fix_arm(parts: &Parts, root: usize, qpos: &[f64], fixed: &mut [Option<f64>], fingers: &mut [Finger]) -> Result<()> {
    for (position, joint) in fixed.iter_mut().zip(&parts.joints) {
        if is_above(parts, joint.body, root) && joint.motion != Motion::Other {
            position.get_or_insert(qpos[joint.qpos]);
        }
    }
    for finger in fingers {
        finger.joints.retain(|joint| fixed[*joint].is_none());
        finger.knuckles.retain(|joint| fixed[*joint].is_none());
        if finger.joints.is_empty() {
            let name = format!("finger {}", FINGERS[finger.human]);
            return Err(Error::value(name, "a joint that moves", "none: all stand still"));
        }
    }
    Ok(())
}

/// True if `above` is `body` or carries it.
fn is_above(parts: &Parts, above: usize, body: usize) -> bool {
    let mut at = body;
    while at != 0 && at != above {
        at = parts.bodies[at].parent;
    }
    at == above
}

/// Returns the lowest body that carries the bases of all fingers.
fn common_body(parts: &Parts, fingers: &[Finger]) -> usize {
    let first = fingers[0].links.first().copied().unwrap_or(0);
    let mut at = parts.bodies[first].parent;
    let carries_all =
        |at: usize| fingers.iter().all(|finger| finger.links.first().is_some_and(|b| is_above(parts, at, *b)));
    while at != 0 && !carries_all(at) {
        at = parts.bodies[at].parent;
    }
    at
}

/// Returns the couplings that the file adds to the model's.
fn more_couplings(spec: &RobotSpec, parts: &Parts) -> Result<Vec<JointCoupling>> {
    let CouplingsSpec::More(written) = &spec.couplings else { return Ok(Vec::new()) };
    let coupling = |written: &spec::CouplingSpec| {
        let (joint, of) = (lookup::joint(parts, &written.joint)?, lookup::joint(parts, &written.of)?);
        Ok(JointCoupling { joint, of, ratio: written.ratio, offset: written.offset })
    };
    written.iter().map(coupling).collect()
}

/// Returns the wrist frame of the file, or derives it from the fingers.
fn wrist_frame(spec: &RobotSpec, world: &World, parts: &Parts, fingers: &[Finger], root: usize) -> Result<WristFrame> {
    let body = spec.wrist.body.as_deref().map(|name| lookup::body(parts, name)).transpose()?.unwrap_or(root);
    match &spec.wrist.frame {
        WristAxes::Auto => WristFrame::derive(world, fingers, body, spec.side),
        WristAxes::Rows(rows) => WristFrame::given(body, *rows),
    }
}

/// Returns robot metres per human metre for each human finger; None = the file leaves it to the fingers' lengths.
fn scales(spec: &RobotSpec) -> [Option<f64>; 5] {
    match &spec.scale {
        ScaleSpec::Auto => [None; 5],
        ScaleSpec::Number(number) => [Some(*number); 5],
        ScaleSpec::Fingers(scales) => FINGERS.map(|finger| scales.get(finger).copied()),
    }
}

/// Returns the robot finger that takes each human finger's force: its own, the one that `merge` names, or the nearest.
fn takers(spec: &RobotSpec, fingers: &[Finger]) -> Result<[Option<usize>; 5]> {
    let own = |human: usize| fingers.iter().position(|finger| finger.human == human);
    let mut takers = [None; 5];
    for (human, taker) in takers.iter_mut().enumerate() {
        *taker = own(human).or_else(|| {
            // The thumb presses against the other fingers: they can't replace it, nor it them.
            let near = fingers.iter().enumerate().filter(|(_, finger)| (finger.human == 0) == (human == 0));
            near.min_by_key(|(_, finger)| finger.human.abs_diff(human)).map(|(index, _)| index)
        });
    }
    for (from, to) in &spec.merge {
        let (from, to) = (finger_index(from)?, finger_index(to)?);
        let Some(taker) = own(to) else {
            let known: Vec<&str> = fingers.iter().map(|finger| FINGERS[finger.human]).collect();
            return Err(Error::unknown("merge: finger", FINGERS[to], known));
        };
        takers[from] = Some(taker);
    }
    Ok(takers)
}
