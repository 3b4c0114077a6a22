//! Fingertips that meet: thumb and finger, or a pad and the object that is held.

use glam::{DMat3, DVec3};

use super::{FingerGoal, Goal, Seen};
use crate::hand::N_KEYPOINTS;
use crate::retarget::human::keypoint;
use crate::retarget::robot::fingers::Finger;
use crate::retarget::robot::{Robot, frame};
use crate::retarget::touch::{Touch, tip_force};

/// Distance of two human tips that touch, m, at the reference size.
const TOUCHING: f64 = 0.014;
/// Gap of two human fingers up to which a touch of both is a touch of each other, m, and from which on it is not.
const CLOSED: f64 = 0.014;
const OPEN: f64 = 0.024;
/// Gap at which fingers that do not touch are kept, m.
const APART: f64 = 0.0025;
/// Distances of human tips at which their gap begins to count, and counts in full, m.
const NOTICED: f64 = 0.06;
const MINDED: f64 = 0.035;
/// Weight of a gap that is just noticed, over that of one that is minded.
const FAINT: f64 = 1e-4;
/// Force with which thumb and finger press each other from which on its direction is known, N.
const PRESSED: f64 = 0.1;
/// Length of a fingertip whose thickness is taken, m.
const END: f64 = 0.015;

/// Where a fingertip touches another one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Meeting {
    /// In the world, m.
    pub place: DVec3,
    /// Unit normal out of the fingertip, in the world.
    pub normal: DVec3,
}

impl Goal {
    /// Has a finger's pad touch the object where the human's touches and the object is near; returns how much that counts.
    pub(super) fn aim_hold(&mut self, k: usize, robot: &mut Robot, is_touched: bool, weight: f64) -> f64 {
        let Some(hold) = self.fingers[k].hold else { return 0.0 };
        let near = match self.problem.gaps[hold].geoms() {
            Some(sides) if is_touched => {
                let gap = nearest(robot, sides, NOTICED).map_or(NOTICED, |near| near.distance);
                smoothstep((NOTICED - gap) / (NOTICED - MINDED))
            }
            _ => 0.0,
        };
        self.problem.weigh(hold, near * weight);
        near
    }

    /// How far a finger's tip shall be from the thumb's, and where from. `axes`: the wrist's in the world.
    pub(super) fn aim_pinch(&mut self, k: usize, seen: &Seen, is_gripper: bool, weights: [f64; 2], axes: DMat3) {
        let FingerGoal { human, pinch: Some(pinch), .. } = self.fingers[k] else { return };
        let Seen { points, touch, .. } = *seen;
        let size = self.relative_size(seen.size);
        let [weight, facing_weight] = weights;
        let distance = points[keypoint(human, 3)].distance(points[keypoint(0, 3)]);
        let human_gap = (distance - TOUCHING * size).max(0.0);
        let near = smoothstep((NOTICED * size - distance) / ((NOTICED - MINDED) * size));
        // What lies between two fingers that are near has one size, whatever hand it is in; how far open fingers are apart
        // goes with the hand.
        let human_gap = human_gap * size.powf(near - 1.0);
        let both = touch.map(|touch| touch.tip_contact[0].min(touch.tip_contact[human]));
        let closing = human_gap * smoothstep((human_gap - CLOSED) / (OPEN - CLOSED));
        let (target, share) = match both {
            Some(both) if both > 0.5 => (closing, near.max(0.5)),
            Some(_) => (human_gap.max(APART), near),
            None => (human_gap * smoothstep(human_gap / (0.5 * CLOSED)), near),
        };
        // Tips and gap ask for different things while fingers approach: hand over by ratios, not by amounts.
        let share = if share > 0.0 { FAINT.powf(1.0 - share) } else { 0.0 };
        self.problem.gaps[pinch].target = target;
        self.problem.weigh(pinch, weight * if is_gripper { 1.0 } else { share });
        let Some((vector, length)) = self.fingers[k].facing else { return };
        let pressed = touch.filter(|_| both.is_some_and(|both| both > 0.5) && !is_gripper);
        // Fingertips press where they meet: along the line between their middles, whatever way their pads look.
        let line = pressed.map_or(DVec3::ZERO, |touch| tip_force(seen, touch, human) - tip_force(seen, touch, 0));
        let is_known = line.length() > PRESSED;
        let vector = &mut self.problem.vectors[vector];
        vector.target = (length + target) * (axes * line.normalize_or_zero());
        vector.weight = if is_known { near * facing_weight } else { 0.0 };
    }

    /// Distance of the surfaces of thumb and a robot finger's tip in the robot's present pose, m, 0.1 at most; None for the
    /// thumb itself.
    pub fn exact_gap(&self, robot: &mut Robot, finger: usize) -> Option<f64> {
        const MOST: f64 = 0.1;
        match self.problem.gaps[self.fingers[finger].pinch?].geoms() {
            Some(sides) => Some(nearest(robot, sides, MOST).map_or(MOST, |near| near.distance)),
            None => {
                let thumb = robot.fingers.iter().find(|finger| finger.human == 0)?;
                let tips = [thumb, &robot.fingers[finger]].map(|finger| frame::place(&robot.world, finger));
                Some(tips[0].distance(tips[1]).min(MOST))
            }
        }
    }

