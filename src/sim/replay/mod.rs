//! Replay of recorded stores: the engine's contact forces along recorded poses of hands and objects.
//!
//! ```text
//! poses of hands, objects ──> splines ──> positions, velocities, accelerations ──> inverse dynamics ──> contact forces
//! ```
//!
//! Hands and objects follow the recording, so nothing drifts, and no controller has to be tuned. The contact model turns depth
//! and sliding of the recorded poses into force, so a squeeze shows as depth: a second estimate beside forces from motion,
//! which do not see it. Depths of contacts are below a millimetre: noise of that size in poses drowns them.

mod agreement;
mod angles;

use std::path::Path;

use glam::DVec3;

pub use agreement::{Agreement, ReplayReport};
use angles::HandAngles;

use super::effect::Effect;
use super::rig::JOINT_NAMES;
use super::scene::EffectPlan;
use super::{Rollout, RolloutOptions, stored_scene};
use crate::dataset::EpisodeReader;
use crate::dataset::zarr::{LEFT_HAND_POSE, OBJECT_POSE, RIGHT_HAND_POSE, TIMESTAMPS, ZarrReader};
use crate::error::{Error, Result};
use crate::hand::{HandParams, N_JOINTS, Side};
use crate::mujoco::World;
use crate::mujoco::world::{Body, FreeJoint, Servo};
use crate::physics::Pose;
use crate::physics::motion::Motion;
use crate::physics::spline::Smoother;
use crate::tactile::episode_ranges;

/// Bandwidth of the splines, relative to the frame rate.
const BANDWIDTH: f64 = 0.3;
/// Largest distance of a stored object from the one that the seed gives at the first frame, m.
const TOLERANCE: f64 = 2e-3;

/// Forces of one replayed frame.
#[derive(Debug, Clone, PartialEq)]
pub struct ReplayFrame {
    /// Index of the frame in the store.
    pub frame: usize,
    /// Normal force on each link of the left and the right hand, N; zero for an absent hand.
    pub links: [[f64; N_JOINTS]; 2],
    /// Net force of all contacts on each object, world frame, N.
    pub net: Vec<DVec3>,
}

/// Computes the engine's contact forces along the poses of a store of the simulator, frame by frame.
///
/// # Errors
/// If the store lacks poses or was not simulated, its scene has objects that do not move freely, or an array is damaged.
pub fn replay(path: &Path) -> Result<Vec<ReplayFrame>> {
    let store = ZarrReader::open(path)?;
    for name in [OBJECT_POSE, LEFT_HAND_POSE, RIGHT_HAND_POSE] {
        if !store.has(name) {
            let expected =
                format!("expected an array {name}, along which a replay drives the hands and objects; got none");
            return Err(Error::file(path, expected));
        }
    }
    let mut frames = Vec::new();
    for (index, range) in episode_ranges(store.episode_ends()).enumerate() {
        let named = |error: Error| Error::file(path, format!("episode {index}: {error}"));
        let times = store.read(TIMESTAMPS, range.clone())?.into_f64();
        let mut stage = Stage::new(&store, index).map_err(named)?;
        let courses = stage.courses(&store, range.clone(), &times).map_err(named)?;
        for at in 0..times.len() {
            frames.push(stage.frame(range.start + at, at, &courses).map_err(named)?);
        }
    }
    Ok(frames)
}

/// World of one episode, with handles of what moves.
struct Stage {
    rollout: Rollout,
    /// Servos (wrist, then hinges) and links of the left and the right hand; `None` = absent.
    hands: [Option<(Vec<Servo>, Vec<Body>)>; 2],
    objects: Vec<(Body, FreeJoint)>,
}

/// Motion of an episode: values with two derivatives of each servo of both hands, and of each object, at each frame.
struct Courses {
    servos: [Vec<Vec<[f64; 3]>>; 2],
    objects: Vec<Vec<ObjectState>>,
}

#[derive(Clone, Copy)]
struct ObjectState {
    pose: Pose,
    linear: [DVec3; 2],
    angular: [DVec3; 2],
}

impl Stage {
    /// Builds the world that episode `index` of a store was simulated in.
    fn new(store: &ZarrReader, index: usize) -> Result<Self> {
        let (Some(name), Some(seed)) = stored_scene::origin(store, index) else {
            let expected = "attribute `episodes` with scene and seed, as `egotac sim run` writes it";
            return Err(Error::value("store", expected, "none: only stores of the simulator can be replayed"));
        };
        let scene = stored_scene::scene(store, name)?;
        // Contacts of sleeping bodies are not listed.
        let effects = Some(EffectPlan::of(&scene.spec)?.effects().without(Effect::Sleep));
        let options = RolloutOptions { picture: None, effects, ..RolloutOptions::default() };
        store.attributes().topology.must_match(options.hands[0].topology)?;
        let rollout = Rollout::new(&scene, seed, &options)?;
        let mut objects = Vec::new();
        for object in rollout.objects() {
            match (object.body(), object.joint) {
                (Some(body), Some(joint)) => objects.push((body, joint)),
                (Some(_), None) => {
                    let name = format!("object {}", object.name);
                    return Err(Error::value(
                        name,
                        "an object that moves freely, for a replay",
                        "a joint or a soft body",
                    ));
                }
                (None, _) => (),
            }
        }
        let mut hands = [None, None];
        for hand in &rollout.episode().hands {
            let rig = &rollout.rigs()[hand.side as usize];
            let (world, hinges) = (rollout.world(), rig.hinges.iter().map(|hinge| hinge.name.as_str()));
            let servos = super::mjcf::WRIST.into_iter().chain(hinges).map(|name| world.servo(&rig.name(name)));
            let links = JOINT_NAMES.iter().map(|name| world.body(&rig.name(name)));
            hands[hand.side as usize] = Some((servos.collect::<Result<_>>()?, links.collect::<Result<_>>()?));
        }
        Ok(Self { rollout, hands, objects })
    }

