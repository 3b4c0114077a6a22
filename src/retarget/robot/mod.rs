//! Robots: a model and what is derived from it, overridden by a YAML file where it says otherwise.

pub mod commands;
pub mod coupling;
pub mod fingers;
pub mod frame;
pub mod source;
pub mod spec;
pub mod urdf;

use std::path::Path;

use glam::{DMat3, DQuat, DVec3};

use self::commands::Commands;
use self::coupling::{Coupling, Follow};
use self::fingers::Finger;
use self::frame::WristFrame;
use self::spec::{Axes, Couplings, Pairs, Scale, Spec, finger_index};
use super::human::{self, Hand};
use crate::error::{Error, Result};
use crate::hand::Side;
use crate::mujoco::World;
use crate::mujoco::object::{OBJECT, Shapes};
use crate::mujoco::parts::{Motion, Parts};

/// A robot hand, ready to be retargeted to.
#[derive(Debug)]
pub struct Robot {
    /// What its YAML file says.
    pub spec: Spec,
    /// Where its model came from.
    pub origin: String,
    /// Meshes of shapes that could not be loaded.
    pub lost: Vec<String>,
    /// The model, in the pose it was derived in.
    pub world: World,
    /// Its parts.
    pub parts: Parts,
    /// How its joints follow from the free coordinates.
    pub coupling: Coupling,
    /// Its fingers, thumb first.
    pub fingers: Vec<Finger>,
    /// For each human finger, the robot finger (an index into `fingers`) that takes its force.
    pub takes_force: [Option<usize>; 5],
    /// The body that carries the fingers.
    pub root: usize,
    /// The wrist frame.
    pub wrist: WristFrame,
    /// The human's wrist in the wrist body's frame, m; None = finger bases are laid over each other.
    pub wrist_position: Option<DVec3>,
    /// Robot metres per metre of each human finger; None = robot finger over human finger, whatever their lengths.
    pub scale: [Option<f64>; 5],
    /// Pairs of geoms that must not run into each other.
    pub pairs: Vec<[usize; 2]>,
    /// The object beside it, if it was loaded with one.
    pub object: Option<ObjectBody>,
    /// What the drivers get.
    pub commands: Commands,
    /// Free coordinates in the pose everything was derived in.
    pub rest: Vec<f64>,
}

/// An object beside a robot, in the robot's model.
#[derive(Debug, Clone)]
pub struct ObjectBody {
    /// The body that carries it.
    pub body: usize,
    /// Its shapes.
    pub geoms: Vec<usize>,
    mocap: usize,
}

/// Where an object is kept that is not there, m: out of everybody's reach.
const AWAY: DVec3 = DVec3::new(0.0, 0.0, 1e3);

impl Robot {
    /// Loads a robot: a name of the program's own, a YAML file, or a model alone; `model` replaces the YAML's model.
    ///
    /// # Errors
    /// If it can't be found or read, names something that the model does not have (the error lists what it has), or is
    /// no hand.
    pub fn load(robot: &str, model: Option<&Path>) -> Result<Self> {
        Self::load_beside(robot, model, None)
    }

