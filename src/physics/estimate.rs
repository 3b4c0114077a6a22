//! Forces on both hands over a take: the whole episode at once, or with a fixed lag.

use glam::DVec3;

use super::contacts::{ContactFinder, FrameContacts};
use super::frame::{BodyEstimate, Memory, estimate};
use super::motion::{Motion, MotionFault};
use super::patch::Pusher;
use super::pose::{Pose, PoseNoise};
use super::settings::Settings;
use super::take::{Take, Tracked};
use super::validity::ForceValidity;
use crate::hand::{N_JOINTS, Side};

/// Share of the prior variance above which a link's force is undetermined.
const UNDETERMINED: f64 = 0.1;
/// Probability above which a link counts as touching.
const TOUCHES: f64 = 0.2;
/// Least half width of an interval, N.
const LEAST_WIDTH: f64 = 0.02;
/// Quantile of the standard normal distribution at 95 %.
const Z95: f64 = 1.645;

/// Normal force on one link of a hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkForce {
    /// Mean, N.
    pub force: f64,
    /// Standard deviation, N.
    pub sd: f64,
    /// Ends of the 90 % interval, N.
    pub interval: [f64; 2],
    /// True if the motion alone does not determine the force: what is stated follows from how people grip.
    pub undetermined: bool,
}

impl LinkForce {
    const ZERO: Self = Self { force: 0.0, sd: 0.0, interval: [0.0; 2], undetermined: false };
}

/// Normal force at a point of a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointForce {
    /// Link.
    pub link: usize,
    /// Place, m, world frame.
    pub position: DVec3,
    /// Unit normal into the hand.
    pub normal: DVec3,
    /// Mean force, N.
    pub force: f64,
}

/// Forces on one hand at one frame.
#[derive(Debug, Clone)]
pub struct HandEstimate {
    /// Validity; unless valid, links that touch something are unknown.
    pub validity: ForceValidity,
    /// Force on each link; `None` = unknown.
    pub links: [Option<LinkForce>; N_JOINTS],
    /// Forces at points of links.
    pub points: Vec<PointForce>,
    /// True if a touching link's force is undetermined.
    pub undetermined: bool,
    /// Standard deviation of the sum of all links' forces, N: the width of what the motion does not tell.
    pub squeeze_sd: f64,
    /// Distance by which the hand was moved, m; 0 without `refine`.
    pub moved: f64,
}

/// Forces at one frame.
#[derive(Debug, Clone)]
pub struct FrameEstimate {
    /// Left and right hand.
    pub hands: [HandEstimate; 2],
    /// Estimate of each body; `None` = the body is held or unknown here.
    pub bodies: Vec<Option<BodyEstimate>>,
}

/// Forces over a take.
#[derive(Debug, Clone)]
pub struct Estimate {
    /// Forces at each frame.
    pub frames: Vec<FrameEstimate>,
    /// Noise of the poses of both hands and of each body.
    pub hand_noise: [PoseNoise; 2],
    /// Noise of each body's poses; `None` = its motion was not needed.
    pub body_noise: Vec<Option<PoseNoise>>,
    /// Bandwidth of each body's motion, 1/s.
    pub bandwidth: Vec<Option<f64>>,
}

/// Estimates the forces of a whole take.
pub fn whole(take: &Take, settings: &Settings) -> Estimate {
    let n = take.times.len();
    let prepared = Prepared::new(take, settings);
    let mut contacts: Vec<FrameContacts> = (0..n).map(|frame| prepared.contacts(frame)).collect();
    prepared.finder.smooth(&mut contacts, &take.times, &prepared.motions);
    let bodies = take.bodies.len();
    let mut memories: Vec<Option<(Memory, f64)>> = vec![None; bodies];
    let pass = |frame: usize, memories: &mut Vec<Option<(Memory, f64)>>| {
        let estimates: Vec<Option<BodyEstimate>> =
            (0..bodies).map(|body| prepared.body(body, frame, &contacts[frame], memories[body].as_ref())).collect();
        for (memory, estimate) in memories.iter_mut().zip(&estimates) {
            *memory = estimate.as_ref().map(|estimate| (estimate.memory.clone(), take.times[frame]));
        }
        estimates
    };
    // Grip holds on in both directions of time: the mean of both passes begins and ends as softly.
    let forward: Vec<_> = (0..n).map(|frame| pass(frame, &mut memories)).collect();
    memories = vec![None; bodies];
    let mut backward: Vec<_> = (0..n).rev().map(|frame| pass(frame, &mut memories)).collect();
    backward.reverse();
    let frames = forward.into_iter().zip(backward).enumerate().map(|(frame, (forward, backward))| {
        let both = forward.into_iter().zip(backward).map(|(a, b)| a.zip(b).map(|(a, b)| a.mean(b))).collect();
        prepared.hands(frame, &contacts[frame], both)
    });
    let frames = frames.collect();
    let of_motion = |value: fn(&Motion) -> PoseNoise| prepared.motions.iter().map(|m| m.as_ref().map(value)).collect();
    Estimate {
        frames,
        hand_noise: prepared.finder.hand_noise,
        body_noise: of_motion(|motion| motion.noise),
        bandwidth: prepared.motions.iter().map(|m| m.as_ref().map(|motion| motion.bandwidth)).collect(),
    }
}

