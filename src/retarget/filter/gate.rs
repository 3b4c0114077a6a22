//! Gate that replaces outlying keypoints.

use glam::DVec3;

use crate::hand::N_KEYPOINTS;

/// Time after which an outlying keypoint is accepted, s: a tracker's errors are shorter, so the hand really is there.
const MAX_REJECTION_SECS: f64 = 0.1;
/// Frames after which an outlying keypoint is accepted, however slowly frames come.
const MAX_REJECTED_FRAMES: usize = 2;
/// Speed of a keypoint relative to the wrist, m/s, that the gate allows for beside the outlier distance.
const MAX_SPEED: f64 = 1.5;
/// Deviation of a bone from its usual length, relative to that, that counts as torn beside the outlier distance.
const MAX_STRETCH: f64 = 0.3;
/// Greatest time for which motion is extrapolated, s: beyond it, a jittery velocity predicts worse than none.
const MAX_EXTRAPOLATION_SECS: f64 = 0.05;
/// Frames that the mean length of a bone covers; after them, it changes ever slower.
const MEAN_FRAMES: usize = 300;

/// Replaces keypoints that jump further than a hand moves or tear a bone apart.
#[derive(Debug, Clone)]
pub struct OutlierGate {
    /// Distance from the expected position at which a keypoint is an outlier, m; 0 = everything passes.
    distance: f64,
    /// Keypoints of the last frame, outliers replaced, m.
    last: [DVec3; N_KEYPOINTS],
    /// Their velocities, m/s.
    velocity: [DVec3; N_KEYPOINTS],
    /// Time (s) and frames for which each keypoint has been rejected. That of the wrist, which is never an outlier, counts
    /// mirrored frames.
    rejected: [(f64, usize); N_KEYPOINTS],
    /// Mean length of the bone that ends at each keypoint, m.
    bones: [f64; N_KEYPOINTS],
    /// Frames without outliers so far.
    frames: usize,
    /// True if the next frame is accepted as it is.
    is_fresh: bool,
}

/// Result of the gate.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(clippy::large_enum_variant)] // One value at a time, on the stack.
pub enum GateResult {
    /// Keypoints, and how many of them were replaced by their expected positions.
    Points([DVec3; N_KEYPOINTS], usize),
    /// The hand is the mirror image of the one expected.
    Mirrored,
}

impl OutlierGate {
    /// Creates a gate with a distance from the expected position, m, at which a keypoint is an outlier; 0 = never.
    pub fn new(distance: f64) -> Self {
        Self {
            distance,
            last: [DVec3::ZERO; N_KEYPOINTS],
            velocity: [DVec3::ZERO; N_KEYPOINTS],
            rejected: [(0.0, 0); N_KEYPOINTS],
            bones: [0.0; N_KEYPOINTS],
            frames: 0,
            is_fresh: true,
        }
    }

    /// Forgets where the hand was, but not how long its bones are.
    pub fn forget(&mut self) {
        self.is_fresh = true;
    }

    /// Checks (21) keypoints in the wrist frame, m, `dt` seconds after the last ones.
    pub fn push(&mut self, points: &[DVec3; N_KEYPOINTS], dt: f64) -> GateResult {
        if self.distance <= 0.0 || self.is_fresh {
            if std::mem::take(&mut self.is_fresh) {
                self.rejected = [(0.0, 0); N_KEYPOINTS];
            }
            return self.accept(*points, [DVec3::ZERO; N_KEYPOINTS], 0);
        }
        let dt = dt.clamp(1e-4, 1.0);
        let ahead = dt.min(MAX_EXTRAPOLATION_SECS);
        let expected: [DVec3; N_KEYPOINTS] = std::array::from_fn(|k| self.last[k] + ahead * self.velocity[k]);
        if self.is_mirrored(points, &expected) && self.rejected[0].1 < MAX_REJECTED_FRAMES {
            self.rejected[0] = (self.rejected[0].0 + dt, self.rejected[0].1 + 1);
            return GateResult::Mirrored;
        }
        self.rejected[0] = (0.0, 0);
        let mut passed = *points;
        let mut replaced = 0;
        for k in 1..N_KEYPOINTS {
            let (secs, frames) = self.rejected[k];
            let is_persistent = secs >= MAX_REJECTION_SECS || (secs > 0.0 && frames >= MAX_REJECTED_FRAMES);
            if self.is_outlier(points, expected[k], k, dt) && !is_persistent {
                self.rejected[k] = (secs + dt, frames + 1);
                // Extrapolate by half: in doubt, the keypoint stays near its last position.
                passed[k] = self.last[k] + ahead * self.velocity[k] * 0.5;
                replaced += 1;
            } else {
                self.rejected[k] = (0.0, 0);
            }
        }
        let velocity = std::array::from_fn(|k| {
            let velocity = (passed[k] - self.last[k]) / dt;
            // The mean of the last two velocities, because keypoints jitter.
            0.5 * (self.velocity[k] + velocity).clamp_length_max(2.0 * MAX_SPEED)
        });
        self.accept(passed, velocity, replaced)
    }

    /// True if the hand is far from the expected one, and its mirror image is near.
    fn is_mirrored(&self, points: &[DVec3; N_KEYPOINTS], expected: &[DVec3; N_KEYPOINTS]) -> bool {
        let deviation = |points: &[DVec3; N_KEYPOINTS]| {
            points.iter().zip(expected).map(|(a, b)| a.distance_squared(*b)).sum::<f64>()
        };
        let mirrored = points.map(|point| DVec3::new(-point.x, point.y, point.z));
        let allowed = N_KEYPOINTS as f64 * (0.5 * self.distance).powi(2);
        deviation(points) > allowed && deviation(&mirrored) < 0.25 * deviation(points)
    }

    /// True if keypoint `k` is too far from its expected position, or tears the bones at it apart.
    fn is_outlier(&self, points: &[DVec3; N_KEYPOINTS], expected: DVec3, k: usize, dt: f64) -> bool {
        let deviation = points[k].distance(expected);
        let is_torn = |k: usize| {
            let usual = self.bones[k];
            (bone(points, k) - usual).abs() > MAX_STRETCH * usual + 0.25 * self.distance
        };
        let is_tip = (k - 1) % 4 == 3;
        // A joint out of place tears the bones on both of its sides; a tip has one bone.
        let tears_bones = is_torn(k) && (is_tip || is_torn(k + 1));
        deviation > self.distance + MAX_SPEED * dt || (tears_bones && deviation > 0.5 * self.distance)
    }

    /// Keeps a frame as the last one.
    fn accept(&mut self, points: [DVec3; N_KEYPOINTS], velocity: [DVec3; N_KEYPOINTS], replaced: usize) -> GateResult {
        if replaced == 0 {
            let share = 1.0 / (1.0 + self.frames.min(MEAN_FRAMES) as f64);
            for k in 1..N_KEYPOINTS {
                self.bones[k] += share * (bone(&points, k) - self.bones[k]);
            }
            self.frames += 1;
        }
        (self.last, self.velocity) = (points, velocity);
        GateResult::Points(points, replaced)
    }
}

/// Length of the bone that ends at a keypoint, m.
fn bone(points: &[DVec3; N_KEYPOINTS], k: usize) -> f64 {
    let from = if (k - 1).is_multiple_of(4) { 0 } else { k - 1 };
    points[k].distance(points[from])
}