    /// Likewise, with an object beside it, which is away until it is placed.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn load_beside(robot: &str, model: Option<&Path>, object: Option<&Shapes>) -> Result<Self> {
        let source::Source { spec, world, origin, lost } = source::open(robot, model, object)?;
        Self::new(spec, world, origin, lost)
    }

    /// Makes a robot of its spec and compiled model.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn new(spec: Spec, mut world: World, origin: String, lost: Vec<String>) -> Result<Self> {
        let parts = world.parts();
        let object = object_of(&mut world, &parts);
        let initial = world.qpos().to_vec();
        let root = spec.model.root.as_deref().map(|name| fingers::body(&parts, name)).transpose()?;
        let fixed = fixed_joints(&spec, &parts, &initial, root)?;
        let moves: Vec<bool> = (0..parts.joints.len())
            .map(|joint| fixed[joint].is_none() && parts.joints[joint].motion != Motion::Other)
            .collect();
        let mut qpos = initial.clone();
        for (joint, position) in parts.joints.iter().zip(&fixed) {
            if joint.motion != Motion::Other {
                qpos[joint.qpos] = position.unwrap_or(qpos[joint.qpos].clamp(joint.range[0], joint.range[1]));
            }
        }
        world.set_qpos(&qpos)?;
        world.update_poses();
        let mut fingers = fingers::find(&world, &parts, &spec, &moves)?;
        let root = root.unwrap_or_else(|| common_body(&parts, &fingers));
        // Joints below the fingers carry the whole hand: they are the arm's.
        let mut fixed = fixed;
        for (joint, there) in fixed.iter_mut().enumerate() {
            if is_above(&parts, parts.joints[joint].body, root) && parts.joints[joint].motion != Motion::Other {
                there.get_or_insert(qpos[parts.joints[joint].qpos]);
            }
        }
        for finger in &mut fingers {
            finger.joints.retain(|joint| fixed[*joint].is_none());
            finger.knuckles.retain(|joint| fixed[*joint].is_none());
        }
        if let Some(stiff) = fingers.iter().find(|finger| finger.joints.is_empty()) {
            let what = format!("finger {}", spec::FINGERS[stiff.human]);
            return Err(Error::value(what, "a joint that moves", "none: all stand still"));
        }
        let more = match &spec.couplings {
            Couplings::Auto => Vec::new(),
            Couplings::More(couplings) => couplings.iter().map(|c| follow(&parts, c)).collect::<Result<_>>()?,
        };
        let coupling = Coupling::derive(&mut world, &parts, &initial, &fixed, &more, spec.limits.margin)?;
        let mut rest = vec![0.0; coupling.len()];
        coupling.reduce(&parts, &qpos, &mut rest);
        coupling.expand(&parts, &rest, &mut qpos);
        world.set_qpos(&qpos)?;
        world.update_poses();
        let wrist_body =
            spec.wrist.body.as_deref().map(|name| fingers::body(&parts, name)).transpose()?.unwrap_or(root);
        let wrist = match &spec.wrist.frame {
            Axes::Auto => WristFrame::derive(&world, &fingers, wrist_body, spec.side)?,
            Axes::Rows(rows) => WristFrame::given(wrist_body, *rows)?,
        };
        let scale = scales(&spec);
        let takes_force = takers(&spec, &fingers)?;
        let pairs = pairs(&spec, &parts, &fingers)?;
        for name in spec.neutral.keys() {
            fingers::joint(&parts, name)?;
        }
        let commands = Commands::new(&parts, &coupling, spec.output.order);
        let wrist_position = spec.wrist.pos.map(DVec3::from_array);
        Ok(Self {
            spec,
            origin,
            lost,
            world,
            parts,
            coupling,
            fingers,
            takes_force,
            root,
            wrist,
            wrist_position,
            scale,
            pairs,
            object,
            commands,
            rest,
        })
    }

    /// Which hand it is.
    pub fn side(&self) -> Side {
        self.wrist.side
    }

    /// Names of all hinges and slides, in the order of `qpos`.
    pub fn joint_names(&self) -> Vec<&str> {
        self.output_joints().map(|joint| self.parts.joints[joint].name.as_str()).collect()
    }

    /// All hinges and slides, as indices of joints.
    pub fn output_joints(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.parts.joints.len()).filter(|joint| self.parts.joints[*joint].motion != Motion::Other)
    }

    /// Where a finger's first phalanx begins, in the wrist frame's coordinates about the wrist body's origin, m.
    pub fn base(&self, finger: &Finger) -> DVec3 {
        let (origin, _) = self.world.body_pose(self.wrist.body);
        let to_wrist: DMat3 = self.wrist.world_axes(&self.world).transpose();
        let first = finger.knuckles.len().saturating_sub(3);
        let joint = finger.knuckles.get(first).or(finger.joints.first());
        to_wrist * (joint.map_or(origin, |joint| self.world.joint_axis(*joint).0) - origin)
    }

    /// The same, on average over the given fingers.
    pub fn bases(&self, which: impl Fn(&Finger) -> bool) -> DVec3 {
        let chosen: Vec<&Finger> = self.fingers.iter().filter(|finger| which(finger)).collect();
        chosen.iter().map(|finger| self.base(finger)).sum::<DVec3>() / chosen.len().max(1) as f64
    }

    /// Places the object; None = there is none. Poses are those of before until they are found anew.
    pub fn place_object(&mut self, pose: Option<(DVec3, DQuat)>) {
        if let Some(object) = &self.object {
            let (place, orientation) = pose.unwrap_or((AWAY, DQuat::IDENTITY));
            self.world.set_mocap(object.mocap, place, orientation);
        }
    }

    /// Pairs of the hand's shapes and the object's.
    pub fn against_object(&self) -> Vec<[usize; 2]> {
        let Some(object) = &self.object else { return Vec::new() };
        let of_hand = |geom: &usize| {
            let geom = &self.parts.geoms[*geom];
            geom.solid && geom.bits != [0, 0] && is_above(&self.parts, self.root, geom.body)
        };
        let hand = (0..self.parts.geoms.len()).filter(of_hand);
        hand.flat_map(|a| object.geoms.iter().map(move |b| [a, *b])).collect()
    }

    /// Whether it is a pair of jaws, of which nothing but the opening can be asked.
    pub fn is_gripper(&self) -> bool {
        self.fingers.len() == 2 && self.fingers.iter().all(|finger| finger.joints.len() == 1)
    }
}

