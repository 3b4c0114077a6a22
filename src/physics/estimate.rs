//! Forces on both hands over a take: the whole episode at once, or with a fixed lag.

use super::contacts::{ContactFinder, FrameContacts};
use super::demand::Demand;
use super::frame::{BodyEstimate, Memory, estimate};
use super::hand_forces::{HandForces, HandSum};
use super::motion::{Motion, MotionFault};
use super::pose::{Pose, PoseNoise};
use super::settings::Settings;
use super::take::{Take, Tracked};
use super::validity::ForceValidity;
use crate::hand::Side;

/// Forces at one frame.
#[derive(Debug, Clone)]
pub struct FrameEstimate {
    /// Left and right hand.
    pub hands: [HandForces; 2],
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
    contacts.iter_mut().for_each(|contacts| ContactFinder::join(take, contacts));
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
    ContactFinder::join(take, &mut contacts[lagged]);
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
        let motion = |(body, poses): (&super::body::RigidBody, &Vec<Option<Pose>>)| {
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
        let demand =
            Demand::joined(&self.take.parts(body).map(|part| self.demand(part, frame)).collect::<Option<Vec<_>>>()?)?;
        let memory = memory.map(|(memory, time)| (memory, (self.take.times[frame] - time).abs()));
        let contacts = contacts.bodies.get(body)?;
        Some(estimate(&self.take.bodies[body], &demand, contacts, memory, self.settings))
    }

    /// Returns the wrench that the motion of a part asks for; `None` = unknown.
    fn demand(&self, part: usize, frame: usize) -> Option<Demand> {
        let motion = self.motions[part].as_ref()?;
        let state = motion.frames[frame].filter(|_| motion.faults[frame].is_none())?;
        Some(Demand::of(self.take.bodies[part].mass.as_ref()?, &state, self.take.gravity?))
    }

    /// Collects the forces on both hands from those on the bodies.
    fn hands(&self, frame: usize, contacts: &FrameContacts, bodies: Vec<Option<BodyEstimate>>) -> FrameEstimate {
        let hands = Side::BOTH.map(|side| self.hand(side, frame, contacts, &bodies));
        FrameEstimate { hands, bodies }
    }

    fn hand(&self, side: Side, frame: usize, contacts: &FrameContacts, bodies: &[Option<BodyEstimate>]) -> HandForces {
        let mut sum = HandSum::new(side, contacts.moved[side as usize]);
        match &self.take.hands[side as usize][frame] {
            Tracked::Absent => return sum.hand,
            Tracked::Unknown => {
                sum.hand.lose(ForceValidity::HandUnknown);
                return sum.hand;
            }
            Tracked::Present(_) => {}
        }
        let first_parts = self.take.bodies.iter().enumerate().filter(|(index, _)| self.take.root(*index) == *index);
        for (index, body) in first_parts {
            let near = contacts.bodies.get(index).map(Vec::as_slice).unwrap_or_default();
            match &bodies[index] {
                Some(estimate) => sum.add(body, near, estimate, self.settings),
                None => sum.add_unknown(near, self.take.parts(index).find_map(|part| self.unknown(part, frame))),
            }
        }
        sum.finish(&contacts.blocked[side as usize], self.settings.inflation)
    }

    /// Returns the reason why the motion of a part is unknown; `None` if it is known.
    fn unknown(&self, part: usize, frame: usize) -> Option<ForceValidity> {
        let body = &self.take.bodies[part];
        if body.held.is_some() {
            return Some(ForceValidity::NotFree);
        }
        if body.solid.is_none() {
            return Some(ForceValidity::PoseGap);
        }
        if body.mass.is_none() {
            return Some(ForceValidity::MassUnknown);
        }
        let motion = self.motions[part].as_ref();
        match motion.and_then(|motion| motion.faults[frame]) {
            Some(MotionFault::Gap) => Some(ForceValidity::PoseGap),
            Some(MotionFault::Jump) => Some(ForceValidity::PoseJump),
            None if self.take.gravity.is_none() => Some(ForceValidity::GravityUnknown),
            None if motion.is_none_or(|motion| motion.frames[frame].is_none()) => Some(ForceValidity::PoseGap),
            None => None,
        }
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