/// Estimates the forces at frame `lagged` of a take that holds the last frames of a stream, as far as `memories` of the frames
/// before it and the frames up to the newest tell. `memories` are updated; they start empty.
pub fn lagged(
    take: &Take,
    lagged: usize,
    memories: &mut Vec<Option<(Memory, f64)>>,
    settings: &Settings,
) -> FrameEstimate {
    let prepared = Prepared::new(take, settings);
    memories.resize(take.bodies.len(), None);
    // Only gaps about the lagged frame take part in its averages.
    let mut contacts: Vec<FrameContacts> = vec![FrameContacts::default(); take.times.len()];
    for (frame, contacts) in contacts.iter_mut().enumerate() {
        if (take.times[frame] - take.times[lagged]).abs() <= 0.1 {
            *contacts = prepared.contacts(frame);
        }
    }
    prepared.finder.smooth(&mut contacts, &take.times, &prepared.motions);
    let estimates: Vec<Option<BodyEstimate>> = (0..take.bodies.len())
        .map(|body| prepared.body(body, lagged, &contacts[lagged], memories[body].as_ref()))
        .collect();
    for (memory, estimate) in memories.iter_mut().zip(&estimates) {
        *memory = estimate.as_ref().map(|estimate| (estimate.memory.clone(), take.times[lagged]));
    }
    prepared.hands(lagged, &contacts[lagged], estimates)
}

/// Motion and contacts of a take.
struct Prepared<'a> {
    take: &'a Take<'a>,
    settings: &'a Settings,
    finder: ContactFinder,
    /// Motion of each free body of known mass.
    motions: Vec<Option<Motion>>,
}

impl<'a> Prepared<'a> {
    fn new(take: &'a Take<'a>, settings: &'a Settings) -> Self {
        let motion = |(body, poses): (&super::body::Body, &Vec<Option<Pose>>)| {
            let centre = body.mass.filter(|_| body.held.is_none())?.centre;
            Some(Motion::new(&take.times, poses, centre, settings.bandwidth))
        };
        let motions = take.bodies.iter().zip(&take.poses).map(motion).collect();
        Self { take, settings, finder: ContactFinder::new(take, settings), motions }
    }

    fn contacts(&self, frame: usize) -> FrameContacts {
        // Smoothed poses are nearer to the truth; a body without a motion keeps its recorded ones.
        let pose = |body: usize| match &self.motions[body] {
            Some(motion) => motion.frames[frame].filter(|_| motion.faults[frame].is_none()).map(|state| state.pose),
            None => self.take.poses[body][frame],
        };
        let poses: Vec<Option<Pose>> = (0..self.take.bodies.len()).map(pose).collect();
        let noise = |body: usize| match &self.motions[body] {
            Some(motion) => motion.frames[frame].map_or(motion.noise, |state| state.pose_sd),
            None => PoseNoise::default(),
        };
        let noises: Vec<PoseNoise> = (0..self.take.bodies.len()).map(noise).collect();
        self.finder.frame(self.take, frame, &poses, &noises)
    }

