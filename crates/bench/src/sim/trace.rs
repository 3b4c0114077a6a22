//! Trace of a rollout in bins of one frame interval, a time base that all timesteps share.

use std::collections::HashMap;

use egotac::error::Result;
use egotac::hand::Side;
use egotac::mujoco::World;
use egotac::mujoco::world::{Body, FreeJoint};
use egotac::score::metrics::contact::CONTACT_THRESHOLD;
use egotac::sim::budget::clock::Stopwatch;
use egotac::sim::rig::{JOINT_NAMES, site_of};
use egotac::sim::scene::Site;
use egotac::sim::{Rollout, RolloutOptions, Scene, SimFrame};
use egotac::tactile::{N_FIELD, Validity};

/// Sites of both hands: thumb to little finger and palm, left hand first.
pub const N_SITES: usize = 12;

/// Largest change of the sites' forces between neighbouring bins of a quiet bin, relative to their sum.
const QUIET_CHANGE: f64 = 0.05;
/// Largest acceleration of an object in a quiet bin, m/s²: a hundredth of gravity.
const QUIET_ACCELERATION: f64 = 0.1;
/// Least sum of the sites' forces that is worth comparing, N.
const LEAST_FORCE: f64 = 0.1;

/// Impulses, contacts and states of a rollout.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Trace {
    /// Length of a bin, s.
    pub interval: f64,
    /// (bins) impulse of the normal forces on each site, N s.
    pub impulses: Vec<[f64; N_SITES]>,
    /// (bins) upward impulse of all contacts of the free objects, N s.
    pub lifts: Vec<f64>,
    /// (bins) largest mean acceleration of a free object, m/s².
    pub accelerations: Vec<f64>,
    /// (bins) weight of the awake free objects, times time, N s; the engine does not list contacts of sleeping objects.
    pub weights: Vec<f64>,
    /// (frames) vertices in contact (label c: above 0.05 N), ascending.
    pub touched: Vec<Vec<u32>>,
    /// (frames) positions of all joints.
    pub states: Vec<Vec<f64>>,
    /// Number of frames that a guard refused.
    pub invalid: usize,
}

/// Bodies of the sites and joints of the objects that are recorded.
struct Recorded {
    sites: HashMap<Body, usize>,
    objects: Vec<FreeJoint>,
}

impl Trace {
    /// Runs an episode and records the forces on hands and objects.
    ///
    /// # Errors
    /// If the rollout can't be made or fails.
    pub fn record(scene: &Scene, seed: u64, options: &RolloutOptions) -> Result<Self> {
        Self::record_timed(scene, seed, options).map(|(trace, _)| trace)
    }

    /// As [`Self::record`], with the processor time per simulated second, s.
    ///
    /// # Errors
    /// As [`Self::record`].
    pub fn record_timed(scene: &Scene, seed: u64, options: &RolloutOptions) -> Result<(Self, f64)> {
        let mut rollout = Rollout::new(scene, seed, options)?;
        let recorded = Recorded::of(&rollout);
        let mut trace = Self { interval: rollout.interval(), ..Self::default() };
        let begun = Stopwatch::start();
        let mut bin = Bin::default();
        let mut velocities = recorded.velocities(rollout.world());
        while let Some(frame) = rollout.next_frame_watched(|world| recorded.add(world, &mut bin))? {
            if !trace.touched.is_empty() {
                let now = recorded.velocities(rollout.world());
                let change = velocities.iter().zip(&now).map(|(a, b)| (*b - *a).length() / trace.interval);
                trace.accelerations.push(change.fold(0.0, f64::max));
                trace.impulses.push(bin.sites);
                trace.lifts.push(bin.lift);
                trace.weights.push(bin.weight);
                (bin, velocities) = (Bin::default(), now);
            }
            trace.touched.push(touched(&frame));
            trace.states.push(rollout.world().qpos().to_vec());
            trace.invalid += usize::from(frame.frame.validity != Validity::Valid);
        }
        let simulated = trace.interval * trace.impulses.len().max(1) as f64;
        Ok((trace, begun.seconds() / simulated))
    }

