//! A rollout: one episode of a scene, frame by frame.

use ::image::RgbImage;
use glam::{DQuat, DVec3};

use super::camera::{CameraPose, Intrinsics};
use super::contact::{HandForce, hand_force};
use super::driver::HandDriver;
use super::guard::Guard;
use super::mjcf::{self, HEAD};
use super::randomize::Episode;
use super::rig::HandRig;
use super::scene::Scene;
use crate::dataset::Frame;
use crate::error::{Error, Result};
use crate::hand::{HandModel, HandParams, N_BETAS, Side};
use crate::label::{ForceSpreader, PROXIMITY, SIGMA, SampledSurface};
use crate::mujoco::world::FreeJoint;
use crate::mujoco::{Renderer, World};
use crate::tactile::{N_FIELD, TactileField, Topology, Validity};

/// Seconds between two settings of the servos.
const CONTROL_INTERVAL: f64 = 0.008;
/// Depth of a contact that neither skin nor a mug's wall survives, m.
const MAX_DEPTH: f64 = 0.004;
/// Spacing of object surfaces for the 1 cm label, m.
const SPACING: f32 = crate::label::proximity::SPACING;

/// What to simulate and record beside the scene itself.
#[derive(Debug, Clone)]
pub struct RolloutOptions {
    /// Left and right hand; both of one topology.
    pub hands: [HandModel; 2],
    /// Shape of both hands.
    pub betas: [f32; N_BETAS],
    /// Width and height of the picture; `None` never opens an OpenGL context, and pictures are 1 x 1.
    pub picture: Option<(u32, u32)>,
    /// Shadows in the picture, at ten times its price.
    pub shadows: bool,
    /// Width of the kernel that spreads contact forces, m.
    pub sigma: f64,
}

impl Default for RolloutOptions {
    fn default() -> Self {
        Self {
            hands: Side::BOTH.map(HandModel::builtin),
            betas: [0.0; N_BETAS],
            picture: Some((224, 224)),
            shadows: false,
            sigma: SIGMA,
        }
    }
}

/// A running episode: a world, its hands, its camera.
#[derive(Debug)]
pub struct Rollout {
    world: World,
    rigs: [HandRig; 2],
    hands: [Option<HandDriver>; 2],
    spreaders: [ForceSpreader; 2],
    objects: Vec<SceneObject>,
    episode: Episode,
    guard: Guard,
    view: Option<Renderer>,
    intrinsics: Intrinsics,
    camera: usize,
    head: usize,
    steps_per_frame: usize,
    steps_per_control: usize,
    /// Steps since the start: control follows them, whatever the frame rate.
    steps: usize,
    interval: f64,
    frames: usize,
    next: usize,
}

#[derive(Debug)]
struct SceneObject {
    name: String,
    joint: FreeJoint,
    surface: SampledSurface,
}

/// One frame: the data-set's part, and what else is true at that instant.
#[derive(Debug, Clone)]
pub struct SimFrame {
    /// Picture, touch and hand poses, as data sets keep them.
    pub frame: Frame,
    /// (1556) 1 = an object's surface is within 1 cm (the paper's label).
    pub proximity: Vec<u8>,
    /// Left and right hand's force with residuals; `None` = absent.
    pub hands: [Option<HandForce>; 2],
    /// Name and pose of each object in the world frame, m.
    pub objects: Vec<ObjectPose>,
    /// Pose of the camera.
    pub camera: CameraPose,
}

/// A named pose, `world_from_object`.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectPose {
    /// The object.
    pub name: String,
    /// Position, m.
    pub position: DVec3,
    /// Orientation.
    pub orientation: DQuat,
}

