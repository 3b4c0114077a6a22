//! Forces on one body at one instant: samples of the unknowns, each solved, and their spread.

use std::collections::BTreeMap;

use glam::DVec3;
use nalgebra::{Matrix6, Vector6};

use super::body::RigidBody;
use super::cone::Cone;
use super::contacts::Contact;
use super::demand::Demand;
use super::draw::Draw;
use super::patch::Pusher;
use super::settings::Settings;
use super::solve::{Point, remaining_variance, solve};
use crate::hand::link_limit;

/// Probability below which a contact is left out.
const LEAST_PROBABILITY: f64 = 0.03;
/// Speed up to which a body counts as at rest, m/s.
const REST_SPEED: f64 = 0.02;
/// Number of samples for a body that no hand touches.
const SAMPLES_WITHOUT_HAND: usize = 4;
/// Largest force of a support at one point, N.
const SUPPORT_LIMIT: f64 = 1e4;
/// Radius of the pad that stands for a single point of a link, m.
const PAD_RADIUS: f64 = 0.003;
/// Standard deviations of forces in the search for the least ones, relative to the load: of a hand's link and of a support,
/// which costs people nothing.
const LEAST: [f64; 2] = [20.0, 80.0];
/// Standard deviation of a grip force about its expectation, relative to it and to the load.
const GRIP_SD: (f64, f64) = (0.3, 0.05);

/// Force of one link on a body, normal to the surface, over the samples.
#[derive(Debug, Clone)]
pub struct LinkEstimate {
    /// Pusher, a link.
    pub pusher: Pusher,
    /// Points on the surface with the unit normal into the hand, and the mean normal force, N.
    pub points: Vec<(DVec3, DVec3, f64)>,
    /// Normal force of the link in each sample, N.
    pub samples: Vec<f64>,
    /// Share of the prior variance that the motion leaves: 0 = determined, 1 = not seen.
    pub remaining: f64,
}

/// Forces on one body at one instant.
#[derive(Debug, Clone)]
pub struct BodyEstimate {
    /// Wrench that the motion asks for, world frame, about the centre of mass: force, N, moment, N m.
    pub wrench: Vector6<f64>,
    /// Standard deviation of each part of the wrench.
    pub wrench_sd: Vector6<f64>,
    /// Larger of the body's weight and of the force that the motion asks for, N.
    pub load: f64,
    /// Part of the wrench that no contact explains, mean over the samples.
    pub residual: Vector6<f64>,
    /// True if the residual is beyond noise.
    pub unexplained: bool,
    /// True if the body moves, by more than the noise of good poses shows.
    pub moves: bool,
    /// Links that may push.
    pub links: Vec<LinkEstimate>,
    /// Force of all hands in the world frame, mean over the samples, N.
    pub hand_force: DVec3,
    /// Normal forces by pusher in each sample, N: the memory for the next frame.
    pub memory: Memory,
}

/// Normal forces of links in each sample, N.
pub type Memory = BTreeMap<Pusher, Vec<f64>>;

