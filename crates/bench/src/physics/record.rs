//! Simulated episodes with the forces that the simulator's contacts had.

use egotac::error::Result;
use egotac::hand::{HandModel, N_JOINTS, Side};
use egotac::mujoco::World;
use egotac::mujoco::options::Unchecked;
use egotac::mujoco::world::{Body, Contact};
use egotac::physics::cone::Cone;
use egotac::physics::solve::{Point, remaining_variance};
use egotac::physics::spline::Smoother;
use egotac::physics::{Fixed, Pose, RigidBody, Take, Tracked};
use egotac::sim::scene::EffectPlan;
use egotac::sim::{Effect, Rollout, RolloutOptions, Scene, physical};
use egotac::tactile::Validity;
use glam::{DQuat, DVec3};
use nalgebra::{Matrix6, Vector6};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Frames per second of the episodes; lower rates leave frames out.
pub const RATE: f64 = 60.0;
/// Timestep of the simulation, s: a frame at [`RATE`] is a whole number of steps.
const TIMESTEP: f64 = 1.0 / 600.0;
/// Share of the prior variance below which the true contacts determine a link's force.
const DETERMINED: f64 = 0.1;

/// Truth of one frame.
#[derive(Debug, Clone)]
pub struct Truth {
    /// True if no guard refused the frame.
    pub valid: bool,
    /// Normal force on each link of the left and the right hand, N.
    pub links: [[f64; N_JOINTS]; 2],
    /// True for links whose force the true contacts determine.
    pub determined: [[bool; N_JOINTS]; 2],
    /// Wrench of all contacts on each body about its centre of mass: force, N, and moment, N m.
    pub wrenches: Vec<Vector6<f64>>,
    /// Kinds of things that touch each body.
    pub touches: Vec<Touches>,
}

/// Kinds of things that touch a body with a force.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Touches {
    /// A link of a hand.
    pub hand: bool,
    /// Another body that moves freely.
    pub body: bool,
    /// A fixed thing.
    pub fixed: bool,
}

/// One simulated episode.
#[derive(Debug)]
pub struct Recorded {
    /// Scene.
    pub scene: String,
    hands: [HandModel; 2],
    times: Vec<f64>,
    tracked: [Vec<Tracked>; 2],
    bodies: Vec<RigidBody>,
    fixed: Vec<Fixed>,
    poses: Vec<Vec<Option<Pose>>>,
    /// Times of the simulation's steps, s, and the net force of all contacts on each body at each of them, N.
    steps: (Vec<f64>, Vec<Vec<DVec3>>),
    /// Truth of each frame.
    pub truth: Vec<Truth>,
}

/// Disturbance of an episode as a tracker would see it.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Disturbance {
    /// Frames per second.
    pub rate: f64,
    /// Standard deviation of the noise of wrists and objects per axis, mm.
    pub millimetres: f64,
    /// The same of rotations, degrees.
    pub degrees: f64,
    /// Knowledge of the masses.
    pub mass: MassKnowledge,
}

/// Knowledge of the masses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MassKnowledge {
    /// The true mass, stated as known.
    Known,
    /// A guess by density: off by a factor drawn from a log-normal distribution of deviation 0.3, stated as such.
    Density,
    /// One and a half times the true mass, with a stated deviation of the logarithm of 0.4.
    Wrong,
}

/// Standard deviations of the logarithm of a mass.
const DENSITY_SD: f64 = 0.3;
const WRONG_SD: f64 = 0.4;