impl Rollout {
    /// Prepares an episode: draws it from the seed, builds the world, plans the hands.
    ///
    /// # Errors
    /// If the scene cannot be built with these hands, or pictures are asked for and there is no OpenGL.
    pub fn new(scene: &Scene, seed: u64, options: &RolloutOptions) -> Result<Self> {
        let [left, right] = &options.hands;
        left.topology.must_match(right.topology)?;
        for (model, side) in options.hands.iter().zip(Side::BOTH) {
            if model.side != side {
                return Err(Error::value("hands", "left, then right", model.side.name()));
            }
        }
        let rigs = [HandRig::new(left.clone(), options.betas)?, HandRig::new(right.clone(), options.betas)?];
        let spreaders = [ForceSpreader::new(left, options.sigma)?, ForceSpreader::new(right, options.sigma)?];
        let episode = Episode::sample(scene, seed, &rigs)?;
        let physics = &scene.spec.physics;
        let mut world = World::from_mjcf(&mjcf::write(&episode, &rigs, options.shadows), physics)?;

        let mut objects = Vec::new();
        for object in &episode.objects {
            let joint = world.free_joint(&object.name)?;
            objects.push(SceneObject {
                name: object.name.clone(),
                joint,
                surface: object.shape.sampled_surface(SPACING)?,
            });
        }
        let bodies = objects.iter().map(|object| world.body_of(object.joint));
        let bodies: Vec<_> = bodies.zip(episode.objects.iter().map(|object| &object.shape)).collect();
        let mut hands = [None, None];
        for hand in &episode.hands {
            let rig = &rigs[hand.side as usize];
            hands[hand.side as usize] = Some(HandDriver::new(&mut world, hand, rig, &bodies)?);
        }
        let joints: Vec<FreeJoint> = objects.iter().map(|object| object.joint).collect();
        let guard = Guard::new(&world, &joints, MAX_DEPTH);
        let interval = 1.0 / scene.spec.rate;
        let (head, camera) = (world.mocap(HEAD)?, world.camera(HEAD)?);
        let (width, height) = options.picture.unwrap_or((1, 1));
        let view = match options.picture {
            Some((width, height)) => Some(Renderer::new(&world, camera, width, height)?),
            None => None,
        };
        Ok(Self {
            steps_per_frame: physics.steps_in(interval)?,
            steps: 0,
            steps_per_control: (CONTROL_INTERVAL / physics.timestep).round().max(1.0) as usize,
            frames: (episode.duration * scene.spec.rate).floor() as usize + 1,
            intrinsics: Intrinsics::new(width, height, episode.camera.fovy),
            world,
            rigs,
            hands,
            spreaders,
            objects,
            episode,
            guard,
            view,
            camera,
            head,
            interval,
            next: 0,
        })
    }

    /// The next frame; `None` at the end of the episode, or after a frame whose state was lost.
    ///
    /// # Errors
    /// If rendering fails.
    pub fn next_frame(&mut self) -> Result<Option<SimFrame>> {
        match self.next_instant() {
            Some(validity) => self.observe(validity).map(Some),
            None => Ok(None),
        }
    }

    /// Goes to the next frame without a picture or labels; `false` at the end.
    pub fn skip_frame(&mut self) -> bool {
        self.next_instant().is_some()
    }

    /// Simulates up to the next frame's instant.
    fn next_instant(&mut self) -> Option<Validity> {
        if self.next >= self.frames {
            return None;
        }
        if self.next > 0 {
            self.advance();
        }
        self.next += 1;
        let (eye, orientation) = self.episode.camera.head(self.world.time());
        self.world.set_mocap(self.head, eye, orientation);
        // Poses, contacts and forces of this very instant; a step leaves those of the instant before.
        self.world.forward();
        let validity = self.guard.frame(&self.world);
        if matches!(validity, Validity::NotFinite | Validity::EngineWarning) {
            self.next = self.frames;
        }
        Some(validity)
    }

    /// Frames of the whole episode.
    pub fn frame_count(&self) -> usize {
        self.frames
    }

    /// Seconds between frames.
    pub fn interval(&self) -> f64 {
        self.interval
    }

