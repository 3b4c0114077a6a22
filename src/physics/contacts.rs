//! Contacts of a take over time: patches, and the probability that each of them bears force.

use std::collections::BTreeMap;

use glam::{DMat3, DVec3, Vec3};

use super::draw::normal_below;
use super::motion::Motion;
use super::patch::{Patch, Pusher, SUPPORT_GAP, blocked_links, hand_patches, support_patch, untold};
use super::pose::{Pose, PoseNoise};
use super::settings::Settings;
use super::take::Take;
use crate::hand::{N_JOINTS, Side};

/// Distance of a fingertip from the wrist, by which noise of the wrist's rotation acts, m.
const HAND_LEVER: f64 = 0.12;
/// Standard deviation of gaps between exact poses, m: the hand's mesh and skin.
const EXACT_SD: f64 = 0.0005;
/// Reach of patches beyond the gap that means contact, m and standard deviations.
const REACH: (f64, f64) = (0.0015, 2.0);
/// Gap up to which a link counts as near, m, beside the deviations of [`REACH`]: vertices are up to 8 mm apart, and hulls of
/// links protrude from the skin by up to 4 mm, so that contact with such a link is possible where no vertex touches.
const NEAR: f64 = 0.004;
/// Depth that no contact reaches, m, beside three standard deviations of the gap.
const DEEP: f64 = 0.012;
/// Longest window over which gaps are averaged to either side, s: the time in which contact begins or ends.
const GAP_WINDOW: f64 = 0.1;

/// A patch with its probability.
#[derive(Debug, Clone)]
pub struct Contact {
    /// Patch.
    pub patch: Patch,
    /// Probability that it bears force.
    pub probability: f64,
    /// True if the hand is deeper than noise explains.
    pub deep: bool,
}

impl Contact {
    /// Adds the places of another contact with the same pusher.
    fn add(&mut self, other: Self) {
        self.patch.gap = self.patch.gap.min(other.patch.gap);
        self.patch.points.extend(other.patch.points);
        self.probability = self.probability.max(other.probability);
        self.deep |= other.deep;
    }
}

/// Contacts at one frame.
#[derive(Debug, Clone, Default)]
pub struct FrameContacts {
    /// Contacts of each body.
    pub bodies: Vec<Vec<Contact>>,
    /// Links of both hands that touch things whose forces the motion does not tell.
    pub blocked: [[bool; N_JOINTS]; 2],
    /// Distance by which each hand was moved, m.
    pub moved: [f64; 2],
}

/// Finder of contacts.
#[derive(Debug)]
pub struct ContactFinder {
    link_of: [Vec<usize>; 2],
    /// Noise of both hands' wrists.
    pub hand_noise: [PoseNoise; 2],
    settings: Settings,
}

impl ContactFinder {
    /// Prepares the search in a take.
    pub fn new(take: &Take, settings: &Settings) -> Self {
        let link_of = Side::BOTH.map(|side| take.models[side as usize].strongest_joints());
        let hand_noise = Side::BOTH.map(|side| PoseNoise::estimate(&take.wrists(side)));
        Self { link_of, hand_noise, settings: *settings }
    }

    /// Returns the standard deviation of gaps between a hand, or a support (`None`), and a body, m.
    fn gap_sd(&self, side: Option<Side>, body: PoseNoise) -> f64 {
        let of = |noise: PoseNoise, lever: f64| noise.position.hypot(noise.rotation * lever);
        let hand = side.map_or(0.0, |side| of(self.hand_noise[side as usize], HAND_LEVER));
        hand.hypot(of(body, 0.05))
    }

    /// Finds the contacts of a frame, with probabilities from this frame alone. `poses`: of each body.
    pub fn frame(&self, take: &Take, frame: usize, poses: &[Option<Pose>], noises: &[PoseNoise]) -> FrameContacts {
        let mut vertices = Side::BOTH.map(|side| take.vertices(side, frame));
        let mut found = FrameContacts { bodies: vec![Vec::new(); take.bodies.len()], ..Default::default() };
        if self.settings.refine {
            for side in Side::BOTH {
                if let Some(vertices) = &mut vertices[side as usize] {
                    found.moved[side as usize] = self.refine(take, side, vertices, poses, noises);
                }
            }
        }
        for (index, body) in take.bodies.iter().enumerate() {
            let Some(pose) = poses[index] else { continue };
            for side in Side::BOTH {
                let Some(vertices) = &vertices[side as usize] else { continue };
                let sd = self.gap_sd(Some(side), noises[index]);
                let reach = (self.settings.contact_gap + REACH.0).max(NEAR) + REACH.1 * sd;
                let patches = hand_patches(vertices, &self.link_of[side as usize], side, body, &pose, reach);
                found.bodies[index].extend(patches.into_iter().map(|patch| self.contact(patch, sd)));
            }
            let sd = self.gap_sd(None, noises[index]);
            let reach = SUPPORT_GAP + REACH.0 + REACH.1 * sd;
            let fixed = take.fixed.iter().enumerate().map(|(k, thing)| (Pusher::Fixed(k), &thing.solid, thing.pose));
            let others = take.bodies.iter().enumerate().filter(|(other, _)| take.root(*other) != take.root(index));
            let others = others.filter_map(|(k, other)| Some((Pusher::Body(k), other.solid.as_ref()?, poses[k]?)));
            for (pusher, solid, at) in fixed.chain(others) {
                let patch = support_patch(body, &pose, pusher, solid, &at, reach);
                found.bodies[index].extend(patch.map(|patch| self.contact(patch, sd)));
            }
        }
        let others = untold(take, frame);
        for side in Side::BOTH {
            let Some(own) = &vertices[side as usize] else { continue };
            let other = vertices[1 - side as usize].as_deref();
            let reach = self.settings.contact_gap + self.gap_sd(Some(side), PoseNoise::default());
            found.blocked[side as usize] = blocked_links(own, &self.link_of[side as usize], &others, other, reach);
        }
        found
    }