/// The object in a model, put away.
fn object_of(world: &mut World, parts: &Parts) -> Option<ObjectBody> {
    let body = parts.bodies.iter().position(|body| body.name == OBJECT)?;
    let mocap = world.mocap(OBJECT).ok()?;
    let geoms = (0..parts.geoms.len()).filter(|geom| parts.geoms[*geom].body == body).collect();
    world.set_mocap(mocap, AWAY, DQuat::IDENTITY);
    Some(ObjectBody { body, geoms, mocap })
}

/// Position of each joint that stands still.
fn fixed_joints(spec: &Spec, parts: &Parts, initial: &[f64], root: Option<usize>) -> Result<Vec<Option<f64>>> {
    let mut fixed = vec![None; parts.joints.len()];
    for (name, position) in &spec.fixed_joints {
        let joint = fingers::joint(parts, name)?;
        let [low, high] = parts.joints[joint].range;
        if !(low..=high).contains(position) {
            return Err(Error::value(format!("fixed_joints.{name}"), format!("{low} to {high}"), position));
        }
        fixed[joint] = Some(*position);
    }
    let Some(root) = root else { return Ok(fixed) };
    for (index, joint) in parts.joints.iter().enumerate().filter(|(_, joint)| joint.motion != Motion::Other) {
        // Neither the arm below the hand nor another hand beside it is moved.
        let is_of_hand = joint.body != root && is_above(parts, root, joint.body);
        if !is_of_hand {
            fixed[index].get_or_insert(initial[joint.qpos].clamp(joint.range[0], joint.range[1]));
        }
    }
    Ok(fixed)
}

/// Whether `above` is `body` or one that carries it.
fn is_above(parts: &Parts, above: usize, body: usize) -> bool {
    let mut at = body;
    while at != 0 && at != above {
        at = parts.bodies[at].parent;
    }
    at == above
}

/// The lowest body that carries the bases of all fingers.
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

fn follow(parts: &Parts, written: &spec::CouplingSpec) -> Result<Follow> {
    Ok(Follow {
        joint: fingers::joint(parts, &written.joint)?,
        of: fingers::joint(parts, &written.of)?,
        ratio: written.ratio,
        offset: written.offset,
    })
}

