//! Scores of forces from motion against the simulator's.

use std::collections::BTreeMap;

use egotac::physics::{Estimate, Take};
use egotac::statistics::percentile;
use serde::Serialize;

use super::record::{Disturbance, Recorded};

/// Force below which a link does not count as touched, N.
const TOUCHED: f64 = 0.05;

/// Sums over episodes of one condition.
#[derive(Debug, Clone, Default)]
pub struct Sums {
    /// Errors of the net force on a body, N, and the true force, N.
    net: Vec<(f64, f64)>,
    /// Errors of the net moment on a body, N m.
    moments: Vec<f64>,
    /// Links that are touched or estimated to be: truth, estimate, distance to the interval's centre by its half width, and
    /// if the true contacts determine the force.
    links: Vec<Link>,
    /// Touched links, and those whose force is unknown, by reason.
    touched: usize,
    unknown: BTreeMap<&'static str, usize>,
    determined: usize,
    wrongly_flagged: usize,
    seconds: f64,
    frames: usize,
}

#[derive(Debug, Clone, Copy)]
struct Link {
    truth: f64,
    force: f64,
    inside: bool,
    /// Error over the half width on its side.
    ratio: f64,
    determined: bool,
    flagged: bool,
}

/// Scores of one condition.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Score {
    /// Condition.
    pub condition: Disturbance,
    /// Share of bodies' frames whose net force is within 2 % + 0.05 N of the simulator's contacts.
    pub net_within: f64,
    /// Median and 95th percentile of the error of the net force, N.
    pub net_error: [f64; 2],
    /// The same of the net moment, N m.
    pub moment_error: [f64; 2],
    /// Touched links whose force the true contacts determine.
    pub determined: usize,
    /// Median relative error of their normal force, and share within 10 % + 0.05 N.
    pub determined_error: [f64; 2],
    /// Mean absolute error of the normal force of all touched links, N, and their mean force, N.
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
    pub fn add(&mut self, recorded: &Recorded, take: &Take, frames: &[usize], estimate: &Estimate, seconds: f64) {
        self.seconds += seconds;
        self.frames += frames.len();
        for (index, frame) in frames.iter().enumerate() {
            let truth = &recorded.truth[*frame];
            // At the ends of an episode a spline has samples on one side only: no file can be judged by its first frames.
            let edge = index < 3 || index + 3 >= frames.len();
            if !truth.valid || edge {
                continue;
            }
            let found = &estimate.frames[index];
            for (body, wrench) in found.bodies.iter().zip(&truth.wrenches) {
                if let Some(body) = body {
                    let (force, moment) = (wrench.fixed_rows::<3>(0), wrench.fixed_rows::<3>(3));
                    self.net.push(((body.wrench.fixed_rows::<3>(0) - force).norm(), force.norm()));
                    self.moments.push((body.wrench.fixed_rows::<3>(3) - moment).norm());
                }
            }
            for (side, hand) in found.hands.iter().enumerate() {
                for (link, estimate) in hand.links.iter().enumerate() {
                    let (force, determined) = (truth.links[side][link], truth.determined[side][link]);
                    self.touched += usize::from(force > TOUCHED);
                    let Some(estimate) = estimate else {
                        if force > TOUCHED {
                            *self.unknown.entry(hand.validity.reason()).or_default() += 1;
                        }
                        continue;
                    };
                    if force <= TOUCHED && estimate.force <= TOUCHED {
                        continue;
                    }
                    if determined && force > TOUCHED {
                        self.determined += 1;
                        self.wrongly_flagged += usize::from(estimate.undetermined);
                    }
                    let [low, high] = estimate.interval;
                    let width = if force > estimate.force { high - estimate.force } else { estimate.force - low };
                    self.links.push(Link {
                        truth: force,
                        force: estimate.force,
                        inside: low <= force && force <= high,
                        // The lower end stops at 0, where no force is: nothing lies below it.
                        ratio: if low <= 0.0 && force < estimate.force {
                            0.0
                        } else {
                            (force - estimate.force).abs() / width.max(1e-9)
                        },
                        determined,
                        flagged: estimate.undetermined,
                    });
                }
            }
        }
        debug_assert_eq!(take.times.len(), frames.len());
    }

    /// Computes the scores.
    pub fn score(&self, condition: Disturbance) -> Score {
        let share = |count: usize, all: usize| if all == 0 { f64::NAN } else { count as f64 / all as f64 };
        let both = |values: Vec<f64>| match values.is_empty() {
            true => [f64::NAN; 2],
            false => [0.5, 0.95].map(|q| percentile(values.iter().copied(), q)),
        };
        let within = self.net.iter().filter(|(error, force)| *error <= 0.02 * force + 0.05).count();
        let touched: Vec<&Link> = self.links.iter().filter(|link| link.truth > TOUCHED).collect();
        let told: Vec<&&Link> = touched.iter().filter(|link| link.determined && !link.flagged).collect();
        let relative: Vec<f64> = told.iter().map(|link| (link.force - link.truth).abs() / link.truth).collect();
        let near = told.iter().filter(|link| (link.force - link.truth).abs() <= 0.1 * link.truth + 0.05).count();
        let coverage = |of: &dyn Fn(&Link) -> bool| {
            let links = self.links.iter().filter(|link| of(link));
            share(links.clone().filter(|link| link.inside).count(), links.count())
        };
        let mean = |value: &dyn Fn(&&Link) -> f64| touched.iter().map(value).sum::<f64>() / touched.len().max(1) as f64;
        Score {
            condition,
            net_within: share(within, self.net.len()),
            net_error: both(self.net.iter().map(|(error, _)| *error).collect()),
            moment_error: both(self.moments.clone()),
            determined: told.len(),
            determined_error: [both(relative)[0], share(near, told.len())],
            link_error: [mean(&|l| (l.force - l.truth).abs()), mean(&|l| l.truth)],
            coverage: [coverage(&|_| true), coverage(&|l| l.determined), coverage(&|l| !l.determined)],
            wanted_inflation: percentile(self.links.iter().map(|link| link.ratio), 0.9),
            wrongly_flagged: share(self.wrongly_flagged, self.determined),
            bias: mean(&|l| l.force - l.truth),
            unknown: self.unknown.iter().map(|(reason, links)| (*reason, share(*links, self.touched))).collect(),
            milliseconds: 1e3 * self.seconds / (2 * self.frames.max(1)) as f64,
        }
    }
}
