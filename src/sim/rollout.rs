//! A rollout: one episode of a scene, frame by frame.

use super::driver::{HandDriver, Target};
use super::effect::{Effect, EffectPlan, EffectSet, Observation};
use super::guard::Guard;
use super::lens::Lens;
use super::mjcf::{self, HEAD};
use super::observe::SimFrame;
use super::randomize::Episode;
use super::rig::HandRig;
use super::scene::Scene;
use super::scene_object::SceneObject;
use super::view::{View, ViewOptions};
use crate::camera::{Distortion, Intrinsics};
use crate::error::{Error, Result};
use crate::geometry::{ForceSpreader, SIGMA};
use crate::hand::{HandModel, HandParams, N_BETAS, PosedHand, Side, Topology};
use crate::mujoco::audit::{Expectation, Finding, audit, refuse_errors};
use crate::mujoco::world::FreeJoint;
use crate::mujoco::{PhysicsOptions, World};
use crate::tactile::Validity;

/// Seconds between two settings of the servos.
const CONTROL_INTERVAL: f64 = 0.008;
/// Depth of a contact that neither skin nor a mug's wall survives, m.
const MAX_DEPTH: f64 = 0.004;

/// What to simulate and record beside the scene itself.
#[derive(Debug, Clone)]
pub struct RolloutOptions {
    /// Left and right hand; both of one topology.
    pub hands: [HandModel; 2],
    /// Shape of both hands.
    pub betas: [f32; N_BETAS],
    /// Width and height of the picture; `None` never opens an OpenGL context, and pictures are 1 x 1.
    pub picture: Option<(u32, u32)>,
    /// Shadows in the picture, also where the scene does not list them.
    pub shadows: bool,
    /// Effects in place of those that the scene calls for; for measuring what one costs.
    pub effects: Option<EffectSet>,
    /// Width of the kernel that spreads contact forces, m.
    pub sigma: f64,
    /// Physics in place of what the scene and its effects ask for; for measuring what a value costs.
    pub physics: Option<PhysicsOptions>,
    /// Corners that each link's collision hull keeps at most; `None` keeps all.
    pub hull_corners: Option<usize>,
    /// Whether guards watch every step; without, frames are checked only at their own instants.
    pub guards: bool,
}

impl Default for RolloutOptions {
    fn default() -> Self {
        Self {
            hands: Side::BOTH.map(HandModel::builtin),
            betas: [0.0; N_BETAS],
            picture: Some((224, 224)),
            shadows: false,
            effects: None,
            sigma: SIGMA,
            physics: None,
            hull_corners: None,
            guards: true,
        }
    }
}

/// A running episode: a world, its hands, its camera.
#[derive(Debug)]
pub struct Rollout {
    pub(super) world: World,
    pub(super) rigs: [HandRig; 2],
    pub(super) hands: [Option<HandDriver>; 2],
    pub(super) spreaders: [ForceSpreader; 2],
    pub(super) objects: Vec<SceneObject>,
    pub(super) episode: Episode,
    pub(super) effects: EffectSet,
    pub(super) observe: Vec<Observation>,
    pub(super) guard: Guard,
    pub(super) guards: bool,
    pub(super) view: Option<View>,
    pub(super) intrinsics: Intrinsics,
    pub(super) camera: usize,
    pub(super) head: usize,
    pub(super) steps_per_frame: usize,
    pub(super) steps_per_control: usize,
    /// Steps since the start: control follows them, whatever the frame rate.
    pub(super) steps: usize,
    pub(super) interval: f64,
    pub(super) frames: usize,
    pub(super) next: usize,
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
        let mut rigs = [HandRig::new(left.clone(), options.betas)?, HandRig::new(right.clone(), options.betas)?];
        if let Some(corners) = options.hull_corners {
            rigs.iter_mut().try_for_each(|rig| rig.limit_corners(corners))?;
        }
        let spreaders = [ForceSpreader::new(left, options.sigma)?, ForceSpreader::new(right, options.sigma)?];
        let episode = Episode::sample(scene, seed, &rigs)?;
        let plan = EffectPlan::of(&scene.spec)?;
        let effects = chosen_effects(&plan, options)?;
        let physics = match &options.physics {
            Some(physics) => physics.clone(),
            None => plan.physics(effects, &scene.spec.physics)?,
        };
        let picture = options.picture.filter(|_| effects.contains(Effect::Rendering));
        let lens = match picture.filter(|_| effects.contains(Effect::LensDistortion)) {
            Some(size) => Some(Lens::new(&episode.camera, size)?),
            None => None,
        };
        let fovy = lens.as_ref().map_or(episode.camera.fovy, Lens::fovy);
        let mut world = World::from_mjcf(&mjcf::write(&episode, &rigs, effects, fovy), &physics)?;