    fn contact(&self, patch: Patch, sd: f64) -> Contact {
        let deep = matches!(patch.pusher, Pusher::Link(..)) && patch.gap < -(DEEP + 3.0 * sd);
        let probability = self.probability(patch.pusher, patch.gap, sd, 1.0);
        Contact { patch, probability, deep }
    }

    /// Returns the probability of force at a mean gap, m, of `n` independent gaps.
    fn probability(&self, pusher: Pusher, gap: f64, sd: f64, n: f64) -> f64 {
        let most = match pusher {
            Pusher::Link(..) => self.settings.contact_gap,
            Pusher::Fixed(_) | Pusher::Body(_) => SUPPORT_GAP,
        };
        normal_below((most - gap) / EXACT_SD.hypot(sd / n.sqrt()))
    }

    /// Averages gaps over neighbouring frames as far as noise asks for it, and computes probabilities from the averages.
    pub fn smooth(&self, frames: &mut [FrameContacts], times: &[f64], motions: &[Option<Motion>]) {
        for (body, motion) in motions.iter().enumerate() {
            let noise = motion.as_ref().map(|motion| motion.noise).unwrap_or_default();
            let mut series: BTreeMap<Pusher, Vec<(usize, f64)>> = BTreeMap::new();
            for (frame, contacts) in frames.iter().enumerate() {
                for contact in contacts.bodies.get(body).into_iter().flatten() {
                    series.entry(contact.patch.pusher).or_default().push((frame, contact.patch.gap));
                }
            }
            for (pusher, gaps) in series {
                let side = if let Pusher::Link(side, _) = pusher { Some(side) } else { None };
                let sd = self.gap_sd(side, noise);
                // Exact gaps need no average, and one would blur the moment of touch.
                if sd <= EXACT_SD {
                    continue;
                }
                // A frame without this patch is one whose gap is beyond the reach.
                let reach = self.settings.contact_gap + REACH.0 + REACH.1 * sd;
                for (frame, _) in &gaps {
                    let near = |other: &usize| (times[*other] - times[*frame]).abs() <= GAP_WINDOW;
                    let low = (0..*frame).rev().take_while(near).last().unwrap_or(*frame);
                    let high = (*frame..frames.len()).take_while(near).last().unwrap_or(*frame);
                    let known: Vec<f64> =
                        gaps.iter().filter(|g| (low..=high).contains(&g.0)).map(|g| g.1.min(reach)).collect();
                    let all = (high - low + 1) as f64;
                    let mean = (known.iter().sum::<f64>() + (all - known.len() as f64) * reach) / all;
                    let probability = self.probability(pusher, mean, sd, all);
                    let contacts = &mut frames[*frame].bodies[body];
                    if let Some(contact) = contacts.iter_mut().find(|contact| contact.patch.pusher == pusher) {
                        contact.probability = probability;
                    }
                }
            }
        }
    }

    /// Gives the contacts of all parts of an articulated object to its first one, once their probabilities are known.
    pub fn join(take: &Take, contacts: &mut FrameContacts) {
        for part in 0..contacts.bodies.len() {
            let root = take.root(part);
            if root == part {
                continue;
            }
            for contact in std::mem::take(&mut contacts.bodies[part]) {
                let twin = contacts.bodies[root].iter_mut().find(|twin| twin.patch.pusher == contact.patch.pusher);
                match twin {
                    // A link or a support that touches several parts pushes at all these places.
                    Some(twin) => twin.add(contact),
                    None => contacts.bodies[root].push(contact),
                }
            }
        }
    }

    /// Moves a hand, within its noise, to where its near links touch; returns by how far, m.
    fn refine(
        &self,
        take: &Take,
        side: Side,
        vertices: &mut [Vec3],
        poses: &[Option<Pose>],
        noises: &[PoseNoise],
    ) -> f64 {
        let (mut normal, mut right, mut noise) = (DMat3::ZERO, DVec3::ZERO, 0.0f64);
        for (index, body) in take.bodies.iter().enumerate() {
            let Some(pose) = poses[index] else { continue };
            let sd = self.gap_sd(Some(side), noises[index]);
            noise = noise.max(sd);
            for patch in hand_patches(vertices, &self.link_of[side as usize], side, body, &pose, REACH.1 * sd) {
                let (_, n) = patch.points[0];
                let weight = 1.0 / EXACT_SD.hypot(0.5 * sd).powi(2);
                normal += DMat3::from_cols(n * n.x, n * n.y, n * n.z) * weight;
                right -= n * (patch.gap * weight);
            }
        }
        if noise <= EXACT_SD {
            return 0.0;
        }
        let prior = DMat3::from_diagonal(DVec3::splat(1.0 / (noise * noise)));
        let shift = ((normal + prior).inverse() * right).clamp_length_max(2.0 * noise);
        vertices.iter_mut().for_each(|v| *v += shift.as_vec3());
        shift.length()
    }
}