    /// Reads the recorded poses, and differentiates them.
    fn courses(&self, store: &ZarrReader, range: std::ops::Range<usize>, times: &[f64]) -> Result<Courses> {
        let span = times.last().copied().unwrap_or(0.0) - times.first().copied().unwrap_or(0.0);
        let interval = span / (times.len().max(2) - 1) as f64;
        let smoother = Smoother::new(times, &vec![1.0; times.len()], interval, BANDWIDTH / interval);
        let Some(smoother) = smoother else {
            return Err(Error::value(TIMESTAMPS, "at least two frames at ascending times", times.len()));
        };
        let mut servos = [Vec::new(), Vec::new()];
        for hand in &self.rollout.episode().hands {
            let name = if hand.side == Side::Left { LEFT_HAND_POSE } else { RIGHT_HAND_POSE };
            let rows = store.read_f32(name, range.clone())?;
            let mut angles = HandAngles::new(&self.rollout.rigs()[hand.side as usize], hand.wrist, hand.orientation);
            let mut columns: Vec<Vec<f64>> = Vec::new();
            for row in rows.as_chunks::<61>().0 {
                if row.iter().any(|value| !value.is_finite()) {
                    return Err(Error::value(name, "a known pose in each frame", "NaN"));
                }
                let values = angles.of(&HandParams::from_array(row));
                columns.resize(values.len(), Vec::new());
                columns.iter_mut().zip(values).for_each(|(column, value)| column.push(value));
            }
            let fits: Vec<Vec<f64>> = columns.iter().map(|column| smoother.fit(column)).collect();
            servos[hand.side as usize] = times
                .iter()
                .enumerate()
                .map(|(at, time)| {
                    let of = |(fit, column): (&Vec<f64>, &Vec<f64>)| {
                        let [_, velocity, acceleration] = smoother.at(fit, *time);
                        // The recorded place itself: depth of contacts is what turns into force.
                        [column[at], velocity, acceleration]
                    };
                    fits.iter().zip(&columns).map(of).collect()
                })
                .collect();
        }
        let rows = store.read_f32(OBJECT_POSE, range)?;
        let stored = rows.len() / (7 * times.len().max(1));
        if stored < self.objects.len() {
            return Err(Error::shape(
                OBJECT_POSE,
                format!("(T, >= {}, 7)", self.objects.len()),
                [times.len(), stored, 7],
            ));
        }
        let mut objects = Vec::new();
        for (object, (body, _)) in self.objects.iter().enumerate() {
            let row = |frame: usize| rows[7 * (frame * stored + object)..].first_chunk::<7>().and_then(Pose::from_row);
            let poses: Vec<Option<Pose>> = (0..times.len()).map(row).collect();
            let motion = Motion::new(times, &poses, DVec3::ZERO, Some(BANDWIDTH / interval));
            let states = poses.iter().zip(&motion.frames).map(|(pose, state)| {
                let (pose, state) = pose.zip(*state)?;
                Some(ObjectState {
                    pose,
                    linear: [state.velocity, state.acceleration],
                    angular: [state.angular_velocity, state.angular_acceleration],
                })
            });
            let Some(states) = states.collect::<Option<Vec<ObjectState>>>() else {
                return Err(Error::value(OBJECT_POSE, "a known pose of every object in each frame", "NaN"));
            };
            let start = self.rollout.world().position(*body);
            let off = states.first().map_or(0.0, |state| state.pose.position.distance(start));
            if off > TOLERANCE {
                let expected = format!("object {object} at {start}, as scene and seed give it");
                return Err(Error::value(OBJECT_POSE, expected, format!("{off} m away")));
            }
            objects.push(states);
        }
        Ok(Courses { servos, objects })
    }

    /// Computes the forces of frame `at` of the episode, `frame` of the store.
    fn frame(&mut self, frame: usize, at: usize, courses: &Courses) -> Result<ReplayFrame> {
        let world = self.rollout.world_mut();
        for (hand, course) in self.hands.iter().zip(&courses.servos) {
            let Some((servos, _)) = hand else { continue };
            for (servo, motion) in servos.iter().zip(&course[at]) {
                world.set_joint_motion(*servo, *motion);
            }
        }
        for ((_, joint), states) in self.objects.iter().zip(&courses.objects) {
            let ObjectState { pose, linear, angular } = states[at];
            world.set_free_motion(*joint, (pose.position, pose.orientation), linear, angular)?;
        }
        world.inverse();
        Ok(self.read(frame))
    }

    fn read(&self, frame: usize) -> ReplayFrame {
        let world: &World = self.rollout.world();
        let mut found = ReplayFrame { frame, links: [[0.0; N_JOINTS]; 2], net: vec![DVec3::ZERO; self.objects.len()] };
        for contact in world.contacts() {
            for (sign, body) in [-1.0, 1.0].into_iter().zip(contact.bodies) {
                if let Some(index) = self.objects.iter().position(|(object, _)| *object == body) {
                    found.net[index] += sign * contact.force;
                }
                for (hand, forces) in self.hands.iter().zip(&mut found.links) {
                    let links = hand.as_ref().map(|(_, links)| links.as_slice()).unwrap_or_default();
                    if let Some(link) = links.iter().position(|link| *link == body) {
                        forces[link] += contact.normal_force;
                    }
                }
            }
        }
        found
    }
}