    fn body(
        &self,
        body: usize,
        frame: usize,
        contacts: &FrameContacts,
        memory: Option<&(Memory, f64)>,
    ) -> Option<BodyEstimate> {
        let motion = self.motions[body].as_ref()?;
        let state = motion.frames[frame].filter(|_| motion.faults[frame].is_none())?;
        let (gravity, mass) = (self.take.gravity?, self.take.bodies[body].mass.as_ref()?);
        let memory = memory.map(|(memory, time)| (memory, (self.take.times[frame] - time).abs()));
        let contacts = contacts.bodies.get(body)?;
        Some(estimate(&self.take.bodies[body], mass, &state, gravity, contacts, memory, self.settings))
    }

    /// Collects the forces on both hands from those on the bodies.
    fn hands(&self, frame: usize, contacts: &FrameContacts, bodies: Vec<Option<BodyEstimate>>) -> FrameEstimate {
        let hands = Side::BOTH.map(|side| self.hand(side, frame, contacts, &bodies));
        FrameEstimate { hands, bodies }
    }

    fn hand(
        &self,
        side: Side,
        frame: usize,
        contacts: &FrameContacts,
        bodies: &[Option<BodyEstimate>],
    ) -> HandEstimate {
        let mut hand = HandEstimate {
            validity: ForceValidity::Valid,
            links: [Some(LinkForce::ZERO); N_JOINTS],
            points: Vec::new(),
            undetermined: false,
            squeeze_sd: 0.0,
            moved: contacts.moved[side as usize],
        };
        match &self.take.hands[side as usize][frame] {
            Tracked::Absent => return hand,
            Tracked::Unknown => {
                hand.lose(ForceValidity::HandUnknown);
                return hand;
            }
            Tracked::Present(_) => {}
        }
        let mut samples = [const { Vec::<f64>::new() }; N_JOINTS];
        let mut unseen = [0.0f64; N_JOINTS];
        for (index, body) in self.take.bodies.iter().enumerate() {
            let near = contacts.bodies.get(index).map(Vec::as_slice).unwrap_or_default();
            let of_side = |pusher: Pusher| matches!(pusher, Pusher::Link(s, _) if s == side);
            let touching = near.iter().filter(|c| of_side(c.patch.pusher) && c.probability > TOUCHES);
            let touches = touching.clone().next().is_some();
            if touching.clone().any(|contact| contact.deep) {
                hand.lose(ForceValidity::Deep);
            }
            let Some(estimate) = &bodies[index] else {
                if let Some(reason) = self.unknown(body, index, frame).filter(|reason| {
                    // Without a pose, nobody knows what is touched.
                    touches || matches!(reason, ForceValidity::PoseGap | ForceValidity::PoseJump)
                }) {
                    hand.lose(reason);
                }
                continue;
            };
            if estimate.unexplained {
                hand.lose(ForceValidity::Unexplained);
            }
            let hold = estimate.load / (2.0 * body.friction);
            let [force, grip] = self.settings.unseen;
            for contact in near.iter().filter(|contact| of_side(contact.patch.pusher)) {
                let Pusher::Link(_, joint) = contact.patch.pusher else { continue };
                // The motion says nothing of a link that is near, but hardly touches.
                let link = estimate.links.iter().find(|link| link.pusher == contact.patch.pusher);
                let remaining = link.map_or(1.0, |link| link.remaining);
                unseen[joint] = unseen[joint].hypot(remaining.sqrt() * (force + grip * hold));
                if link.is_none() {
                    let place = |(position, normal): &(DVec3, DVec3)| PointForce {
                        link: joint,
                        position: *position,
                        normal: *normal,
                        force: 0.0,
                    };
                    hand.points.extend(contact.patch.points.iter().map(place));
                }
            }
            for link in &estimate.links {
                let Pusher::Link(of, joint) = link.pusher else { continue };
                if of != side {
                    continue;
                }
                let probable = touching.clone().any(|contact| contact.patch.pusher == link.pusher);
                let sum = &mut samples[joint];
                sum.resize(link.samples.len(), 0.0);
                sum.iter_mut().zip(&link.samples).for_each(|(sum, force)| *sum += force);
                if let Some(force) = &mut hand.links[joint] {
                    force.undetermined |= probable && link.remaining > UNDETERMINED;
                    hand.undetermined |= force.undetermined;
                }
                hand.points.extend(link.points.iter().map(|(position, normal, force)| PointForce {
                    link: joint,
                    position: *position,
                    normal: *normal,
                    force: *force,
                }));
            }
        }
        let n = samples.iter().map(Vec::len).max().unwrap_or(0);
        let total = |k: usize| samples.iter().filter_map(|link| link.get(k)).sum::<f64>();
        let squeeze_sd = spread((0..n).map(total).collect()).1 * self.settings.inflation;
        hand.squeeze_sd = unseen.iter().fold(squeeze_sd, |sd, unseen| sd.hypot(unseen / Z95));
        for ((link, samples), unseen) in hand.links.iter_mut().zip(samples).zip(unseen) {
            if let Some(link) = link.as_mut().filter(|_| !samples.is_empty() || unseen > 0.0) {
                let found = summary(samples, self.settings.inflation, unseen);
                *link = LinkForce { undetermined: link.undetermined, ..found };
            }
        }
        if contacts.blocked[side as usize].iter().any(|blocked| *blocked) && hand.validity == ForceValidity::Valid {
            hand.validity = ForceValidity::NotFree;
        }
        for (joint, blocked) in contacts.blocked[side as usize].iter().enumerate() {
            if *blocked {
                hand.links[joint] = None;
            }
        }
        hand
    }

