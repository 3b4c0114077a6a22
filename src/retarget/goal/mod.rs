//! Goal of a frame: targets for fingertips, phalanges, pads, pinches and the held object, as a [`Problem`].
//!
//! | term | target | weight |
//! |---|---|---|
//! | tip | position of the human's fingertip, scaled by the ratio of the fingers' lengths | `tip` |
//! | phalanx | direction of the human's bone | `posture` |
//! | pad, if touched | normal of the human's pad | `pad_normal` |
//! | pinch | gap between thumb and fingertip | `pinch`, grows as the tips approach |
//! | facing, if pressed | direction in which thumb and fingertip press each other | `facing` |
//! | hold, if touched and near | distance 0 from pad to object | `pinch` |
//! | neutral | `neutral` of the robot's file, or its rest pose | `neutral`, `smooth` |
//!
//! Terms of direction are vectors of `METRES_PER_RADIAN`, so that all terms are in metres.

mod build;
mod collision;
mod fingertip;
mod observation;
mod pinch;

use glam::DVec3;

pub use self::observation::HandObservation;

use super::filter::SizeEstimate;
use super::human::{Hand, keypoint, pad_normal};
use super::problem::Problem;
use super::robot::Robot;
use super::solver::Solver;
use crate::hand::N_KEYPOINTS;

/// Length that converts angles to distances, m/rad: about that of a finger.
const METRES_PER_RADIAN: f64 = 0.1;
/// Contact probability above which a fingertip counts as touched.
const CONTACT_THRESHOLD: f64 = 0.5;

/// Terms of one robot finger, as indices into the problem.
#[derive(Debug)]
struct FingerGoal {
    /// Human finger that it follows.
    human: usize,
    /// Point at the tip.
    tip_point: usize,
    /// Vector to the tip.
    tip: usize,
    /// Vectors of its phalanges.
    phalanges: Vec<PhalanxTerm>,
    /// Vector along the pad's normal.
    pad: usize,
    /// Gap to the thumb.
    pinch: Option<usize>,
    /// Vector from the thumb's tip to this one.
    facing: Option<Facing>,
    /// Gap of its pad to the object.
    hold: Option<usize>,
    /// Base knuckle in the wrist frame, m.
    base: DVec3,
    /// Length of its phalanges, m.
    length: f64,
    /// Robot metres per human metre; None = the ratio of the fingers' lengths.
    scale: Option<f64>,
}

/// Vector along a phalanx.
#[derive(Debug, Clone, Copy)]
struct PhalanxTerm {
    vector: usize,
    /// Human keypoints at the ends of the bone that it follows.
    bone: [usize; 2],
    /// Length of the robot's phalanx, m.
    length: f64,
}

/// Vector between the balls in two fingertips.
#[derive(Debug, Clone, Copy)]
struct Facing {
    vector: usize,
    /// Length at which the balls touch, m.
    length: f64,
}

/// Pair of geoms that must not penetrate each other.
#[derive(Debug, Clone, Copy)]
struct CollisionTerm {
    /// Index of its gap in the problem.
    gap: usize,
    /// Indices of the geoms.
    geoms: [usize; 2],
    /// Sum of the radii of their bounding spheres, m.
    radii: f64,
}

/// Goal of a frame.
#[derive(Debug)]
pub struct Goal {
    problem: Problem,
    solver: Solver,
    fingers: Vec<FingerGoal>,
    collisions: Vec<CollisionTerm>,
    /// Index of the first gap of `collisions`.
    first_collision: usize,
    /// Workspace: centre of each geom, m.
    centres: Vec<DVec3>,
    /// Size of the hand that the distances of pinches are given for, m.
    reference_size: f64,
    /// Mean of the robot's finger bases in the wrist frame, m.
    bases: DVec3,
    /// Workspace: pose at which a solve started.
    start: Vec<f64>,
    /// Neutral position of each free coordinate, rad or m.
    neutral: Vec<f64>,
}

impl Goal {
    /// Sets the targets of a frame; `last`: free coordinates of the last frame.
    pub fn aim(&mut self, robot: &mut Robot, seen: &HandObservation, last: &[f64]) {
        let [_, human_bases] = self.bases(robot, seen.points);
        for k in 0..self.fingers.len() {
            let is_touched =
                seen.touch.is_some_and(|touch| touch.tip_contact[self.fingers[k].human] > CONTACT_THRESHOLD);
            self.aim_tip(k, robot, seen, human_bases);
            self.aim_pad(k, robot, seen, is_touched);
            self.aim_phalanges(k, robot, seen);
            // A finger that holds the object pinches nothing else.
            let held = self.aim_hold(k, robot, is_touched);
            self.aim_pinch(k, robot, seen, 1.0 - held);
        }
        self.aim_neutral(robot, last);
    }

