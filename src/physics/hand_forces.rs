//! Forces on one hand at one frame, summed over the bodies that it touches.

use glam::DVec3;

use super::body::RigidBody;
use super::contacts::Contact;
use super::frame::{BodyEstimate, LinkEstimate};
use super::patch::Pusher;
use super::settings::Settings;
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
pub struct HandForces {
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

/// Sum of the forces on one hand.
pub(super) struct HandSum {
    side: Side,
    /// The hand's estimate without the forces of its links, which [`Self::finish`] adds.
    pub hand: HandForces,
    /// Samples of each link's force, N; empty = no body pushes it.
    samples: [Vec<f64>; N_JOINTS],
    /// Half width of what the motion does not see of each link, N.
    unseen: [f64; N_JOINTS],
}

impl HandSum {
    /// Creates the sum of a hand that touches nothing and was moved by `moved`, m.
    pub fn new(side: Side, moved: f64) -> Self {
        let hand = HandForces {
            validity: ForceValidity::Valid,
            links: [Some(LinkForce::ZERO); N_JOINTS],
            points: Vec::new(),
            undetermined: false,
            squeeze_sd: 0.0,
            moved,
        };
        Self { side, hand, samples: [const { Vec::new() }; N_JOINTS], unseen: [0.0; N_JOINTS] }
    }

    /// Adds a body without an estimate, for `reason`; `near`: its contacts.
    pub fn add_unknown(&mut self, near: &[Contact], reason: Option<ForceValidity>) {
        self.check_depth(near);
        let touches = self.touching(near).next().is_some();
        // Without a pose, nobody knows what is touched.
        let matters =
            |reason: &ForceValidity| touches || matches!(reason, ForceValidity::PoseGap | ForceValidity::PoseJump);
        if let Some(reason) = reason.filter(matters) {
            self.hand.lose(reason);
        }
    }

    /// Adds the forces of `body` on the hand; `near`: its contacts.
    pub fn add(&mut self, body: &RigidBody, near: &[Contact], estimate: &BodyEstimate, settings: &Settings) {
        self.check_depth(near);
        // A body at rest that no hand is near stands on something unrecorded: it says nothing about this hand.
        let concerns = estimate.moves || near.iter().any(|contact| self.joint(contact.patch.pusher).is_some());
        if estimate.unexplained && concerns {
            self.hand.lose(ForceValidity::Unexplained);
        }
        let hold = estimate.load / (2.0 * body.friction);
        let [force, grip] = settings.unseen;
        for contact in near {
            let Some(joint) = self.joint(contact.patch.pusher) else { continue };
            // The motion says nothing of a link that is near, but hardly touches.
            let link = estimate.links.iter().find(|link| link.pusher == contact.patch.pusher);
            let remaining = link.map_or(1.0, |link| link.remaining);
            self.unseen[joint] = self.unseen[joint].hypot(remaining.sqrt() * (force + grip * hold));
            if link.is_none() {
                let points = contact.patch.points.iter();
                let place =
                    |&(position, normal): &(DVec3, DVec3)| PointForce { link: joint, position, normal, force: 0.0 };
                self.hand.points.extend(points.map(place));
            }
        }
        for link in &estimate.links {
            let Some(joint) = self.joint(link.pusher) else { continue };
            let probable = self.touching(near).any(|contact| contact.patch.pusher == link.pusher);
            self.add_link(joint, link, probable);
        }
    }

    /// Adds the force on the link `joint`; `probable`: it probably touches.
    fn add_link(&mut self, joint: usize, link: &LinkEstimate, probable: bool) {
        let sum = &mut self.samples[joint];
        sum.resize(link.samples.len(), 0.0);
        sum.iter_mut().zip(&link.samples).for_each(|(sum, force)| *sum += force);
        if let Some(force) = &mut self.hand.links[joint] {
            force.undetermined |= probable && link.remaining > UNDETERMINED;
            self.hand.undetermined |= force.undetermined;
        }
        let point =
            |&(position, normal, force): &(DVec3, DVec3, f64)| PointForce { link: joint, position, normal, force };
        self.hand.points.extend(link.points.iter().map(point));
    }

    /// Returns the hand's estimate; links that are `blocked` touch a body that is not free, and are unknown. `inflation`: as
    /// in [`Settings::inflation`].
    pub fn finish(self, blocked: &[bool; N_JOINTS], inflation: f64) -> HandForces {
        let Self { mut hand, samples, unseen, .. } = self;
        let n = samples.iter().map(Vec::len).max().unwrap_or(0);
        let total = |k: usize| samples.iter().filter_map(|link| link.get(k)).sum::<f64>();
        let squeeze_sd = spread((0..n).map(total).collect()).1 * inflation;
        hand.squeeze_sd = unseen.iter().fold(squeeze_sd, |sd, unseen| sd.hypot(unseen / Z95));
        for ((link, samples), unseen) in hand.links.iter_mut().zip(samples).zip(unseen) {
            if let Some(link) = link.as_mut().filter(|_| !samples.is_empty() || unseen > 0.0) {
                let found = summary(samples, inflation, unseen);
                *link = LinkForce { undetermined: link.undetermined, ..found };
            }
        }
        if blocked.contains(&true) && hand.validity == ForceValidity::Valid {
            hand.validity = ForceValidity::NotFree;
        }
        for (link, _) in hand.links.iter_mut().zip(blocked).filter(|(_, blocked)| **blocked) {
            *link = None;
        }
        hand
    }

    /// Makes the hand unknown if it lies too deep in a body.
    fn check_depth(&mut self, near: &[Contact]) {
        if self.touching(near).any(|contact| contact.deep) {
            self.hand.lose(ForceValidity::Deep);
        }
    }

    /// Returns the contacts in which this hand probably touches.
    fn touching<'a>(&self, near: &'a [Contact]) -> impl Iterator<Item = &'a Contact> + use<'a> {
        let side = self.side;
        let of_side = move |pusher| matches!(pusher, Pusher::Link(of, _) if of == side);
        near.iter().filter(move |contact| of_side(contact.patch.pusher) && contact.probability > TOUCHES)
    }

    /// Returns the link if `pusher` is one of this hand.
    fn joint(&self, pusher: Pusher) -> Option<usize> {
        match pusher {
            Pusher::Link(side, joint) if side == self.side => Some(joint),
            _ => None,
        }
    }
}

impl HandForces {
    /// Makes all links unknown; the first reason stays.
    pub(super) fn lose(&mut self, reason: ForceValidity) {
        if self.validity == ForceValidity::Valid {
            self.validity = reason;
        }
        self.links = [None; N_JOINTS];
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