    /// Where fingertips touch the object, or thumb and fingers each other, in the robot's present pose, by human finger: those
    /// that the human's touch, and whose surfaces are within 3 mm. `points`: the human's keypoints in the wrist frame.
    pub fn meetings(&self, robot: &mut Robot, points: &[DVec3; N_KEYPOINTS], touch: &Touch) -> [Option<Meeting>; 5] {
        const NEAR: f64 = 0.003;
        let axes = robot.wrist.world_axes(&robot.world);
        let mut meetings = [None; 5];
        for finger in &self.fingers {
            let Some(pinch) = finger.pinch else { continue };
            if touch.tip_contact[0].min(touch.tip_contact[finger.human]) <= 0.5 {
                continue;
            }
            let Some(sides) = self.problem.gaps[pinch].geoms() else {
                // Of points that lie upon each other the human's fingertips tell how they meet.
                let find = |human: usize| robot.fingers.iter().find(|finger| finger.human == human);
                let (Some(thumb), Some(other)) = (find(0), find(finger.human)) else { continue };
                let [a, b] = [thumb, other].map(|finger| frame::place(&robot.world, finger));
                let line = axes * (points[keypoint(finger.human, 3)] - points[keypoint(0, 3)]);
                let Some(normal) = line.try_normalize().filter(|_| a.distance(b) <= NEAR) else { continue };
                meetings[0] = Some(Meeting { place: 0.5 * (a + b), normal });
                meetings[finger.human] = Some(Meeting { place: 0.5 * (a + b), normal: -normal });
                continue;
            };
            let Some(Nearest { place, normal: Some(normal), .. }) = nearest(robot, sides, NEAR) else { continue };
            meetings[0] = Some(Meeting { place, normal });
            meetings[finger.human] = Some(Meeting { place, normal: -normal });
        }
        for finger in &self.fingers {
            let Some(hold) = finger.hold.filter(|_| touch.tip_contact[finger.human] > 0.5) else { continue };
            let found = self.problem.gaps[hold].geoms().and_then(|sides| nearest(robot, sides, NEAR));
            if let Some(Nearest { place, normal: Some(normal), .. }) = found {
                meetings[finger.human] = Some(Meeting { place, normal });
            }
        }
        meetings
    }

    /// Distance of a finger's pad from the object in the robot's present pose, m, 0.1 at most; None without pad or object.
    pub fn gap_to_object(&self, robot: &mut Robot, finger: usize) -> Option<f64> {
        const MOST: f64 = 0.1;
        let sides = self.problem.gaps[self.fingers[finger].hold?].geoms()?;
        Some(nearest(robot, sides, MOST).map_or(MOST, |near| near.distance))
    }
}

/// Middle of a fingertip in its body's frame and how far its skin is from there, m: a ball at its end, as thick as it is;
/// None without geoms.
pub(super) fn middle(robot: &Robot, finger: &Finger) -> Option<(DVec3, f64)> {
    let (origin, rotation) = robot.world.body_pose(finger.tip_body);
    let tip = origin + rotation * finger.tip;
    let from = finger.knuckles.last().map_or(origin, |joint| robot.world.joint_axis(*joint).0);
    let normal = rotation * finger.pad_normal;
    let along = (tip - from).reject_from_normalized(normal).try_normalize()?;
    let axes = DMat3::from_cols(normal, along.cross(normal), along);
    let skin = finger.pad_geoms.iter().flat_map(|geom| {
        let (at, turn) = robot.world.geom_pose(*geom);
        robot.parts.geoms[*geom].points.iter().map(move |point| axes.transpose() * (at + turn * *point))
    });
    let skin: Vec<DVec3> = skin.collect();
    let end = skin.iter().map(|point| point.z).reduce(f64::max)?;
    let near = skin.into_iter().filter(|point| point.z > end - END);
    let (low, high) = near.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
    let radius = 0.5 * (high - low).truncate().min_element();
    let middle = (0.5 * (low + high)).truncate().extend(end - radius);
    Some((rotation.transpose() * (axes * middle - origin), radius))
}

/// Where two surfaces are nearest.
struct Nearest {
    /// Negative = inside each other, m.
    distance: f64,
    /// Between both, in the world, m.
    place: DVec3,
    /// From the first to the second; None where they just touch.
    normal: Option<DVec3>,
}

/// Where two sets of geoms are nearest in the robot's present pose, if nearer than `most`, m.
fn nearest(robot: &mut Robot, [first, second]: [&[usize]; 2], most: f64) -> Option<Nearest> {
    let mut found: Option<Nearest> = None;
    for pair in first.iter().flat_map(|a| second.iter().map(move |b| [*a, *b])) {
        let limit = found.as_ref().map_or(most, |found| found.distance);
        let (distance, Some([a, b])) = robot.world.geom_distance(pair, limit) else { continue };
        let line = if distance < 0.0 { a - b } else { b - a };
        found = Some(Nearest { distance, place: 0.5 * (a + b), normal: line.try_normalize() });
    }
    found
}

fn smoothstep(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}