        let objects = episode.objects.iter().map(|draw| SceneObject::new(&world, draw)).collect::<Result<Vec<_>>>()?;
        let targets: Vec<Target> = objects.iter().zip(&episode.objects).map(|(o, draw)| target(o, draw)).collect();
        let mut hands = [None, None];
        for hand in &episode.hands {
            let rig = &rigs[hand.side as usize];
            hands[hand.side as usize] = Some(HandDriver::new(&mut world, hand, rig, &targets)?);
        }
        let joints: Vec<FreeJoint> = objects.iter().filter_map(|object| object.joint).collect();
        if effects.contains(Effect::Dynamics) {
            world.forward();
            for finding in check(&world)? {
                tracing::debug!("scene {}, seed {seed}: {}", scene.name, finding.message);
            }
        }
        let guard = Guard::new(&world, &joints, MAX_DEPTH);
        let interval = 1.0 / scene.spec.rate;
        let steps_per_frame = physics.steps_in(interval)?;
        let (head, camera) = (world.mocap(HEAD)?, world.camera(HEAD)?);
        let observe = scene.spec.observe.clone();
        let depth = observe.contains(&Observation::Depth);
        let (width, height) = picture.unwrap_or((1, 1));
        let distortion = if lens.is_some() { episode.camera.distortion } else { Distortion::default() };
        let view = match picture {
            Some(size) => {
                let options = ViewOptions { camera, size, lens, depth, effects, steps_per_frame, seed };
                Some(View::new(&world, &episode.camera, options)?)
            }
            None => None,
        };
        Ok(Self {
            steps_per_frame,
            steps: 0,
            steps_per_control: (CONTROL_INTERVAL / physics.timestep).round().max(1.0) as usize,
            frames: (episode.duration * scene.spec.rate).floor() as usize + 1,
            intrinsics: Intrinsics::new(width, height, episode.camera.fovy).with_distortion(distortion),
            world,
            rigs,
            hands,
            spreaders,
            objects,
            episode,
            effects,
            observe,
            guard,
            guards: options.guards,
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
        self.next_frame_watched(|_| ())
    }

    /// As [`Self::next_frame`]; `watch` sees the world after each step, with the forces that acted during it.
    ///
    /// # Errors
    /// If rendering fails.
    pub fn next_frame_watched(&mut self, watch: impl FnMut(&World)) -> Result<Option<SimFrame>> {
        match self.next_instant(true, watch)? {
            Some(validity) => self.observe(validity).map(Some),
            None => Ok(None),
        }
    }

    /// Goes to the next frame without a picture or labels; `false` at the end.
    pub fn skip_frame(&mut self) -> bool {
        self.skip_frame_watched(|_| ())
    }

    /// As [`Self::skip_frame`]; `watch` sees the world after each step.
    pub fn skip_frame_watched(&mut self, watch: impl FnMut(&World)) -> bool {
        // Without exposures nothing can fail.
        matches!(self.next_instant(false, watch), Ok(Some(_)))
    }

    /// Simulates up to the next frame's instant, with the shutter's exposures on the way if `exposing`.
    fn next_instant(&mut self, exposing: bool, watch: impl FnMut(&World)) -> Result<Option<Validity>> {
        if self.next >= self.frames {
            return Ok(None);
        }
        let dynamic = self.effects.contains(Effect::Dynamics);
        if self.next > 0 && dynamic {
            self.advance(exposing, watch)?;
        }
        let time = self.next as f64 * self.interval;
        self.next += 1;
        self.turn_head();
        if !dynamic {
            return self.place(time).map(Some);
        }
        // Poses, contacts and forces of this very instant; a step leaves those of the instant before.
        self.world.forward();
        let validity = self.guard.frame(&self.world);
        if matches!(validity, Validity::NotFinite | Validity::EngineWarning) {
            self.next = self.frames;
        }
        Ok(Some(validity))
    }

    /// Puts the hands where their plan has them at `time`, without dynamics.
    fn place(&mut self, time: f64) -> Result<Validity> {
        for hand in self.hands.iter().flatten() {
            hand.place(&mut self.world, time);
        }
        match self.effects.contains(Effect::RigidContact) {
            true => self.world.detect(time),
            false => self.world.place(time),
        }
        let finite = self.world.qpos().iter().all(|position| position.is_finite());
        Ok(if finite { Validity::Valid } else { Validity::NotFinite })
    }

    fn turn_head(&mut self) {
        let (eye, orientation) = self.episode.camera.head(self.world.time());
        self.world.set_mocap(self.head, eye, orientation);
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

    /// The effects at work.
    pub fn effects(&self) -> EffectSet {
        self.effects
    }

    /// The objects, in the episode's order.
    pub fn objects(&self) -> &[SceneObject] {
        &self.objects
    }

    /// Pictures drawn so far.
    pub fn renders(&self) -> usize {
        self.view.as_ref().map_or(0, View::renders)
    }

    /// The physics.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The physics, to change it: what the rollout does next goes on from there.
    pub fn world_mut(&mut self) -> &mut World {
        &mut self.world
    }

    /// The physics as it is now, without what drives and observes it.
    pub fn into_world(self) -> World {
        self.world
    }

    /// Parameters of a hand as it is; `None` = absent.
    pub fn hand_params(&self, side: Side) -> Option<HandParams> {
        let driver = self.hands[side as usize].as_ref()?;
        let (wrist, angles) = (driver.wrist(), driver.angles(&self.world));
        Some(self.rigs[side as usize].params(self.world.position(wrist), self.world.orientation(wrist), &angles))
    }

    fn advance(&mut self, exposing: bool, mut watch: impl FnMut(&World)) -> Result<()> {
        for step in 0..self.steps_per_frame {
            if self.steps.is_multiple_of(self.steps_per_control) {
                let interval = self.steps_per_control as f64 * self.world.options().timestep;
                for hand in self.hands.iter_mut().flatten() {
                    hand.drive(&mut self.world, interval);
                }
            }
            self.world.step();
            self.steps += 1;
            if self.guards {
                self.guard.after_step(&self.world);
            }
            watch(&self.world);
            let left = self.steps_per_frame - step - 1;
            if exposing && self.view.as_ref().is_some_and(|view| view.is_open(left)) && self.world.is_finite() {
                self.turn_head();
                self.world.forward();
                self.set_skins()?;
                if let Some(view) = &mut self.view {
                    view.expose(&mut self.world)?;
                }
            }
        }
        Ok(())
    }

    /// A present hand as it is, posed.
    pub(super) fn posed(&self, side: Side) -> Option<(HandParams, PosedHand)> {
        let params = self.hand_params(side)?;
        let posed = self.rigs[side as usize].model.forward(&params);
        Some((params, posed))
    }

    /// Gives the engine's skins the vertices of the hands as they are.
    pub(super) fn set_skins(&mut self) -> Result<()> {
        for side in Side::BOTH {
            if let (Some(driver), Some((_, posed))) = (&self.hands[side as usize], self.posed(side)) {
                let vertices = self.rigs[side as usize].bound_vertices(&posed);
                self.world.set_skin(driver.skin(), &vertices)?;
            }
        }
        Ok(())
    }
}

/// Effects of a rollout: the scene's, or those asked for, without pictures where none are taken.
fn chosen_effects(plan: &EffectPlan, options: &RolloutOptions) -> Result<EffectSet> {
    let mut effects = options.effects.unwrap_or(plan.effects());
    if options.shadows && effects.contains(Effect::Rendering) {
        effects = effects.with(Effect::Shadows);
    }
    if options.picture.is_none() {
        let of_pictures = |effect: &Effect| effect.needs().contains(&Effect::Rendering);
        let pictures = Effect::ALL.into_iter().filter(of_pictures).chain([Effect::Rendering]);
        effects = pictures.fold(effects, EffectSet::without);
    }
    effects.check()?;
    Ok(effects)
}

fn target<'a>(object: &SceneObject, draw: &'a super::randomize::ObjectDraw) -> Target<'a> {
    Target { body: object.body(), shape: &draw.shape, position: draw.position, orientation: draw.orientation }
}

/// What an episode's model is known to get wrong, looked at before the first step.
///
/// # Errors
/// If something would make its labels false.
fn check(world: &World) -> Result<Vec<Finding>> {
    let findings = audit(world, Expectation::default());
    refuse_errors(&findings)?;
    Ok(findings)
}