/// Robot metres per metre of each human finger, where the file says; None = each finger's own length decides.
fn scales(spec: &Spec) -> [Option<f64>; 5] {
    match &spec.scale {
        Scale::Auto => [None; 5],
        Scale::Number(number) => [Some(*number); 5],
        Scale::Fingers(scales) => spec::FINGERS.map(|finger| scales.get(finger).copied()),
    }
}

/// Which robot finger takes each human finger's force: its own, the one it is merged to, or the nearest there is.
fn takers(spec: &Spec, fingers: &[Finger]) -> Result<[Option<usize>; 5]> {
    let own = |human: usize| fingers.iter().position(|finger| finger.human == human);
    let mut takers = [None; 5];
    for (human, taker) in takers.iter_mut().enumerate() {
        *taker = own(human).or_else(|| {
            // A thumb's force is the other fingers' opposite: nobody takes its place.
            let near = fingers.iter().enumerate().filter(|(_, finger)| (finger.human == 0) == (human == 0));
            near.min_by_key(|(_, finger)| finger.human.abs_diff(human)).map(|(index, _)| index)
        });
    }
    for (from, to) in &spec.merge {
        let (from, to) = (finger_index(from)?, finger_index(to)?);
        let Some(taker) = own(to) else {
            let known: Vec<&str> = fingers.iter().map(|finger| spec::FINGERS[finger.human]).collect();
            return Err(Error::unknown("merge: finger", spec::FINGERS[to], known));
        };
        takers[from] = Some(taker);
    }
    Ok(takers)
}

/// Pairs of geoms of different fingers, or of a finger and what carries it, that the model lets collide.
fn pairs(spec: &Spec, parts: &Parts, fingers: &[Finger]) -> Result<Vec<[usize; 2]>> {
    let ignored: Vec<[usize; 2]> = spec
        .collision
        .ignore
        .iter()
        .map(|[a, b]| Ok([fingers::body(parts, a)?, fingers::body(parts, b)?]))
        .collect::<Result<_>>()?;
    if spec.collision.pairs == Pairs::None {
        return Ok(Vec::new());
    }
    let part = |geom: usize| parts.bodies[parts.geoms[geom].body].part;
    let finger = |geom: usize| fingers.iter().position(|finger| finger.links.contains(&part(geom)));
    let solid: Vec<usize> = (0..parts.geoms.len()).filter(|geom| parts.geoms[*geom].solid).collect();
    let mut pairs = Vec::new();
    for (index, a) in solid.iter().copied().enumerate() {
        for b in solid[index + 1..].iter().copied() {
            let (bits_a, bits_b) = (parts.geoms[a].bits, parts.geoms[b].bits);
            let may = bits_a[0] & bits_b[1] != 0 || bits_b[0] & bits_a[1] != 0;
            let apart = finger(a) != finger(b) && (finger(a).is_some() || finger(b).is_some());
            let related = is_neighbour(parts, part(a), part(b));
            let bodies = [parts.geoms[a].body, parts.geoms[b].body];
            let listed =
                |list: &[[usize; 2]]| list.iter().any(|pair| *pair == bodies || *pair == [bodies[1], bodies[0]]);
            if may && apart && !related && !listed(&ignored) && !listed(&parts.excludes) {
                pairs.push([a, b]);
            }
        }
    }
    Ok(pairs)
}

/// Whether one of two parts carries the other, as the engine sees it: it lets such pairs pass, unless one is the world.
fn is_neighbour(parts: &Parts, a: usize, b: usize) -> bool {
    let above = |part: usize| parts.bodies[parts.bodies[part].parent].part;
    a == b || above(a) == b || above(b) == a
}

/// Size of the built-in hand, m.
///
/// # Errors
/// Never with the hand that is part of the program.
pub fn reference_size() -> Result<f64> {
    Ok(human::size(&Hand::reference()?.points))
}
