//! Pinches: fingertips that touch the thumb or the held object.
//!
//! The position of two fingertips and their distance can't both be matched on another hand. While fingers are open the
//! positions count; as they close, the weight of their distance grows until it decides alone.

use glam::DVec3;

use super::fingertip::{Nearest, nearest};
use super::{CONTACT_THRESHOLD, FingerGoal, Goal, HandObservation};
use crate::hand::N_KEYPOINTS;
use crate::retarget::human::keypoint;
use crate::retarget::robot::Robot;
use crate::retarget::touch::{PinchPoint, Touch};

/// Distance of the keypoints of two human fingertips that touch, m, at the reference size: keypoints lie inside the tips.
const TOUCHING_TIP_DISTANCE: f64 = 0.014;
/// Gap of two human fingertips up to which a touch of both is a touch of each other, m.
const CLOSED_GAP: f64 = 0.014;
/// Gap from which on a touch of both is a touch of something between them, m.
const OPEN_GAP: f64 = 0.024;
/// Least gap of the robot's fingertips while the human's do not touch each other, m.
const MIN_OPEN_GAP: f64 = 0.0025;
/// Distance of fingertips, human or robot's from the object, at which a gap begins to count, m.
const GAP_COUNTS_BELOW: f64 = 0.06;
/// Distance at which a gap has its full weight, m.
const GAP_COUNTS_FULLY_BELOW: f64 = 0.035;
/// Weight of a gap that just begins to count, relative to its full weight.
const MIN_GAP_WEIGHT: f64 = 1e-4;
/// Least force with which thumb and finger press each other at which its direction is known, N.
const MIN_PRESS_FORCE: f64 = 0.1;
/// Greatest distance of surfaces at which they count as touching, m.
const CONTACT_DISTANCE: f64 = 0.003;
/// Greatest distance that is reported, m.
const MAX_REPORTED_GAP: f64 = 0.1;

impl Goal {
    /// Sets the gap of a finger's pad to the object: 0 if the human's pad touches and the object is near. Returns the share,
    /// 0 to 1, to which the finger holds the object.
    pub(super) fn aim_hold(&mut self, k: usize, robot: &mut Robot, is_touched: bool) -> f64 {
        let Some(hold) = self.fingers[k].hold else { return 0.0 };
        let share = match self.problem.gaps[hold].geoms() {
            Some(sides) if is_touched => {
                let gap = nearest(robot, sides, GAP_COUNTS_BELOW).map_or(GAP_COUNTS_BELOW, |near| near.distance);
                smoothstep((GAP_COUNTS_BELOW - gap) / (GAP_COUNTS_BELOW - GAP_COUNTS_FULLY_BELOW))
            }
            _ => 0.0,
        };
        self.problem.weigh(hold, share * robot.spec.weights.pinch);
        share
    }

    /// Sets gap and facing direction of a finger and the thumb; `share`: factor of their weights, 0 to 1.
    pub(super) fn aim_pinch(&mut self, k: usize, robot: &Robot, seen: &HandObservation, share: f64) {
        let FingerGoal { human, pinch: Some(pinch), .. } = self.fingers[k] else { return };
        let HandObservation { hand, points, direction_points, touch, .. } = *seen;
        let size = self.relative_size(seen.size);
        let (weight, facing_weight) = (share * robot.spec.weights.pinch, share * robot.spec.weights.facing);
        let distance = points[keypoint(human, 3)].distance(points[keypoint(0, 3)]);
        let human_gap = (distance - TOUCHING_TIP_DISTANCE * size).max(0.0);
        let nearness =
            smoothstep((GAP_COUNTS_BELOW * size - distance) / ((GAP_COUNTS_BELOW - GAP_COUNTS_FULLY_BELOW) * size));
        // An object between two near fingertips has the same size in any hand; the gap of open fingers scales with the hand.
        let human_gap = human_gap * size.powf(nearness - 1.0);
        let both = touch.map(|touch| touch.tip_contact[0].min(touch.tip_contact[human]));
        let closing = human_gap * smoothstep((human_gap - CLOSED_GAP) / (OPEN_GAP - CLOSED_GAP));
        let (target, nearness_of_gap) = match both {
            Some(both) if both > CONTACT_THRESHOLD => (closing, nearness.max(0.5)),
            Some(_) => (human_gap.max(MIN_OPEN_GAP), nearness),
            None => (human_gap * smoothstep(human_gap / (0.5 * CLOSED_GAP)), nearness),
        };
        // The weight grows geometrically: linearly, it would outweigh the tips' positions as soon as the gap counts at all,
        // and fingers would snap together.
        let gap_share = if nearness_of_gap > 0.0 { MIN_GAP_WEIGHT.powf(1.0 - nearness_of_gap) } else { 0.0 };
        self.problem.gaps[pinch].target = target;
        self.problem.weigh(pinch, weight * if robot.is_gripper() { 1.0 } else { gap_share });
        let Some(facing) = self.fingers[k].facing else { return };
        let is_pinched = both.is_some_and(|both| both > CONTACT_THRESHOLD) && !robot.is_gripper();
        // Fingertips press each other along the line between their middles, wherever their pads point to.
        let line = touch.filter(|_| is_pinched).map_or(DVec3::ZERO, |touch| {
            let force = |finger| touch.force_on_tip(hand, direction_points, finger);
            force(human) - force(0)
        });
        let is_known = line.length() > MIN_PRESS_FORCE;
        let vector = &mut self.problem.vectors[facing.vector];
        let direction = robot.wrist.world_axes(&robot.world) * line.normalize_or_zero();
        vector.target = (facing.length + target) * direction;
        vector.weight = if is_known { nearness * facing_weight } else { 0.0 };
    }