/// Estimates the forces on a free body whose motion asks for `demand`. `memory`: forces of a neighbouring frame, and the time to it, s.
pub fn estimate(
    body: &RigidBody,
    demand: &Demand,
    contacts: &[Contact],
    memory: Option<(&Memory, f64)>,
    settings: &Settings,
) -> BodyEstimate {
    let Demand { wrench, mut covariance, centre, weight, relative_sd, .. } = *demand;
    let load = weight.max(wrench.fixed_rows::<3>(0).norm()).max(1e-3);
    // Contacts are a little off their true places: moments are off by the load times that.
    for axis in 3..6 {
        covariance[(axis, axis)] += (settings.place_sd * load).powi(2);
    }
    let root = covariance.cholesky().map(|factor| factor.l()).unwrap_or_else(Matrix6::zeros);
    let contacts: Vec<Contact> = contacts.iter().filter(|c| c.probability >= LEAST_PROBABILITY).map(as_pad).collect();
    let problem = Problem { body, centre, contacts: &contacts, load, settings };
    // Without a hand, only the residual is asked for: idle things that lie about cost little.
    let is_held = contacts.iter().any(|contact| matches!(contact.patch.pusher, Pusher::Link(..)));
    let n = if is_held { settings.samples.max(2) } else { SAMPLES_WITHOUT_HAND };
    let mut links: Vec<LinkEstimate> = contacts
        .iter()
        .filter(|contact| matches!(contact.patch.pusher, Pusher::Link(..)))
        .map(|contact| LinkEstimate {
            pusher: contact.patch.pusher,
            points: contact.patch.points.iter().map(|(place, normal)| (*place, *normal, 0.0)).collect(),
            samples: Vec::with_capacity(n),
            remaining: 1.0,
        })
        .collect();
    let (mut residual, mut hand_force, mut misfit) = (Vector6::zeros(), DVec3::ZERO, Vec::with_capacity(n));
    for index in 0..n {
        let sample = Sample { draw: Draw(index as u64 / 2 + 1), sign: if index % 2 == 0 { 1.0 } else { -1.0 } };
        let noise = Vector6::from_fn(|row, _| sample.normal(100 + row as u64));
        let drawn = (wrench + root * noise) * (relative_sd * sample.normal(1)).exp();
        let (points, owners) = problem.points(&sample);
        let least = solve(&points, &drawn, &covariance);
        let expected = problem.grip(&sample, points, &owners, &least.forces, memory.map(|(m, dt)| (m, dt, index)));
        let solved = solve(&expected, &drawn, &covariance);
        residual += solved.residual / n as f64;
        misfit.push(mahalanobis(&solved.residual, &covariance));
        links.iter_mut().for_each(|link| link.samples.push(0.0));
        for ((point, (owner, place)), force) in expected.iter().zip(&owners).zip(&solved.forces) {
            let contact = &contacts[*owner];
            let Some(link) = links.iter_mut().find(|link| link.pusher == contact.patch.pusher) else { continue };
            *link.samples.last_mut().unwrap_or(&mut 0.0) += force.x;
            link.points[*place].2 += force.x / n as f64;
            let push = point.map * nalgebra::Vector3::from(force.to_array());
            hand_force += DVec3::new(push[0], push[1], push[2]) / n as f64;
        }
    }
    problem.determine(&mut links, &covariance);
    // A misfit is beyond noise if even the better half of the samples has one: 22.5 is the 99.9 % quantile of six numbers.
    misfit.sort_by(f64::total_cmp);
    let force = residual.fixed_rows::<3>(0).norm();
    let unexplained = misfit[n / 2] > 22.5 && force > 0.1 * load;
    let memory = links.iter().map(|link| (link.pusher, link.samples.clone())).collect();
    let wrench_sd = covariance.diagonal().map(f64::sqrt);
    let wrench_sd = wrench_sd.zip_map(&wrench, |sd, part| sd.hypot(part * relative_sd));
    let moves = demand.speed > REST_SPEED;
    BodyEstimate { wrench, wrench_sd, load, residual, unexplained, moves, links, hand_force, memory }
}

fn mahalanobis(residual: &Vector6<f64>, covariance: &Matrix6<f64>) -> f64 {
    covariance.cholesky().map_or(0.0, |factor| residual.dot(&factor.solve(residual)))
}

/// Returns a contact with more than one point: a fingertip's pad resists a turn about its normal.
fn as_pad(contact: &Contact) -> Contact {
    let mut contact = contact.clone();
    if let ([(place, normal)], Pusher::Link(..)) = (contact.patch.points.as_slice(), contact.patch.pusher) {
        let (place, normal) = (*place, *normal);
        let (t1, t2) = normal.any_orthonormal_pair();
        let corner = |k: u32| {
            let angle = f64::from(k) * std::f64::consts::TAU / 3.0;
            (place + PAD_RADIUS * (t1 * angle.cos() + t2 * angle.sin()), normal)
        };
        contact.patch.points = (0..3).map(corner).collect();
    }
    contact
}

/// One sample of the unknowns; samples come in pairs of opposite signs.
struct Sample {
    draw: Draw,
    sign: f64,
}

impl Sample {
    fn normal(&self, key: u64) -> f64 {
        self.sign * self.draw.normal(key)
    }

    /// Uniform number, mirrored in the second of a pair.
    fn uniform(&self, key: u64) -> f64 {
        let u = self.draw.uniform(key);
        if self.sign < 0.0 { 1.0 - u } else { u }
    }
}

/// Parts of the problem that all samples share.
struct Problem<'a> {
    body: &'a RigidBody,
    centre: DVec3,
    contacts: &'a [Contact],
    load: f64,
    settings: &'a Settings,
}

/// Index of a contact, and of the point in its patch.
type Owner = (usize, usize);

