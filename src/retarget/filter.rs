//! Smoothing of keypoints in seconds, whatever the frame rate, and the gate that keeps outliers out.
//!
//! The smoother is six equal low-pass stages and a lead that takes most of their delay back: slow motion comes out
//! `delay` seconds late, and what is faster than a hand moves hardly comes out at all.

use glam::DVec3;

use super::human::{keypoint, size};
use crate::hand::N_KEYPOINTS;

/// Low-pass stages.
const STAGES: usize = 6;
/// Delay of one stage over that of the whole.
const STAGE_SHARE: f64 = 0.58;
/// How long a keypoint may be taken for an outlier, s; afterwards the hand is really there.
const PATIENCE: f64 = 0.1;
/// Frames after which a keypoint that stays is believed, however slowly frames come.
const PATIENT_FRAMES: usize = 2;
/// How fast a keypoint moves against the wrist, m/s: what it may be off its expected place per second on top.
const FAST: f64 = 1.5;
/// How far a bone's length may be off its usual one, beside the outlier distance.
const STRETCH: f64 = 0.3;

/// Smooths points with a delay.
#[derive(Debug, Clone)]
pub struct Smoother<const N: usize = N_KEYPOINTS> {
    delay: f64,
    stages: [[DVec3; N]; STAGES],
    is_empty: bool,
}

impl<const N: usize> Smoother<N> {
    /// With a delay of `delay` seconds; 0 leaves points as they are.
    pub fn new(delay: f64) -> Self {
        Self { delay, stages: [[DVec3::ZERO; N]; STAGES], is_empty: true }
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        self.is_empty = true;
    }

    /// Takes points that came `dt` seconds after the last ones and returns the smoothed ones.
    pub fn push(&mut self, points: &[DVec3; N], dt: f64) -> [DVec3; N] {
        if self.delay <= 0.0 || !dt.is_finite() {
            return *points;
        }
        if std::mem::take(&mut self.is_empty) {
            self.stages = [*points; STAGES];
            return *points;
        }
        let stage_delay = STAGE_SHARE * self.delay;
        let lead = STAGES as f64 * stage_delay - self.delay;
        let gain = dt / (dt + stage_delay);
        std::array::from_fn(|k| {
            let mut input = points[k];
            let mut rate = DVec3::ZERO;
            for stage in &mut self.stages {
                stage[k] += gain * (input - stage[k]);
                rate = (input - stage[k]) / stage_delay;
                input = stage[k];
            }
            input + lead * rate
        })
    }
}

/// Replaces keypoints that cannot be where they seem.
#[derive(Debug, Clone)]
pub struct Gate {
    /// Distance from the expected place, m; 0 = everything passes.
    distance: f64,
    /// The last points let through, and their velocities, m/s.
    last: [DVec3; N_KEYPOINTS],
    velocity: [DVec3; N_KEYPOINTS],
    /// For how long, s and frames, each keypoint has been kept out.
    out: [(f64, usize); N_KEYPOINTS],
    /// Usual length of the bone that ends at each keypoint, m.
    bones: [f64; N_KEYPOINTS],
    seen: usize,
}

/// What the gate thinks of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(clippy::large_enum_variant)] // one at a time, on the stack
pub enum Passed {
    /// The points, with so many replaced by what was expected.
    Points([DVec3; N_KEYPOINTS], usize),
    /// It is the mirror image of what was expected.
    Mirrored,
}

impl Gate {
    /// With a distance in metres from which on a keypoint is an outlier; 0 lets everything pass.
    pub fn new(distance: f64) -> Self {
        Self {
            distance,
            last: [DVec3::ZERO; N_KEYPOINTS],
            velocity: [DVec3::ZERO; N_KEYPOINTS],
            out: [(0.0, 0); N_KEYPOINTS],
            bones: [0.0; N_KEYPOINTS],
            seen: 0,
        }
    }

    /// Forgets where the hand was, not how long its bones are.
    pub fn forget(&mut self) {
        self.out = [(f64::INFINITY, usize::MAX); N_KEYPOINTS];
        self.velocity = [DVec3::ZERO; N_KEYPOINTS];
    }