    /// Finds the contact points of the robot's fingertips in its present pose, by human finger: of those that the human
    /// touches with, and whose surfaces are within 3 mm of the thumb, another fingertip, or the object. `points`: (21)
    /// keypoints of the human in the wrist frame, m.
    pub(in crate::retarget) fn pinch_points(
        &self,
        robot: &mut Robot,
        points: &[DVec3; N_KEYPOINTS],
        touch: &Touch,
    ) -> [Option<PinchPoint>; 5] {
        let mut pinches = [None; 5];
        for finger in &self.fingers {
            let Some(gap) = finger.pinch else { continue };
            if touch.tip_contact[0].min(touch.tip_contact[finger.human]) <= CONTACT_THRESHOLD {
                continue;
            }
            let found = match self.problem.gaps[gap].geoms() {
                Some(sides) => contact_point(robot, sides),
                None => point_contact(robot, finger.human, points),
            };
            let Some(PinchPoint { position, normal }) = found else { continue };
            pinches[0] = Some(PinchPoint { position, normal });
            pinches[finger.human] = Some(PinchPoint { position, normal: -normal });
        }
        for finger in &self.fingers {
            let Some(hold) = finger.hold.filter(|_| touch.tip_contact[finger.human] > CONTACT_THRESHOLD) else {
                continue;
            };
            let found = self.problem.gaps[hold].geoms().and_then(|sides| contact_point(robot, sides));
            pinches[finger.human] = found.or(pinches[finger.human]);
        }
        pinches
    }

    /// Distance of the surfaces of thumb and a robot fingertip in the robot's present pose, m, 0.1 at most; None for the
    /// thumb itself.
    pub fn gap_to_thumb(&self, robot: &mut Robot, finger: usize) -> Option<f64> {
        match self.problem.gaps[self.fingers[finger].pinch?].geoms() {
            Some(sides) => Some(reported_gap(robot, sides)),
            None => {
                let thumb = robot.fingers.iter().find(|finger| finger.human == 0)?;
                let tips = [thumb, &robot.fingers[finger]].map(|finger| finger.tip_position(&robot.world));
                Some(tips[0].distance(tips[1]).min(MAX_REPORTED_GAP))
            }
        }
    }

    /// Distance of a finger's pad from the object in the robot's present pose, m, 0.1 at most; None without pad or object.
    pub fn gap_to_object(&self, robot: &mut Robot, finger: usize) -> Option<f64> {
        let sides = self.problem.gaps[self.fingers[finger].hold?].geoms()?;
        Some(reported_gap(robot, sides))
    }
}

fn reported_gap(robot: &mut Robot, sides: [&[usize]; 2]) -> f64 {
    nearest(robot, sides, MAX_REPORTED_GAP).map_or(MAX_REPORTED_GAP, |near| near.distance)
}

/// Returns where two surfaces touch, with the normal out of the first.
fn contact_point(robot: &mut Robot, sides: [&[usize]; 2]) -> Option<PinchPoint> {
    let Nearest { position, normal, .. } = nearest(robot, sides, CONTACT_DISTANCE)?;
    Some(PinchPoint { position, normal: normal? })
}

/// Returns where thumb and fingertip touch if they are points: two points that coincide have no normal, so it is that of
/// the human's fingertips.
fn point_contact(robot: &Robot, human: usize, points: &[DVec3; N_KEYPOINTS]) -> Option<PinchPoint> {
    let tip = |human: usize| {
        let finger = robot.fingers.iter().find(|finger| finger.human == human)?;
        Some(finger.tip_position(&robot.world))
    };
    let (a, b) = (tip(0)?, tip(human)?);
    let axes = robot.wrist.world_axes(&robot.world);
    let line = axes * (points[keypoint(human, 3)] - points[keypoint(0, 3)]);
    let normal = line.try_normalize().filter(|_| a.distance(b) <= CONTACT_DISTANCE)?;
    Some(PinchPoint { position: 0.5 * (a + b), normal })
}

/// Cubic step from 0 at `x` = 0 to 1 at `x` = 1, with zero slope at both.
fn smoothstep(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}