impl Recorded {
    /// Simulates an episode.
    ///
    /// # Errors
    /// If the rollout fails.
    pub fn new(scene: &Scene, seed: u64) -> Result<Self> {
        let mut scene = scene.clone();
        scene.spec.rate = RATE;
        let fine = (scene.spec.physics.timestep / TIMESTEP).min(1.0);
        let mut physics = Unchecked::from(scene.spec.physics.clone());
        physics.timestep = TIMESTEP / (1.0 / fine).round().max(1.0);
        scene.spec.physics = physics.try_into()?;
        // The engine does not list the contacts of sleeping bodies: the truth of a body at rest would be no force at all.
        let plan = EffectPlan::of(&scene.spec)?.effects();
        let effects = Some(plan.without(Effect::Sleep));
        let options = RolloutOptions { picture: None, effects, ..RolloutOptions::default() };
        let mut rollout = Rollout::new(&scene, seed, &options)?;
        let (bodies, fixed) = physical::bodies(rollout.episode())?;
        let mut recorded = Self {
            scene: scene.name.clone(),
            hands: options.hands.clone(),
            times: Vec::new(),
            tracked: Default::default(),
            poses: vec![Vec::new(); bodies.len()],
            steps: (Vec::new(), vec![Vec::new(); bodies.len()]),
            bodies,
            fixed,
            truth: Vec::new(),
        };
        let in_engine: Vec<Body> = rollout.objects().iter().filter_map(|object| object.body()).collect();
        let timestep = scene.spec.physics.timestep;
        let (mut step_times, mut step_forces) = (Vec::new(), vec![Vec::new(); in_engine.len()]);
        let link_of = options.hands.each_ref().map(HandModel::strongest_joints);
        loop {
            let watched = rollout.next_frame_watched(|world| {
                // After a step, the world holds the forces of the instant before it.
                step_times.push(world.time() - timestep);
                for (forces, body) in step_forces.iter_mut().zip(&in_engine) {
                    forces.push(net_force(world, *body));
                }
            });
            let Some(frame) = watched? else { break };
            let params = [&frame.frame.left_hand_pose, &frame.frame.right_hand_pose];
            for (tracked, params) in recorded.tracked.iter_mut().zip(params) {
                tracked.push(match params {
                    Some(params) => Tracked::Present(Box::new(params.clone())),
                    None => Tracked::Absent,
                });
            }
            for (poses, object) in recorded.poses.iter_mut().zip(&frame.objects) {
                poses.push(Some(Pose { position: object.position, orientation: object.orientation }));
            }
            let mut links = [[0.0; N_JOINTS]; 2];
            for side in Side::BOTH {
                let forces = &frame.frame.field.force[side.range()];
                for (force, link) in forces.iter().zip(&link_of[side as usize]) {
                    links[side as usize][*link] += f64::from(*force);
                }
            }
            let (wrenches, touches, determined) = recorded.contacts(&rollout);
            recorded.times.push(frame.frame.timestamp);
            let valid = frame.frame.validity == Validity::Valid;
            recorded.truth.push(Truth { valid, links, determined, wrenches, touches });
        }
        recorded.steps = (step_times, step_forces);
        Ok(recorded)
    }

    /// Returns the net force on a body at the times of `frames` as poses of this bandwidth, 1/s, can show it: the simulator's
    /// net force of all steps through the smoother of the estimation. `None` without two steps.
    pub fn shown(&self, body: usize, frames: &[usize], bandwidth: f64) -> Option<Vec<DVec3>> {
        let (times, forces) = (&self.steps.0, self.steps.1.get(body)?);
        let interval = times.get(1)? - times[0];
        let smoother = Smoother::new(times, &vec![1.0; times.len()], interval, bandwidth)?;
        let axes = [|f: &DVec3| f.x, |f: &DVec3| f.y, |f: &DVec3| f.z];
        let fits = axes.map(|axis| smoother.fit(&forces.iter().map(axis).collect::<Vec<f64>>()));
        let at = |frame: &usize| fits.each_ref().map(|fit| smoother.at(fit, self.times[*frame])[0]).into();
        Some(frames.iter().map(at).collect())
    }

