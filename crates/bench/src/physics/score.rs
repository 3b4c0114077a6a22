//! Scores of forces from motion against the simulator's.

use std::collections::BTreeMap;
use std::path::Path;

use egotac::error::Result;
use egotac::physics::frame::{BodyEstimate, LinkEstimate};
use egotac::physics::patch::Pusher;
use egotac::physics::{Estimate, FrameEstimate, PoseNoise, Take};
use egotac::statistics::percentile;
use glam::DVec3;
use nalgebra::Vector6;
use serde::Serialize;

use super::record::{Disturbance, Recorded};

/// Force below which a link does not count as touched, N.
const TOUCHED: f64 = 0.05;

/// Sums over episodes of one condition.
#[derive(Debug, Clone, Default)]
pub struct Sums {
    /// Bodies of all frames.
    pub nets: Vec<Net>,
    /// Links that are touched or estimated to be: truth, estimate, distance to the interval's centre by its half width, and
    /// if the true contacts determine the force.
    pub links: Vec<Link>,
    /// Touched links, and those whose force is unknown, by reason.
    touched: usize,
    unknown: BTreeMap<&'static str, usize>,
    determined: usize,
    wrongly_flagged: usize,
    seconds: f64,
    frames: usize,
}

/// Net force on one body at one frame.
#[derive(Debug, Clone, Serialize)]
pub struct Net {
    /// Scene and frame.
    pub scene: String,
    /// Index of the frame in its truth.
    pub frame: usize,
    /// Index of the body.
    pub body: usize,
    /// Size of the true net force, N.
    pub truth: f64,
    /// Error of the net force, N, and of the moment, N m.
    pub error: f64,
    /// Error of the net moment, N m.
    pub moment_error: f64,
    /// Difference between the true net force and what poses of this bandwidth show of it, N.
    pub hidden: f64,
    /// Difference between the estimate and what poses of this bandwidth show of the true net force, N.
    pub shown_error: f64,
    /// Standard deviation that the estimate states, N.
    pub sd: f64,
    /// Part that no contact explains, N.
    pub residual: f64,
    /// True if a hand, another body, a fixed thing touches the body.
    pub hand: bool,
    /// See `hand`.
    pub other: bool,
    /// See `hand`.
    pub fixed: bool,
}

/// Normal force on one link at one frame.
#[derive(Debug, Clone, Serialize)]
pub struct Link {
    /// Scene and frame.
    pub scene: String,
    /// Index of the frame in its truth.
    pub frame: usize,
    /// Hand, 0 = left, and link.
    pub side: usize,
    /// Link.
    pub link: usize,
    /// True force, N.
    pub truth: f64,
    /// Estimate, N.
    pub force: f64,
    /// Standard deviation that the estimate states, N.
    pub sd: f64,
    /// Ends of the stated 90 % interval, N.
    pub low: f64,
    /// See `low`.
    pub high: f64,
    /// True if the true contacts determine the force.
    pub determined: bool,
    /// True if the estimate is flagged as undetermined.
    pub flagged: bool,
    /// Share of the prior variance that the motion leaves, largest over the bodies that the link touches.
    pub remaining: f64,
    /// Weight and inertial force of these bodies, N.
    pub load: f64,
    /// Coefficient of friction.
    pub friction: f64,
    /// Standard deviation of gaps, m.
    pub gap_sd: f64,
    /// Number of links that touch the same bodies.
    pub links: usize,
}

impl Net {
    /// Returns the error that the goal admits, N.
    fn tolerance(&self) -> f64 {
        0.02 * self.truth + 0.05
    }

    fn is_within(&self) -> bool {
        self.error <= self.tolerance()
    }

    /// True if the force changes faster than poses of this bandwidth show.
    fn is_fast(&self) -> bool {
        self.hidden > self.tolerance()
    }
}

impl Link {
    fn inside(&self) -> bool {
        self.low <= self.truth && self.truth <= self.high
    }

    /// Returns the error over the half width of the interval on its side.
    fn ratio(&self) -> f64 {
        // The lower end stops at 0, where no force is: nothing lies below it.
        if self.low <= 0.0 && self.truth < self.force {
            return 0.0;
        }
        let width = if self.truth > self.force { self.high - self.force } else { self.force - self.low };
        (self.truth - self.force).abs() / width.max(1e-9)
    }
}

