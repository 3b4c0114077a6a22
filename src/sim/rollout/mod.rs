//! Rollouts: episodes of a scene, simulated frame by frame.

mod clock;
mod guards;
mod hands;
mod head_camera;
mod labels;
mod options;

pub use options::RolloutOptions;

use std::sync::Arc;

use super::contact::HandForce;
use super::driver::TargetObject;
use super::effect::{Effect, EffectSet};
use super::frame::{ObjectPose, SimFrame};
use super::mjcf;
use super::randomize::{EpisodeDraw, ObjectDraw};
use super::rig::HandRig;
use super::scene::Scene;
use super::scene_object::SceneObject;
use super::timeline::ChannelValues;
use crate::camera::Intrinsics;
use crate::dataset::Frame;
use crate::error::Result;
use crate::hand::{HandModel, HandParams, Side, Topology};
use crate::mujoco::World;
use crate::mujoco::audit::{Expectation, audit, refuse_errors};
use crate::sensor::{self, GloveSpec, SimulatedGlove, TaxelMap};
use crate::tactile::{N_FIELD, Validity};
use clock::Clock;
use guards::RolloutGuards;
use hands::SimHands;
use head_camera::{HeadCamera, Optics};
use labels::Labeller;

/// A running episode: world, hands, objects, camera and labels.
///
/// The same scene, seed and options give the same frames, bit for bit. Vertex arrays hold 778 values of the left hand,
/// then 778 of the right hand. Forces are newtons, lengths metres, times seconds; poses are in the world frame (origin
/// on the table's top, z up, the person at negative y).
///
/// ```
/// use egotac::hand::Side;
/// use egotac::sim::{Rollout, RolloutOptions, Scene};
///
/// # fn main() -> egotac::Result<()> {
/// // Without pictures no OpenGL is needed; `picture: Some((224, 224))` renders them.
/// let options = RolloutOptions { picture: None, ..RolloutOptions::default() };
/// let mut rollout = Rollout::new(&Scene::load("poke")?, 7, &options)?;
/// for _ in 0..3 {
///     let Some(frame) = rollout.next_frame()? else { break }; // `None` = end of the episode
///     let field = &frame.frame.field;
///     assert_eq!(field.force.len(), 1556);
///     println!("{:.2} s: {:.2} N on the left hand", frame.frame.timestamp, field.total_force(Side::Left));
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Rollout {
    world: World,
    hands: SimHands,
    objects: Vec<SceneObject>,
    camera: HeadCamera,
    labeller: Labeller,
    guards: RolloutGuards,
    clock: Clock,
    effects: EffectSet,
    episode: EpisodeDraw,
    glove: Option<SimulatedGlove>,
}

impl Rollout {
    /// Draws an episode from `seed`, builds its world and plans the hands' motion.
    ///
    /// # Errors
    /// If the scene cannot be built with these hands, or pictures are needed and there is no OpenGL.
    pub fn new(scene: &Scene, seed: u64, options: &RolloutOptions) -> Result<Self> {
        let (rigs, spreaders) = (options.rigs()?, options.spreaders()?);
        let glove = scene.spec.glove.as_ref().map(|spec| glove(spec, &options.hands, seed)).transpose()?;
        let mut episode = EpisodeDraw::sample(scene, seed, &rigs)?;
        let (effects, physics) = options.effects_and_physics(&scene.spec)?;
        episode.photo.furnish(options.backgrounds.as_deref(), options.prop_meshes.as_deref())?;
        let optics = Optics::new(&episode, options.picture, effects)?;
        let (model, files) = mjcf::write(&episode, &rigs, effects, optics.fovy())?;
        let mut world = World::from_mjcf_with_files(&model, &files, &physics)?;

        let objects = episode.objects.iter().map(|draw| SceneObject::new(&world, draw)).collect::<Result<Vec<_>>>()?;
        let targets: Vec<TargetObject> =
            objects.iter().zip(&episode.objects).map(|(o, draw)| target(o, draw)).collect();
        let hands = SimHands::new(&mut world, rigs, &episode, &targets)?;
        if effects.contains(Effect::Dynamics) {
            world.forward();
            audit_start(&world, scene, seed)?;
        }
        let guards = RolloutGuards::new(&world, &objects, options.guards);
        let steps_per_frame = physics.steps_in(1.0 / scene.spec.rate)?;
        let clock = Clock::new(episode.duration, scene.spec.rate, physics.timestep, steps_per_frame);
        let observed = &scene.spec.observe;
        let camera = HeadCamera::new(&world, optics, observed, effects, steps_per_frame, seed)?;
        let labeller = Labeller::new(spreaders, observed, effects);
        Ok(Self { world, hands, objects, camera, labeller, guards, clock, effects, episode, glove })
    }