    /// Returns the wrenches of the engine's contacts on the bodies, the things that touch them, and the links whose force
    /// the contacts determine.
    fn contacts(&self, rollout: &Rollout) -> (Vec<Vector6<f64>>, Vec<Touches>, [[bool; N_JOINTS]; 2]) {
        let world = rollout.world();
        let contacts: Vec<Contact> = world.contacts().collect();
        let mut touches = Vec::new();
        let in_engine: Vec<Body> = rollout.objects().iter().filter_map(|object| object.body()).collect();
        let is_free = |of: &Body| {
            let index = in_engine.iter().position(|body| body == of);
            index.and_then(|index| self.bodies.get(index)).is_some_and(|body| body.held.is_none())
        };
        let is_hand = |of: &Body| {
            let name = world.body_name(*of);
            Side::BOTH.into_iter().any(|side| name.starts_with(&format!("{}/", side.name())))
        };
        let mut determined = [[false; N_JOINTS]; 2];
        let mut wrenches = Vec::new();
        let solid = rollout.objects().iter().filter_map(|object| Some((object, object.body()?)));
        for ((object, body), known) in solid.zip(&self.bodies) {
            let (position, orientation) = object.pose();
            let mass = known.mass.expect("bodies of the simulator have a mass");
            let centre = position + orientation * mass.centre;
            let (mut force, mut moment) = (DVec3::ZERO, DVec3::ZERO);
            let (mut points, mut owners) = (Vec::new(), Vec::new());
            let mut touched = Touches::default();
            for contact in contacts.iter().filter(|contact| contact.bodies.contains(&body)) {
                let sign = if contact.bodies[1] == body { 1.0 } else { -1.0 };
                let other = contact.bodies[usize::from(contact.bodies[0] == body)];
                force += contact.force * sign;
                moment += (contact.position - centre).cross(contact.force * sign);
                if contact.normal_force > 0.0 {
                    match () {
                        () if is_hand(&other) => touched.hand = true,
                        () if is_free(&other) => touched.body = true,
                        () => touched.fixed = true,
                    }
                    let inward = contact.normal * sign;
                    let (t1, t2) = inward.any_orthonormal_pair();
                    let cone = Cone { friction: 1.0, limit: 1e3 };
                    let load = mass.kilograms * 9.81;
                    points.push(Point::new(contact.position - centre, [inward, t1, t2], DVec3::ZERO, load, cone));
                    owners.push(other);
                }
            }
            touches.push(touched);
            wrenches.push(Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z));
            if known.held.is_some() {
                continue;
            }
            for side in Side::BOTH {
                let rig = &rollout.rigs()[side as usize];
                for (link, name) in egotac::sim::rig::JOINT_NAMES.into_iter().enumerate() {
                    let Ok(of_link) = world.body(&rig.name(name)) else { continue };
                    let weight = |owner: &Body| if *owner == of_link { DVec3::X } else { DVec3::ZERO };
                    let weights: Vec<DVec3> = owners.iter().map(weight).collect();
                    if weights.iter().any(|weight| weight.x > 0.0) {
                        let noise = Matrix6::from_diagonal(&Vector6::new(1e-2, 1e-2, 1e-2, 1e-4, 1e-4, 1e-4));
                        let remaining = remaining_variance(&points, &weights, &(noise * noise));
                        determined[side as usize][link] = remaining < DETERMINED;
                    }
                }
            }
        }
        (wrenches, touches, determined)
    }

    /// Returns the episode under a disturbance, and the index of each of its frames in [`Recorded::truth`].
    pub fn disturbed(&self, disturbance: &Disturbance, seed: u64) -> (Take<'_>, Vec<usize>) {
        let every = (RATE / disturbance.rate).round().max(1.0) as usize;
        let frames: Vec<usize> = (0..self.times.len()).step_by(every).collect();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let of_hand = |hand: &Vec<Tracked>| frames.iter().map(|frame| hand[*frame].clone()).collect();
        let mut hands: [Vec<Tracked>; 2] = self.tracked.each_ref().map(of_hand);
        let of_body = |body: &Vec<Option<Pose>>| frames.iter().map(|frame| body[*frame]).collect();
        let mut poses: Vec<Vec<Option<Pose>>> = self.poses.iter().map(of_body).collect();
        add_pose_noise(&mut hands, &mut poses, disturbance.millimetres, disturbance.degrees, &mut rng);
        let mut bodies = self.bodies.clone();
        for body in &mut bodies {
            let Some(mass) = &mut body.mass else { continue };
            let (factor, sd) = match disturbance.mass {
                MassKnowledge::Known => (1.0, 0.0),
                MassKnowledge::Density => (normal(DENSITY_SD, &mut rng).x.exp(), DENSITY_SD),
                MassKnowledge::Wrong => (1.5, WRONG_SD),
            };
            (mass.kilograms, mass.inertia, mass.relative_sd) = (mass.kilograms * factor, mass.inertia * factor, sd);
        }
        let take = Take {
            times: frames.iter().map(|frame| self.times[*frame]).collect(),
            models: [&self.hands[0], &self.hands[1]],
            hands,
            bodies,
            poses,
            fixed: self.fixed.clone(),
            gravity: Some(DVec3::NEG_Z * egotac::physics::gravity::FREE_FALL),
        };
        (take, frames)
    }

    /// True if forces on some body follow from its motion.
    pub fn is_free(&self) -> bool {
        self.bodies.iter().any(|body| body.held.is_none())
    }
}

/// Adds independent normal noise to the poses of wrists and bodies in every frame, as a tracker has it: standard deviations of
/// position, mm per axis, and of rotation, degrees per axis.
pub fn add_pose_noise(
    hands: &mut [Vec<Tracked>; 2],
    poses: &mut [Vec<Option<Pose>>],
    millimetres: f64,
    degrees: f64,
    rng: &mut ChaCha8Rng,
) {
    let (position, rotation) = (1e-3 * millimetres, degrees.to_radians());
    let mut drawn = || (normal(position, rng), DQuat::from_scaled_axis(normal(rotation, rng)));
    for hand in hands.iter_mut().flatten() {
        let (shift, turn) = drawn();
        if let Tracked::Present(params) = hand {
            params.transl += shift.as_vec3();
            let orient = turn * DQuat::from_scaled_axis(params.global_orient.as_dvec3());
            params.global_orient = orient.to_scaled_axis().as_vec3();
        }
    }
    for pose in poses.iter_mut().flatten() {
        let (shift, turn) = drawn();
        if let Some(pose) = pose {
            *pose = Pose { position: pose.position + shift, orientation: turn * pose.orientation };
        }
    }
}

/// Draws a vector of independent normal numbers with this standard deviation.
fn normal(sd: f64, rng: &mut ChaCha8Rng) -> DVec3 {
    sd * DVec3::from_array(std::array::from_fn(|_| StandardNormal.sample(rng)))
}

/// Returns the net force of all contacts on a body, N.
fn net_force(world: &World, body: Body) -> DVec3 {
    let of_body = world.contacts().filter(|contact| contact.bodies.contains(&body));
    of_body.map(|contact| if contact.bodies[1] == body { contact.force } else { -contact.force }).sum()
}