    /// Sets the position of a fingertip.
    fn aim_tip(&mut self, k: usize, robot: &Robot, seen: &HandObservation, human_bases: DVec3) {
        let FingerGoal { human, tip, scale, base, length, .. } = self.fingers[k];
        let end = seen.points[keypoint(human, 3)];
        let target = match (scale, robot.wrist_position) {
            (Some(scale), Some(wrist)) => robot.wrist.axes.transpose() * wrist + scale * end,
            (Some(scale), None) => self.bases + scale * (end - human_bases),
            // Scaled about the finger's base by the ratio of the lengths, tip and phalanges ask for the same pose.
            (None, _) => {
                let human_length = seen.size.finger_lengths()[human];
                let scale = if human_length > 0.0 { length / human_length } else { 1.0 };
                base + scale * (end - seen.points[keypoint(human, 0)])
            }
        };
        let (origin, _) = robot.world.body_pose(robot.wrist.body);
        let vector = &mut self.problem.vectors[tip];
        vector.target = origin + robot.wrist.world_axes(&robot.world) * target;
        vector.weight = if robot.is_gripper() { 0.0 } else { robot.spec.weights.tip };
    }

    /// Sets the orientation of a pad.
    fn aim_pad(&mut self, k: usize, robot: &Robot, seen: &HandObservation, is_touched: bool) {
        let FingerGoal { human, pad, .. } = self.fingers[k];
        let normal = robot.wrist.world_axes(&robot.world) * pad_normal(seen.direction_points, human);
        let vector = &mut self.problem.vectors[pad];
        vector.target = METRES_PER_RADIAN * normal;
        vector.weight = if is_touched && !robot.is_gripper() { robot.spec.weights.pad_normal } else { 0.0 };
    }

    /// Sets the directions of a finger's phalanges.
    fn aim_phalanges(&mut self, k: usize, robot: &Robot, seen: &HandObservation) {
        let axes = robot.wrist.world_axes(&robot.world);
        for PhalanxTerm { vector, bone: [from, to], length } in self.fingers[k].phalanges.iter().copied() {
            let points = seen.direction_points;
            let direction = (points[to] - points[from]).normalize_or_zero();
            let vector = &mut self.problem.vectors[vector];
            vector.target = length * (axes * direction);
            // The error of a direction is length times angle: weigh all phalanges as if they had one length.
            let share = METRES_PER_RADIAN / length.max(1e-3);
            vector.weight = if robot.is_gripper() { 0.0 } else { robot.spec.weights.posture * share * share };
        }
    }

    /// Sets the neutral positions: one quadratic term stands for those of the weights `neutral` and `smooth`.
    fn aim_neutral(&mut self, robot: &Robot, last: &[f64]) {
        let weight = robot.spec.weights.neutral * METRES_PER_RADIAN * METRES_PER_RADIAN;
        let smooth = robot.spec.weights.smooth * METRES_PER_RADIAN * METRES_PER_RADIAN;
        let both = weight + smooth;
        for (k, last) in last.iter().enumerate() {
            let pull = weight * self.neutral[k] + smooth * last;
            self.problem.neutral[k] = if both > 0.0 { pull / both } else { 0.0 };
            self.problem.neutral_weight[k] = both;
        }
    }

    /// Size of the human hand relative to the reference hand.
    fn relative_size(&self, size: &SizeEstimate) -> f64 {
        if size.size() > 0.0 { size.size() / self.reference_size } else { 1.0 }
    }

    /// Returns the mean of the finger bases in the wrist frames, m: the robot's, and those of the human hand with `points`.
    pub fn bases(&self, robot: &Robot, points: &[DVec3; N_KEYPOINTS]) -> [DVec3; 2] {
        let mapped = robot.fingers.iter().map(|finger| finger.human).filter(|human| *human != 0);
        [self.bases, Hand::bases(points, mapped)]
    }

    /// Distance of a finger's tip from its target in the robot's present pose, m.
    pub fn tip_error(&self, robot: &Robot, finger: usize) -> f64 {
        let vector = &self.problem.vectors[self.fingers[finger].tip];
        robot.fingers[finger].tip_position(&robot.world).distance(vector.target)
    }
}