    /// Looks at points in the wrist frame, `dt` seconds after the last ones.
    pub fn push(&mut self, points: &[DVec3; N_KEYPOINTS], dt: f64) -> Passed {
        let fresh = self.seen == 0 || self.out[1].1 == usize::MAX;
        if self.distance <= 0.0 || fresh {
            let velocity = [DVec3::ZERO; N_KEYPOINTS];
            if fresh {
                self.out = [(0.0, 0); N_KEYPOINTS];
            }
            return self.accept(*points, velocity, 0);
        }
        let dt = dt.clamp(1e-4, 1.0);
        // Motion is believed for a short while only.
        let ahead = dt.min(0.05);
        let expected: [DVec3; N_KEYPOINTS] = std::array::from_fn(|k| self.last[k] + ahead * self.velocity[k]);
        let off = |points: &[DVec3; N_KEYPOINTS]| {
            points.iter().zip(&expected).map(|(a, b)| a.distance_squared(*b)).sum::<f64>()
        };
        let mirrored = points.map(|point| DVec3::new(-point.x, point.y, point.z));
        let room = N_KEYPOINTS as f64 * (0.5 * self.distance).powi(2);
        if off(points) > room && off(&mirrored) < 0.25 * off(points) && self.out[0].1 < PATIENT_FRAMES {
            self.out[0] = (self.out[0].0 + dt, self.out[0].1 + 1);
            return Passed::Mirrored;
        }
        self.out[0] = (0.0, 0);
        let mut passed = *points;
        let mut replaced = 0;
        for k in 1..N_KEYPOINTS {
            let is_far = points[k].distance(expected[k]) > self.distance + FAST * dt;
            let is_tip = (k - 1) % 4 == 3;
            let usual = self.bones[k];
            let stretch = (bone(points, k) - usual).abs() > STRETCH * usual + 0.25 * self.distance;
            let next = !is_tip
                && (bone(points, k + 1) - self.bones[k + 1]).abs() > STRETCH * self.bones[k + 1] + 0.25 * self.distance;
            // A joint out of place stretches the bones on both its sides; a tip has one.
            let is_torn = stretch && (is_tip || next) && points[k].distance(expected[k]) > 0.5 * self.distance;
            let (secs, frames) = self.out[k];
            let is_believed = secs >= PATIENCE || (secs > 0.0 && frames >= PATIENT_FRAMES);
            if (is_far || is_torn) && !is_believed {
                self.out[k] = (secs + dt, frames + 1);
                passed[k] = self.last[k] + ahead * self.velocity[k] * 0.5;
                replaced += 1;
            } else {
                self.out[k] = (0.0, 0);
            }
        }
        let velocity = std::array::from_fn(|k| {
            let velocity = (passed[k] - self.last[k]) / dt;
            // Half of it: keypoints jitter.
            0.5 * (self.velocity[k] + velocity).clamp_length_max(2.0 * FAST)
        });
        self.accept(passed, velocity, replaced)
    }

    fn accept(&mut self, points: [DVec3; N_KEYPOINTS], velocity: [DVec3; N_KEYPOINTS], replaced: usize) -> Passed {
        if replaced == 0 {
            // The mean of the first frames, then ever slower.
            let share = 1.0 / (1.0 + self.seen.min(300) as f64);
            for k in 1..N_KEYPOINTS {
                self.bones[k] += share * (bone(&points, k) - self.bones[k]);
            }
            self.seen += 1;
        }
        (self.last, self.velocity) = (points, velocity);
        Passed::Points(points, replaced)
    }
}

/// Length of the bone that ends at a keypoint, m.
fn bone(points: &[DVec3; N_KEYPOINTS], k: usize) -> f64 {
    let from = if (k - 1).is_multiple_of(4) { 0 } else { k - 1 };
    points[k].distance(points[from])
}

/// Follows the size of the hand: the mean of all frames at first, of the last few hundred later.
#[derive(Debug, Clone, Default)]
pub struct SizeEstimate {
    size: f64,
    finger_lengths: [f64; 5],
    frames: f64,
}

impl SizeEstimate {
    /// Takes points in the wrist frame.
    pub fn push(&mut self, points: &[DVec3; N_KEYPOINTS]) {
        let now = size(points);
        // Another person, not another pose.
        if self.frames > 0.0 && !(0.8..=1.25).contains(&(now / self.size)) {
            self.frames = 0.0;
        }
        self.frames = (self.frames + 1.0).min(300.0);
        self.size += (now - self.size) / self.frames;
        for finger in 0..5 {
            let joint = |joint| points[keypoint(finger, joint)];
            let length = (0..3).map(|j| joint(j).distance(joint(j + 1))).sum::<f64>();
            self.finger_lengths[finger] += (length - self.finger_lengths[finger]) / self.frames;
        }
    }

    /// Sum of all bones, m.
    pub fn size(&self) -> f64 {
        self.size
    }

    /// Length of each finger from base to tip, m.
    pub fn finger_lengths(&self) -> [f64; 5] {
        self.finger_lengths
    }
}