    /// Returns the bins in which neither forces nor objects change much, so that a steady grasp is compared.
    pub fn quiet(&self) -> Vec<usize> {
        let change = |a: &[f64; N_SITES], b: &[f64; N_SITES]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f64>();
        let is_quiet = |k: &usize| {
            let sum: f64 = self.impulses[*k].iter().sum();
            let change = |other: usize| change(&self.impulses[*k], &self.impulses[other]);
            sum > LEAST_FORCE * self.interval
                && change(k - 1).max(change(k + 1)) <= QUIET_CHANGE * sum
                && self.accelerations[*k] <= QUIET_ACCELERATION
        };
        (1..self.impulses.len().saturating_sub(1)).filter(is_quiet).collect()
    }

    /// Returns the mean force on each site over some bins, N; bins that the rollout did not reach count as 0.
    pub fn mean_forces(&self, bins: &[usize]) -> [f64; N_SITES] {
        let time = self.interval * bins.len().max(1) as f64;
        let sum = |site: usize| bins.iter().filter_map(|bin| self.impulses.get(*bin)).map(|bin| bin[site]).sum::<f64>();
        std::array::from_fn(|site| sum(site) / time)
    }

    /// Returns the impulse on each site over the whole run, N s.
    pub fn total_impulses(&self) -> [f64; N_SITES] {
        std::array::from_fn(|site| self.impulses.iter().map(|bin| bin[site]).sum())
    }

    /// Returns the upward force on the free objects over some bins, relative to their weight: 1 if they rest or are held
    /// still.
    pub fn lift(&self, bins: &[usize]) -> Option<f64> {
        let sum = |values: &[f64]| bins.iter().filter_map(|bin| values.get(*bin)).sum::<f64>();
        let (lift, weight) = (sum(&self.lifts), sum(&self.weights));
        (weight > 0.0).then(|| lift / weight)
    }
}

/// Sums over the steps of one bin, N s.
#[derive(Debug, Clone, Copy, Default)]
struct Bin {
    sites: [f64; N_SITES],
    lift: f64,
    weight: f64,
}

impl Recorded {
    fn of(rollout: &Rollout) -> Self {
        let world = rollout.world();
        let mut sites = HashMap::new();
        for side in Side::BOTH {
            for (joint, name) in JOINT_NAMES.iter().enumerate() {
                // An absent hand has no bodies.
                if let Ok(body) = world.body(&rollout.rigs()[side as usize].name(name)) {
                    sites.insert(body, side as usize * (HandSite::Palm as usize + 1) + site_of(joint) as usize);
                }
            }
        }
        Self { sites, objects: rollout.objects().iter().filter_map(|object| object.joint).collect() }
    }

    /// Adds the impulses of a step: on each site, and upwards on the objects.
    fn add(&self, world: &World, bin: &mut Bin) {
        let dt = world.options().timestep;
        let awake = self.objects.iter().map(|joint| world.body_of(*joint)).filter(|body| world.is_awake(*body));
        bin.weight -= dt * world.options().gravity[2] * awake.map(|body| world.mass(body)).sum::<f64>();
        for contact in world.contacts().filter(|contact| contact.normal_force > 0.0) {
            for (body, sign) in contact.bodies.into_iter().zip([-1.0, 1.0]) {
                if let Some(site) = self.sites.get(&body) {
                    bin.sites[*site] += contact.normal_force * dt;
                }
                if self.objects.iter().any(|joint| world.body_of(*joint) == body) {
                    bin.lift += sign * contact.force.z * dt;
                }
            }
        }
    }

    fn velocities(&self, world: &World) -> Vec<glam::DVec3> {
        self.objects.iter().map(|joint| world.velocity(*joint)).collect()
    }
}

fn touched(frame: &SimFrame) -> Vec<u32> {
    // Contact is known also without dynamics, when forces are unknown.
    let contact = &frame.frame.field.contact;
    (0..N_FIELD as u32).filter(|vertex| contact[*vertex as usize] > CONTACT_THRESHOLD).collect()
}