/// Scores of one condition.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Score {
    /// Condition.
    pub condition: Disturbance,
    /// Share of bodies' frames whose net force is within 2 % + 0.05 N of the simulator's contacts.
    pub net_within: f64,
    /// The same of bodies that a hand touches, against the net force as poses of this rate and bandwidth can show it.
    pub net_shown: f64,
    /// Share of touched bodies' frames within the same tolerance of the instant's force; share in which the true force changes
    /// faster than such poses show, so that what they show is itself off by more; and the share that misses for another reason.
    pub net_touched: [f64; 3],
    /// Median and 95th percentile of the error of the net force, N.
    pub net_error: [f64; 2],
    /// The same of the net moment, N m.
    pub moment_error: [f64; 2],
    /// Touched links whose force the true contacts determine.
    pub determined: usize,
    /// Median relative error of their normal force, and share within 10 % + 0.05 N.
    pub determined_error: [f64; 2],
    /// Mean absolute error of the normal force of all touched links, N, and their mean force, N; NaN without such links.
    pub link_error: [f64; 2],
    /// Share of true forces inside the 90 % interval: all touched links, those that are determined, and the others.
    pub coverage: [f64; 3],
    /// Factor on the intervals that would give 90 %.
    pub wanted_inflation: f64,
    /// Share of determined links that are flagged as undetermined.
    pub wrongly_flagged: f64,
    /// Mean of estimate less truth over all touched links, N.
    pub bias: f64,
    /// Share of touched links whose force is unknown, by reason.
    pub unknown: BTreeMap<&'static str, f64>,
    /// Time per frame and hand, ms.
    pub milliseconds: f64,
}

impl Sums {
    /// Adds an episode; `frames`: index of each frame in its truth.
    pub fn add(&mut self, recorded: &Recorded, take: &Take, frames: &[usize], estimate_of: &Estimate, seconds: f64) {
        self.seconds += seconds;
        self.frames += frames.len();
        let bandwidth = estimate_of.bandwidth.iter().enumerate();
        let shown: Vec<Option<Vec<DVec3>>> =
            bandwidth.map(|(body, bandwidth)| recorded.shown(body, frames, (*bandwidth)?)).collect();
        for (index, frame) in frames.iter().enumerate() {
            // At the ends of an episode a spline has samples on one side only: no file can be judged by its first frames.
            let edge = index < 3 || index + 3 >= frames.len();
            if edge || !recorded.truth[*frame].valid {
                continue;
            }
            let found = &estimate_of.frames[index];
            for body in 0..found.bodies.len() {
                self.add_net(recorded, *frame, body, found, shown[body].as_ref().map(|shown| shown[index]));
            }
            for side in 0..2 {
                for link in 0..found.hands[side].links.len() {
                    self.add_link(recorded, *frame, (side, link), found, take, estimate_of.hand_noise[side]);
                }
            }
        }
        debug_assert_eq!(take.times.len(), frames.len());
    }

    /// Adds the net force on `body`; `shown`: the force that its recorded poses show, N.
    fn add_net(&mut self, recorded: &Recorded, frame: usize, body: usize, found: &FrameEstimate, shown: Option<DVec3>) {
        let truth = &recorded.truth[frame];
        let (Some(estimate), wrench, touches) = (&found.bodies[body], &truth.wrenches[body], truth.touches[body])
        else {
            return;
        };
        let part = |of: &Vector6<f64>, row: usize| DVec3::new(of[row], of[row + 1], of[row + 2]);
        let [force, true_force] = [part(&estimate.wrench, 0), part(wrench, 0)];
        self.nets.push(Net {
            scene: recorded.scene.clone(),
            frame,
            body,
            truth: true_force.length(),
            error: force.distance(true_force),
            moment_error: part(&estimate.wrench, 3).distance(part(wrench, 3)),
            hidden: shown.map_or(f64::NAN, |shown| shown.distance(true_force)),
            shown_error: shown.map_or(f64::NAN, |shown| shown.distance(force)),
            sd: part(&estimate.wrench_sd, 0).length(),
            residual: part(&estimate.residual, 0).length(),
            hand: touches.hand,
            other: touches.body,
            fixed: touches.fixed,
        });
    }

    /// Adds the force on one link of one hand.
    fn add_link(
        &mut self,
        recorded: &Recorded,
        frame: usize,
        (side, link): (usize, usize),
        found: &FrameEstimate,
        take: &Take,
        noise: PoseNoise,
    ) {
        let (hand, truth) = (&found.hands[side], &recorded.truth[frame]);
        let (force, determined) = (truth.links[side][link], truth.determined[side][link]);
        self.touched += usize::from(force > TOUCHED);
        let Some(estimate) = &hand.links[link] else {
            if force > TOUCHED {
                *self.unknown.entry(hand.validity.reason()).or_default() += 1;
            }
            return;
        };
        if force <= TOUCHED && estimate.force <= TOUCHED {
            return;
        }
        if determined && force > TOUCHED {
            self.determined += 1;
            self.wrongly_flagged += usize::from(estimate.undetermined);
        }
        let [low, high] = estimate.interval;
        let of_link = |l: &&LinkEstimate| matches!(l.pusher, Pusher::Link(s, j) if s as usize == side && j == link);
        let touching: Vec<(usize, &BodyEstimate, f64)> = found
            .bodies
            .iter()
            .enumerate()
            .filter_map(|(index, body)| {
                let body = body.as_ref()?;
                Some((index, body, body.links.iter().find(of_link)?.remaining))
            })
            .collect();
        self.links.push(Link {
            scene: recorded.scene.clone(),
            frame,
            side,
            link,
            truth: force,
            force: estimate.force,
            sd: estimate.sd,
            low,
            high,
            determined,
            flagged: estimate.undetermined,
            remaining: touching.iter().map(|(.., remaining)| *remaining).fold(0.0, f64::max),
            load: touching.iter().map(|(_, body, _)| body.load).sum(),
            friction: touching.first().map_or(f64::NAN, |(index, ..)| take.bodies[*index].friction),
            gap_sd: noise.position.hypot(0.12 * noise.rotation),
            links: touching.iter().map(|(_, body, _)| body.links.len()).sum(),
        });
    }