    /// Simulates the next frame; `None` at the end of the episode, or after a frame whose state was lost.
    ///
    /// # Errors
    /// If rendering fails.
    pub fn next_frame(&mut self) -> Result<Option<SimFrame>> {
        self.next_frame_watched(|_| ())
    }

    /// Simulates the next frame as [`Self::next_frame`]; `watch` gets the world after each physics step, with the
    /// forces that acted during it.
    ///
    /// # Errors
    /// If rendering fails.
    pub fn next_frame_watched(&mut self, watch: impl FnMut(&World)) -> Result<Option<SimFrame>> {
        match self.next_instant(true, watch)? {
            Some(validity) => self.observe(validity).map(Some),
            None => Ok(None),
        }
    }

    /// Simulates the next frame without picture and labels; returns false at the end of the episode.
    pub fn skip_frame(&mut self) -> bool {
        self.skip_frame_watched(|_| ())
    }

    /// Skips a frame as [`Self::skip_frame`]; `watch` gets the world after each physics step.
    pub fn skip_frame_watched(&mut self, watch: impl FnMut(&World)) -> bool {
        // Only exposures can fail, and there are none.
        matches!(self.next_instant(false, watch), Ok(Some(_)))
    }

    /// Returns the number of frames of the whole episode.
    pub fn frame_count(&self) -> usize {
        self.clock.n_frames()
    }

    /// Returns the time between frames, s.
    pub fn interval(&self) -> f64 {
        self.clock.interval
    }

    /// Returns the projection of the camera.
    pub fn intrinsics(&self) -> Intrinsics {
        self.camera.intrinsics
    }

    /// Returns the vertex numbering of both hands.
    pub fn topology(&self) -> Topology {
        self.hands.rigs[0].model.topology
    }

    /// Returns the drawn values of the episode.
    pub fn episode(&self) -> &EpisodeDraw {
        &self.episode
    }

    /// Returns the rigs of the left and the right hand.
    pub fn rigs(&self) -> &[HandRig; 2] {
        &self.hands.rigs
    }

    /// Returns the effects that are simulated.
    pub fn effects(&self) -> EffectSet {
        self.effects
    }

    /// Returns the objects in the episode's order.
    pub fn objects(&self) -> &[SceneObject] {
        &self.objects
    }

    /// Returns the number of pictures rendered so far, exposures included.
    pub fn renders(&self) -> usize {
        self.camera.renders()
    }

    /// Returns the physics world.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Returns the physics world for changes; the rollout continues from the changed state.
    pub fn world_mut(&mut self) -> &mut World {
        &mut self.world
    }

    /// Returns the physics world in its current state, without drivers and labels.
    pub fn into_world(self) -> World {
        self.world
    }

    /// Returns the current parameters of a hand; `None` = absent.
    pub fn hand_params(&self, side: Side) -> Option<HandParams> {
        self.hands.params(&self.world, side)
    }

    /// Commands a hand in place of its script: the channels change linearly to `to` until the next frame, and then stay.
    /// Returns false if the hand is absent or has no act.
    pub(super) fn command(&mut self, side: Side, to: ChannelValues) -> bool {
        self.hands.command(side, self.world.time(), self.clock.interval, to)
    }

    /// Simulates up to the next frame's instant; with `exposing`, takes the exposures of its picture on the way.
    fn next_instant(&mut self, exposing: bool, watch: impl FnMut(&World)) -> Result<Option<Validity>> {
        let Some(index) = self.clock.next_frame() else { return Ok(None) };
        let dynamic = self.effects.contains(Effect::Dynamics);
        if index > 0 && dynamic {
            self.advance(exposing, watch)?;
        }
        self.clock.count_frame();
        self.camera.turn_head(&mut self.world);
        if !dynamic {
            return Ok(Some(self.place(self.clock.time_of(index))));
        }
        // A step leaves poses, contacts and forces of the instant before it; labels need those of this instant.
        self.world.forward();
        let validity = self.guards.frame(&self.world);
        if matches!(validity, Validity::NotFinite | Validity::EngineWarning) {
            self.clock.end();
        }
        Ok(Some(validity))
    }