    /// What the camera's pixels mean.
    pub fn intrinsics(&self) -> Intrinsics {
        self.intrinsics
    }

    /// What the vertex indices mean.
    pub fn topology(&self) -> Topology {
        self.rigs[0].model.topology
    }

    /// The drawn values.
    pub fn episode(&self) -> &Episode {
        &self.episode
    }

    /// The hands' mechanisms, left and right.
    pub fn rigs(&self) -> &[HandRig; 2] {
        &self.rigs
    }

    /// The physics.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Parameters of a hand as it is; `None` = absent.
    pub fn hand_params(&self, side: Side) -> Option<HandParams> {
        let driver = self.hands[side as usize].as_ref()?;
        let (wrist, angles) = (driver.wrist(), driver.angles(&self.world));
        Some(self.rigs[side as usize].params(self.world.position(wrist), self.world.orientation(wrist), &angles))
    }

    fn advance(&mut self) {
        for _ in 0..self.steps_per_frame {
            if self.steps.is_multiple_of(self.steps_per_control) {
                let interval = self.steps_per_control as f64 * self.world.options().timestep;
                for hand in self.hands.iter_mut().flatten() {
                    hand.drive(&mut self.world, interval);
                }
            }
            self.world.step();
            self.steps += 1;
            self.guard.after_step(&self.world);
        }
    }

    fn observe(&mut self, validity: Validity) -> Result<SimFrame> {
        let lost = validity == Validity::NotFinite;
        let mut force = vec![0.0; N_FIELD];
        let mut proximity = vec![0; N_FIELD];
        let mut poses = [None, None];
        let mut forces = [None, None];
        for side in Side::BOTH {
            let Some(driver) = self.hands[side as usize].as_ref().filter(|_| !lost) else { continue };
            let Some(params) = self.hand_params(side) else { continue };
            let posed = self.rigs[side as usize].model.forward(&params);
            let label = hand_force(&self.world, driver.links(), &posed.vertices, &self.spreaders[side as usize])?;
            force[side.range()].copy_from_slice(&label.force);
            for (label, vertex) in proximity[side.range()].iter_mut().zip(&posed.vertices) {
                *label = u8::from(self.objects.iter().any(|object| {
                    let body = self.world.body_of(object.joint);
                    let local =
                        self.world.orientation(body).inverse() * (vertex.as_dvec3() - self.world.position(body));
                    object.surface.is_within(local.as_vec3(), PROXIMITY)
                }));
            }
            if self.view.is_some() {
                let (skin, rig) = (driver.skin(), &self.rigs[side as usize]);
                self.world.set_skin(skin, &rig.bound_vertices(&posed))?;
            }
            (forces[side as usize], poses[side as usize]) = (Some(label), Some(params));
        }
        let objects = self.objects.iter().map(|object| {
            let body = self.world.body_of(object.joint);
            let (position, orientation) = (self.world.position(body), self.world.orientation(body));
            ObjectPose { name: object.name.clone(), position, orientation }
        });
        let objects = objects.collect();
        let picture = match &mut self.view {
            Some(renderer) if !lost => renderer.render(&mut self.world)?,
            _ => RgbImage::new(self.intrinsics.width, self.intrinsics.height),
        };
        // A hand that is there is supervised where the frame can be trusted; an absent one is surely not touched.
        let valid = u8::from(validity == Validity::Valid);
        let [left_hand_pose, right_hand_pose] = poses;
        let frame = Frame {
            timestamp: self.world.time(),
            camera_ego_rgb: picture,
            field: TactileField::from_force(self.topology(), force)?,
            force_valid: vec![valid; N_FIELD],
            contact_valid: vec![valid; N_FIELD],
            validity,
            left_hand_pose,
            right_hand_pose,
        };
        let camera = CameraPose::from_engine(self.world.camera_pose(self.camera));
        Ok(SimFrame { frame, proximity, hands: forces, objects, camera })
    }
}