    /// Adds the episodes of other sums.
    pub fn append(&mut self, other: &Self) {
        self.nets.extend(other.nets.iter().cloned());
        self.links.extend(other.links.iter().cloned());
        self.touched += other.touched;
        for (reason, links) in &other.unknown {
            *self.unknown.entry(reason).or_default() += links;
        }
        self.determined += other.determined;
        self.wrongly_flagged += other.wrongly_flagged;
        self.seconds += other.seconds;
        self.frames += other.frames;
    }

    /// Writes the bodies and the links behind the scores as CSV files of this name.
    ///
    /// # Errors
    /// If a file can't be written.
    pub fn write(&self, folder: &Path, name: &str) -> Result<()> {
        table(&folder.join(format!("bodies_{name}.csv")), &self.nets)?;
        table(&folder.join(format!("links_{name}.csv")), &self.links)
    }

    /// Computes the scores.
    pub fn score(&self, condition: Disturbance) -> Score {
        let share = |count: usize, all: usize| if all == 0 { f64::NAN } else { count as f64 / all as f64 };
        let both = |values: Vec<f64>| match values.is_empty() {
            true => [f64::NAN; 2],
            false => [0.5, 0.95].map(|q| percentile(values.iter().copied(), q)),
        };
        let within = self.nets.iter().filter(|net| net.is_within()).count();
        let held: Vec<&Net> = self.nets.iter().filter(|net| net.hand).collect();
        let touched: Vec<&Link> = self.links.iter().filter(|link| link.truth > TOUCHED).collect();
        let told: Vec<&&Link> = touched.iter().filter(|link| link.determined && !link.flagged).collect();
        let relative: Vec<f64> = told.iter().map(|link| (link.force - link.truth).abs() / link.truth).collect();
        let near = told.iter().filter(|link| (link.force - link.truth).abs() <= 0.1 * link.truth + 0.05).count();
        let coverage = |of: &dyn Fn(&Link) -> bool| {
            let links = self.links.iter().filter(|link| of(link));
            share(links.clone().filter(|link| link.inside()).count(), links.count())
        };
        let mean = |value: &dyn Fn(&&Link) -> f64| touched.iter().map(value).sum::<f64>() / touched.len() as f64;
        Score {
            condition,
            net_within: share(within, self.nets.len()),
            net_shown: share(held.iter().filter(|net| net.shown_error <= net.tolerance()).count(), held.len()),
            net_touched: [
                share(held.iter().filter(|net| net.is_within()).count(), held.len()),
                share(held.iter().filter(|net| !net.is_within() && net.is_fast()).count(), held.len()),
                share(held.iter().filter(|net| !net.is_within() && !net.is_fast()).count(), held.len()),
            ],
            net_error: both(self.nets.iter().map(|net| net.error).collect()),
            moment_error: both(self.nets.iter().map(|net| net.moment_error).collect()),
            determined: told.len(),
            determined_error: [both(relative)[0], share(near, told.len())],
            link_error: [mean(&|l| (l.force - l.truth).abs()), mean(&|l| l.truth)],
            coverage: [coverage(&|_| true), coverage(&|l| l.determined), coverage(&|l| !l.determined)],
            wanted_inflation: percentile(self.links.iter().map(|link| link.ratio()), 0.9),
            wrongly_flagged: share(self.wrongly_flagged, self.determined),
            bias: mean(&|l| l.force - l.truth),
            unknown: self.unknown.iter().map(|(reason, links)| (*reason, share(*links, self.touched))).collect(),
            milliseconds: 1e3 * self.seconds / (2 * self.frames.max(1)) as f64,
        }
    }
}

fn table<T: Serialize>(path: &Path, rows: &[T]) -> Result<()> {
    let mut text = String::new();
    for row in rows {
        let Ok(serde_json::Value::Object(row)) = serde_json::to_value(row) else { continue };
        if text.is_empty() {
            text = row.keys().cloned().collect::<Vec<_>>().join(",") + "\n";
        }
        let cell = |value: &serde_json::Value| value.as_str().map_or_else(|| value.to_string(), str::to_string);
        text += &(row.values().map(cell).collect::<Vec<_>>().join(",") + "\n");
    }
    egotac::file::write(path, text.as_bytes())
}