    /// Simulates the physics steps of one frame.
    fn advance(&mut self, exposing: bool, mut watch: impl FnMut(&World)) -> Result<()> {
        for steps_left in (0..self.clock.steps_per_frame).rev() {
            self.step();
            watch(&self.world);
            if exposing {
                self.camera.expose(&mut self.world, &self.hands, steps_left)?;
            }
        }
        Ok(())
    }

    /// Simulates one physics step: servo targets if they are due, dynamics, guards.
    fn step(&mut self) {
        if let Some(interval) = self.clock.due_control() {
            self.hands.drive(&mut self.world, interval);
        }
        self.world.step();
        self.clock.count_step();
        self.guards.after_step(&self.world);
    }

    /// Moves the hands to their planned pose at `time`, s, without dynamics.
    fn place(&mut self, time: f64) -> Validity {
        self.hands.place(&mut self.world, time);
        match self.effects.contains(Effect::RigidContact) {
            true => self.world.detect(time),
            false => self.world.place(time),
        }
        let finite = self.world.qpos().iter().all(|position| position.is_finite());
        if finite { Validity::Valid } else { Validity::NotFinite }
    }

    /// Records the current instant: labels, picture, poses.
    fn observe(&mut self, validity: Validity) -> Result<SimFrame> {
        let lost = validity == Validity::NotFinite;
        if !lost {
            self.objects.iter_mut().try_for_each(|object| object.refresh(&self.world))?;
        }
        let labels = self.labeller.label(&self.world, &self.hands, &self.objects, lost)?;
        let is_too_strong = labels.forces.iter().flatten().any(HandForce::is_too_strong);
        let validity = if validity == Validity::Valid && is_too_strong { Validity::TooStrong } else { validity };
        let (picture, depth) = match lost {
            true => (self.camera.blank(), None),
            false => self.camera.shoot(&mut self.world, &self.hands)?,
        };
        let time = self.world.time();
        let taxels = self.glove.as_mut().map(|glove| glove.read(time, &labels.field.force)).transpose()?;
        // Vertices of an absent hand are supervised, too: nothing touches them.
        let valid = validity == Validity::Valid;
        let [left_hand_pose, right_hand_pose] = labels.poses;
        let frame = Frame {
            timestamp: self.world.time(),
            camera_ego_rgb: picture,
            field: labels.field,
            force_valid: vec![u8::from(valid && self.labeller.force); N_FIELD],
            contact_valid: vec![u8::from(valid && self.labeller.contact); N_FIELD],
            validity,
            left_hand_pose,
            right_hand_pose,
        };
        Ok(SimFrame {
            frame,
            proximity: labels.proximity,
            slip: Some(labels.slip).filter(|_| self.labeller.slip),
            depth,
            hands: labels.forces,
            objects: object_poses(&self.objects),
            camera: self.camera.pose(&self.world),
            taxels,
        })
    }
}

/// Puts gloves on hands; their map is built anew for hands of another topology than its own.
fn glove(spec: &GloveSpec, hands: &[HandModel; 2], seed: u64) -> Result<SimulatedGlove> {
    let map = sensor::open(&spec.sensor)?;
    let map = match map.topology == hands[0].topology {
        true => map,
        false => TaxelMap::build(&map.layout, hands)?,
    };
    SimulatedGlove::new(Arc::new(map), spec.clone(), seed)
}

fn target<'a>(object: &SceneObject, draw: &'a ObjectDraw) -> TargetObject<'a> {
    TargetObject { body: object.body(), shape: &draw.shape, position: draw.position, orientation: draw.orientation }
}

/// Poses of the solid objects.
fn object_poses(objects: &[SceneObject]) -> Vec<ObjectPose> {
    let solid = objects.iter().filter(|object| object.body().is_some());
    let pose = |object: &SceneObject| {
        let (position, orientation) = object.pose();
        ObjectPose { name: object.name.clone(), position, orientation }
    };
    solid.map(pose).collect()
}

/// Audits the model of an episode before its first step, and logs the findings that do no harm.
///
/// # Errors
/// If a finding would make labels false.
fn audit_start(world: &World, scene: &Scene, seed: u64) -> Result<()> {
    let findings = audit(world, Expectation::default());
    refuse_errors(&findings)?;
    for finding in findings {
        tracing::debug!("scene {}, seed {seed}: {}", scene.name, finding.message);
    }
    Ok(())
}