    /// Returns the reason why a body has no estimate; `None` where it touches nobody by being held.
    fn unknown(&self, body: &super::body::Body, index: usize, frame: usize) -> Option<ForceValidity> {
        if body.held.is_some() {
            return Some(ForceValidity::NotFree);
        }
        if body.solid.is_none() {
            return Some(ForceValidity::PoseGap);
        }
        if body.mass.is_none() {
            return Some(ForceValidity::MassUnknown);
        }
        match self.motions[index].as_ref().and_then(|motion| motion.faults[frame]) {
            Some(MotionFault::Gap) => Some(ForceValidity::PoseGap),
            Some(MotionFault::Jump) => Some(ForceValidity::PoseJump),
            None if self.take.gravity.is_none() => Some(ForceValidity::GravityUnknown),
            None => Some(ForceValidity::PoseGap),
        }
    }
}

impl HandEstimate {
    /// Makes all links unknown; the first reason stays.
    fn lose(&mut self, reason: ForceValidity) {
        if self.validity == ForceValidity::Valid {
            self.validity = reason;
        }
        self.links = [None; N_JOINTS];
    }
}

impl BodyEstimate {
    /// Returns the mean of two estimates of the same body and frame.
    fn mean(self, other: Self) -> Self {
        let links = self.links.into_iter().zip(other.links).map(|(mut link, twin)| {
            link.samples.iter_mut().zip(twin.samples).for_each(|(a, b)| *a = 0.5 * (*a + b));
            link.points.iter_mut().zip(twin.points).for_each(|(a, b)| a.2 = 0.5 * (a.2 + b.2));
            link
        });
        Self {
            links: links.collect(),
            residual: 0.5 * (self.residual + other.residual),
            hand_force: 0.5 * (self.hand_force + other.hand_force),
            unexplained: self.unexplained && other.unexplained,
            ..self
        }
    }
}

/// Returns mean and standard deviation.
fn spread(samples: Vec<f64>) -> (f64, f64) {
    let n = samples.len() as f64;
    if n < 2.0 {
        return (samples.first().copied().unwrap_or(0.0), 0.0);
    }
    let mean = samples.iter().sum::<f64>() / n;
    (mean, (samples.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt())
}

/// Summarises the samples of a link's force; `inflation` widens the interval that they span, and `unseen`, N, is the half width
/// of what the motion does not see.
fn summary(mut samples: Vec<f64>, inflation: f64, unseen: f64) -> LinkForce {
    if samples.is_empty() {
        samples.push(0.0);
    }
    samples.sort_by(f64::total_cmp);
    let quantile = |q: f64| crate::statistics::percentile(samples.iter().copied(), q);
    let (low, high) = (quantile(0.05), quantile(0.95));
    let (force, sd) = spread(samples.clone());
    // Few samples miss the ends of their distribution: the wider of quantiles and normal interval.
    let (below, above) = ((force - low).max(Z95 * sd), (high - force).max(Z95 * sd));
    let [below, above] = [below, above].map(|width| (inflation * width + LEAST_WIDTH).hypot(unseen));
    let sd = (inflation * sd + LEAST_WIDTH / Z95).hypot(unseen / Z95);
    LinkForce { force, sd, interval: [(force - below).max(0.0), force + above], undetermined: false }
}
