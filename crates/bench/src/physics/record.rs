//! Simulated episodes with the forces that the simulator's contacts had.

use egotac::error::Result;
use egotac::hand::{HandModel, N_JOINTS, Side};
use egotac::mujoco::options::Unchecked;
use egotac::mujoco::world::Contact;
use egotac::physics::cone::Cone;
use egotac::physics::solve::{Point, remaining_variance};
use egotac::physics::{Body, Fixed, Pose, Take, Tracked};
use egotac::sim::{Rollout, RolloutOptions, Scene, physical};
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
}

/// One simulated episode.
#[derive(Debug)]
pub struct Recorded {
    /// Scene.
    pub scene: String,
    hands: [HandModel; 2],
    times: Vec<f64>,
    tracked: [Vec<Tracked>; 2],
    bodies: Vec<Body>,
    fixed: Vec<Fixed>,
    poses: Vec<Vec<Option<Pose>>>,
    /// Truth of each frame.
    pub truth: Vec<Truth>,
}

/// Disturbance of an episode as a tracker would see it.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
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
        let options = RolloutOptions { picture: None, ..RolloutOptions::default() };
        let mut rollout = Rollout::new(&scene, seed, &options)?;
        let (bodies, fixed) = physical::bodies(rollout.episode())?;
        let mut recorded = Self {
            scene: scene.name.clone(),
            hands: options.hands.clone(),
            times: Vec::new(),
            tracked: Default::default(),
            poses: vec![Vec::new(); bodies.len()],
            bodies,
            fixed,
            truth: Vec::new(),
        };
        let link_of = options.hands.each_ref().map(HandModel::strongest_joints);
        while let Some(frame) = rollout.next_frame()? {
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
            let (wrenches, determined) = recorded.contacts(&rollout);
            recorded.times.push(frame.frame.timestamp);
            let valid = frame.frame.validity == Validity::Valid;
            recorded.truth.push(Truth { valid, links, determined, wrenches });
        }
        Ok(recorded)
    }

    /// Returns the wrenches of the engine's contacts on the bodies, and the links whose force they determine.
    fn contacts(&self, rollout: &Rollout) -> (Vec<Vector6<f64>>, [[bool; N_JOINTS]; 2]) {
        let world = rollout.world();
        let contacts: Vec<Contact> = world.contacts().collect();
        let mut determined = [[false; N_JOINTS]; 2];
        let mut wrenches = Vec::new();
        let solid = rollout.objects().iter().filter_map(|object| Some((object, object.body()?)));
        for ((object, body), known) in solid.zip(&self.bodies) {
            let (position, orientation) = object.pose();
            let mass = known.mass.expect("bodies of the simulator have a mass");
            let centre = position + orientation * mass.centre;
            let (mut force, mut moment) = (DVec3::ZERO, DVec3::ZERO);
            let (mut points, mut owners) = (Vec::new(), Vec::new());
            for contact in contacts.iter().filter(|contact| contact.bodies.contains(&body)) {
                let sign = if contact.bodies[1] == body { 1.0 } else { -1.0 };
                let other = contact.bodies[usize::from(contact.bodies[0] == body)];
                force += contact.force * sign;
                moment += (contact.position - centre).cross(contact.force * sign);
                if contact.normal_force > 0.0 {
                    let inward = contact.normal * sign;
                    let (t1, t2) = inward.any_orthonormal_pair();
                    let cone = Cone { friction: 1.0, limit: 1e3 };
                    let load = mass.kilograms * 9.81;
                    points.push(Point::new(contact.position - centre, [inward, t1, t2], DVec3::ZERO, load, cone));
                    owners.push(other);
                }
            }
            wrenches.push(Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z));
            if known.held.is_some() {
                continue;
            }
            for side in Side::BOTH {
                let rig = &rollout.rigs()[side as usize];
                for (link, name) in egotac::sim::rig::JOINT_NAMES.into_iter().enumerate() {
                    let Ok(of_link) = world.body(&rig.name(name)) else { continue };
                    let weight =
                        |owner: &egotac::mujoco::world::Body| if *owner == of_link { DVec3::X } else { DVec3::ZERO };
                    let weights: Vec<DVec3> = owners.iter().map(weight).collect();
                    if weights.iter().any(|weight| weight.x > 0.0) {
                        let noise = Matrix6::from_diagonal(&Vector6::new(1e-2, 1e-2, 1e-2, 1e-4, 1e-4, 1e-4));
                        let remaining = remaining_variance(&points, &weights, &(noise * noise));
                        determined[side as usize][link] = remaining < DETERMINED;
                    }
                }
            }
        }
        (wrenches, determined)
    }

    /// Returns the episode under a disturbance, and the index of each of its frames in [`Recorded::truth`].
    pub fn disturbed(&self, disturbance: &Disturbance, seed: u64) -> (Take<'_>, Vec<usize>) {
        let every = (RATE / disturbance.rate).round().max(1.0) as usize;
        let frames: Vec<usize> = (0..self.times.len()).step_by(every).collect();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (position, rotation) = (1e-3 * disturbance.millimetres, disturbance.degrees.to_radians());
        let mut vector = |sd: f64| sd * DVec3::from_array(std::array::from_fn(|_| StandardNormal.sample(&mut rng)));
        let mut tracked: [Vec<Tracked>; 2] = Default::default();
        for (tracked, of_hand) in tracked.iter_mut().zip(&self.tracked) {
            for frame in &frames {
                let mut hand = of_hand[*frame].clone();
                let (shift, turn) = (vector(position), DQuat::from_scaled_axis(vector(rotation)));
                if let Tracked::Present(params) = &mut hand {
                    params.transl += shift.as_vec3();
                    let orient = turn * DQuat::from_scaled_axis(params.global_orient.as_dvec3());
                    params.global_orient = orient.to_scaled_axis().as_vec3();
                }
                tracked.push(hand);
            }
        }
        let mut poses = Vec::new();
        for of_body in &self.poses {
            let moved = frames.iter().map(|frame| {
                let (shift, turn) = (vector(position), DQuat::from_scaled_axis(vector(rotation)));
                let pose = of_body[*frame]?;
                Some(Pose { position: pose.position + shift, orientation: turn * pose.orientation })
            });
            poses.push(moved.collect());
        }
        let mut bodies = self.bodies.clone();
        for body in &mut bodies {
            let Some(mass) = &mut body.mass else { continue };
            let (factor, sd) = match disturbance.mass {
                MassKnowledge::Known => (1.0, 0.0),
                MassKnowledge::Density => (vector(DENSITY_SD).x.exp(), DENSITY_SD),
                MassKnowledge::Wrong => (1.5, WRONG_SD),
            };
            (mass.kilograms, mass.inertia, mass.relative_sd) = (mass.kilograms * factor, mass.inertia * factor, sd);
        }
        let take = Take {
            times: frames.iter().map(|frame| self.times[*frame]).collect(),
            models: [&self.hands[0], &self.hands[1]],
            hands: tracked,
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