impl Problem<'_> {
    /// Returns the points that bear force in a sample, with the expectation of no force.
    fn points(&self, sample: &Sample) -> (Vec<Point>, Vec<Owner>) {
        let friction = self.body.friction * (self.settings.friction_spread * sample.normal(2)).exp();
        let (mut points, mut owners) = (Vec::new(), Vec::new());
        for (index, contact) in self.contacts.iter().enumerate() {
            let key = key(contact.patch.pusher);
            if sample.uniform(key) >= contact.probability {
                continue;
            }
            for (place, (position, normal)) in contact.patch.points.iter().enumerate() {
                points.push(self.point(contact, *position, *normal, friction, Some((sample, key + 1 + place as u64))));
                owners.push((index, place));
            }
        }
        (points, owners)
    }

    fn point(
        &self,
        contact: &Contact,
        position: DVec3,
        normal: DVec3,
        friction: f64,
        moved: Option<(&Sample, u64)>,
    ) -> Point {
        let n = contact.patch.points.len() as f64;
        let inward = -normal;
        let (t1, t2) = inward.any_orthonormal_pair();
        let shift = moved.map_or(DVec3::ZERO, |(sample, key)| {
            self.settings.place_sd * (t1 * sample.normal(key + 1000) + t2 * sample.normal(key + 2000))
        });
        let (sd, limit) = match contact.patch.pusher {
            Pusher::Link(_, link) => (LEAST[0] * self.load, link_limit(link) / n),
            Pusher::Fixed(_) | Pusher::Body(_) => (LEAST[1] * self.load, SUPPORT_LIMIT),
        };
        let arm = position + shift - self.centre;
        Point::new(arm, [inward, t1, t2], DVec3::ZERO, sd / n.sqrt(), Cone { friction, limit })
    }

    /// Sets the expectations of a grip: a multiple of the least forces, a hold on what something else still carries, and
    /// the forces of a moment ago.
    fn grip(
        &self,
        sample: &Sample,
        mut points: Vec<Point>,
        owners: &[Owner],
        least: &[DVec3],
        memory: Option<(&Memory, f64, usize)>,
    ) -> Vec<Point> {
        let settings = self.settings;
        let factor = 1.0 + (settings.grip - 1.0) * (settings.grip_spread * sample.normal(3)).exp();
        let hold = settings.early_grip * self.load / (2.0 * self.body.friction);
        let links = self.contacts.iter().filter(|c| matches!(c.patch.pusher, Pusher::Link(..)) && c.probability > 0.5);
        let links = (links.count() as f64).max(1.0);
        for ((point, (owner, _)), least) in points.iter_mut().zip(owners).zip(least) {
            let contact = &self.contacts[*owner];
            let n = contact.patch.points.len() as f64;
            if !matches!(contact.patch.pusher, Pusher::Link(..)) {
                point.expected = *least;
                continue;
            }
            let own = sample.normal(key(contact.patch.pusher) + 500);
            let early = hold * own.abs() / (n * links.sqrt());
            let mut expected = factor * least.x * (GRIP_SD.0 * own).exp() + early;
            if let Some((memory, interval, index)) = memory
                && let Some(before) = memory.get(&contact.patch.pusher).and_then(|samples| samples.get(index))
            {
                let kept = (-interval / settings.memory).exp();
                // A force is remembered as a level of squeeze: never below the least one.
                let before = (before / n).max(least.x);
                expected = (1.0 - kept) * expected + kept * before;
            }
            let sd = GRIP_SD.0 * expected + GRIP_SD.1 * self.load / n;
            point.expected = DVec3::new(expected, least.y, least.z);
            point.precision = 1.0 / (sd * sd);
        }
        points
    }

    /// Computes which links' forces the motion determines: without friction cones, from the geometry alone.
    fn determine(&self, links: &mut [LinkEstimate], covariance: &Matrix6<f64>) {
        let (mut points, mut owners) = (Vec::new(), Vec::new());
        for contact in self.contacts.iter().filter(|contact| contact.probability > 0.2) {
            for (position, normal) in &contact.patch.points {
                points.push(self.point(contact, *position, *normal, self.body.friction, None));
                owners.push(contact.patch.pusher);
            }
        }
        // One width for all, so that the ratio tells of geometry and not of priors.
        points.iter_mut().for_each(|point| point.precision = 1.0 / (self.load * self.load));
        for link in links.iter_mut() {
            let weight = |pusher: &Pusher| if *pusher == link.pusher { DVec3::X } else { DVec3::ZERO };
            let weights: Vec<DVec3> = owners.iter().map(weight).collect();
            link.remaining = remaining_variance(&points, &weights, covariance);
        }
    }
}

/// Key of a pusher's random numbers.
fn key(pusher: Pusher) -> u64 {
    let index = match pusher {
        Pusher::Link(side, link) => 16 * side as u64 + link as u64,
        Pusher::Fixed(index) => 100 + index as u64,
        Pusher::Body(index) => 1000 + index as u64,
    };
    10_000 + 10_000 * index
}
