//! What a robot shall do in a frame, as a [`Problem`].

pub mod pinch;

use glam::{DMat3, DVec3};

use self::pinch::middle;
use super::filter::SizeEstimate;
use super::human::{Hand, keypoint};
use super::problem::{Problem, Side, Vector};
use super::robot::{Robot, frame, reference_size};
use super::solver::{Solved, Solver, Stop};
use super::touch::Touch;
use crate::error::Result;
use crate::hand::N_KEYPOINTS;

/// Metres that a radian counts as.
const METRES_PER_RADIAN: f64 = 0.1;
/// Error of a fingertip from which on it counts linearly, m.
const HUBER: f64 = 0.03;
/// Weight of links that must not run into each other, per square metre.
const COLLISION_WEIGHT: f64 = 1000.0;
/// Links nearer than this are watched, m.
const WATCHED: f64 = 0.012;

/// A robot finger's part of the problem.
#[derive(Debug)]
struct FingerGoal {
    human: usize,
    tip: usize,
    /// Vectors of its phalanges, with the human keypoints they follow and their length, m.
    phalanges: Vec<(usize, [usize; 2], f64)>,
    /// Vector along the pad's normal.
    pad: usize,
    /// Gap to the thumb.
    pinch: Option<usize>,
    /// Vector from the middle of the thumb's tip to that of its own, with its length where they touch, m.
    facing: Option<(usize, f64)>,
    /// Gap of its pad to the object.
    hold: Option<usize>,
    /// Where its first phalanx begins, in the wrist frame, m, and how long its phalanges are.
    base: DVec3,
    length: f64,
    scale: Option<f64>,
}

/// A hand as it was seen in a frame.
#[derive(Debug, Clone, Copy)]
pub struct Seen<'a> {
    /// The frame as it came.
    pub hand: &'a Hand,
    /// (21) keypoints in the wrist frame, m.
    pub points: &'a [DVec3; N_KEYPOINTS],
    /// The same for the directions of short bones, in which jitter is large.
    pub calm: &'a [DVec3; N_KEYPOINTS],
    /// How large it is.
    pub size: &'a SizeEstimate,
    /// What it touches.
    pub touch: Option<&'a Touch>,
}

/// The goal of a frame.
#[derive(Debug)]
pub struct Goal {
    /// What is made small.
    pub problem: Problem,
    fingers: Vec<FingerGoal>,
    /// Gaps of pairs that must not collide, with their geoms.
    collisions: Vec<(usize, [usize; 2], f64)>,
    /// Index of the first of them.
    first_collision: usize,
    /// Centre of each geom when pairs were last looked through, m.
    centres: Vec<DVec3>,
    reference_size: f64,
    /// Bases of the robot's fingers in the wrist frame, m.
    bases: DVec3,
    /// Where a solve began.
    start: Vec<f64>,
    smooth: f64,
    neutral: Vec<f64>,
    neutral_weight: f64,
}

impl Goal {
    /// Makes room for everything that can count.
    ///
    /// # Errors
    /// If the robot's rest pose can't be taken.
    pub fn new(robot: &Robot) -> Result<Self> {
        let mut problem = Problem::new(&robot.world, &robot.parts, &robot.coupling);
        let mut fingers = Vec::new();
        for finger in &robot.fingers {
            let tip_point = problem.add_point(finger.tip_body, finger.tip);
            let tip = problem.vectors.len();
            problem.vectors.push(Vector::idle(None, tip_point, HUBER));
            let mut points: Vec<(usize, DVec3)> = Vec::new();
            for joint in &finger.knuckles {
                let body = robot.parts.joints[*joint].body;
                let (origin, rotation) = robot.world.body_pose(body);
                let anchor = robot.world.joint_axis(*joint).0;
                points.push((problem.add_point(body, rotation.transpose() * (anchor - origin)), anchor));
            }
            points.push((tip_point, frame::place(&robot.world, finger)));
            let mut phalanges = Vec::new();
            for (segment, human) in segments(points.len() - 1, finger.human) {
                let [(from, a), (to, b)] = [points[segment], points[segment + 1]];
                let vector = Vector::idle(Some(from), to, f64::INFINITY);
                phalanges.push((problem.vectors.len(), human, a.distance(b)));
                problem.vectors.push(vector);
            }
            let ahead = problem.add_point(finger.tip_body, finger.tip + METRES_PER_RADIAN * finger.pad_normal);
            let pad = problem.vectors.len();
            problem.vectors.push(Vector::idle(Some(tip_point), ahead, f64::INFINITY));
            fingers.push(FingerGoal {
                human: finger.human,
                tip,
                phalanges,
                pad,
                pinch: None,
                facing: None,
                hold: None,
                base: robot.base(finger),
                length: finger.length,
                scale: robot.scale[finger.human],
            });
        }
        let side = |index: usize| match robot.fingers[index].pad_geoms.is_empty() {
            true => Side::Sphere { point: problem_tip(&fingers, &problem, index), radius: 0.0 },
            false => Side::Geoms { body: robot.fingers[index].tip_body, geoms: robot.fingers[index].pad_geoms.clone() },
        };
        if let Some(thumb) = robot.fingers.iter().position(|finger| finger.human == 0) {
            let sides: Vec<(usize, [Side; 2])> = (0..fingers.len())
                .filter(|index| *index != thumb)
                .map(|index| match (side(thumb), side(index)) {
                    // A ball and a geom have no common distance: take both as points.
                    (Side::Geoms { .. }, Side::Sphere { .. }) | (Side::Sphere { .. }, Side::Geoms { .. }) => {
                        let ball = |index| Side::Sphere { point: problem_tip(&fingers, &problem, index), radius: 0.0 };
                        (index, [ball(thumb), ball(index)])
                    }
                    (a, b) => (index, [a, b]),
                })
                .collect();
            let of_thumb = middle(robot, &robot.fingers[thumb]);
            for (index, sides) in sides {
                fingers[index].pinch = Some(problem.add_gap(sides, false));
                // Points have no side to meet from.
                let of_finger = middle(robot, &robot.fingers[index]);
                let (Some((from, thumb_radius)), Some((to, radius))) = (of_thumb, of_finger) else { continue };
                let from = problem.add_point(robot.fingers[thumb].tip_body, from);
                let to = problem.add_point(robot.fingers[index].tip_body, to);
                fingers[index].facing = Some((problem.vectors.len(), thumb_radius + radius));
                problem.vectors.push(Vector::idle(Some(from), to, f64::INFINITY));
            }
        }
        if let Some(object) = &robot.object {
            for (goal, finger) in fingers.iter_mut().zip(&robot.fingers).filter(|(_, f)| !f.pad_geoms.is_empty()) {
                let pad = Side::Geoms { body: finger.tip_body, geoms: finger.pad_geoms.clone() };
                let whole = Side::Geoms { body: object.body, geoms: object.geoms.clone() };
                goal.hold = Some(problem.add_gap([pad, whole], false));
            }
        }
        let tips = |geom: usize| robot.fingers.iter().position(|finger| finger.pad_geoms.contains(&geom));
        // Thumb and fingertips have gaps of their own.
        let has_own = |[a, b]: [usize; 2]| match (tips(a), tips(b)) {
            (Some(a), Some(b)) => [a, b].iter().any(|index| robot.fingers[*index].human == 0),
            _ => false,
        };
        let margin = robot.spec.collision.margin;
        let links = robot.pairs.iter().copied().filter(|pair| !has_own(*pair)).map(|pair| (pair, margin));
        // What is held is touched: no margin.
        let held = robot.against_object().into_iter().map(|pair| (pair, 0.0));
        let mut collisions = Vec::new();
        for ([a, b], target) in links.chain(held) {
            let geom_side = |geom: usize| Side::Geoms { body: robot.parts.geoms[geom].body, geoms: vec![geom] };
            let gap = problem.add_gap([geom_side(a), geom_side(b)], true);
            problem.gaps[gap].target = target;
            collisions.push((gap, [a, b], robot.parts.geoms[a].radius + robot.parts.geoms[b].radius));
        }
        let mut neutral = robot.rest.clone();
        for (name, position) in &robot.spec.neutral {
            for (coordinate, master) in robot.coupling.masters.iter().enumerate() {
                if robot.parts.joints[*master].name == *name {
                    neutral[coordinate] = *position;
                }
            }
        }
        let mapped = |human: usize| human != 0 || robot.fingers.len() == 1;
        Ok(Self {
            bases: robot.bases(|finger| mapped(finger.human)),
            first_collision: problem.gaps.len() - collisions.len(),
            centres: vec![DVec3::ZERO; robot.parts.geoms.len()],
            problem,
            fingers,
            collisions,
            reference_size: reference_size()?,
            start: robot.rest.clone(),
            smooth: robot.spec.weights.smooth,
            neutral,
            neutral_weight: robot.spec.weights.neutral,
        })
    }

    /// Sets the targets of a frame; `last`: where the free coordinates were.
    pub fn aim(&mut self, robot: &mut Robot, seen: &Seen, last: &[f64]) {
        let Seen { points, calm, size, touch, .. } = *seen;
        let axes = robot.wrist.world_axes(&robot.world);
        let (origin, _) = robot.world.body_pose(robot.wrist.body);
        let to_wrist = robot.wrist.axes.transpose();
        let [_, human_bases] = self.bases(robot, points);
        let weights = robot.spec.weights.clone();
        let is_gripper = robot.is_gripper();
        for k in 0..self.fingers.len() {
            let FingerGoal { human, tip, pad, scale, base, length, .. } = self.fingers[k];
            let end = points[keypoint(human, 3)];
            let target = match (scale, robot.wrist_position) {
                (Some(scale), Some(wrist)) => to_wrist * wrist + scale * end,
                (Some(scale), None) => self.bases + scale * (end - human_bases),
                // As long a finger bent as much from where it begins: tip and phalanges ask for the same.
                (None, _) => {
                    let human_length = size.finger_lengths()[human];
                    let scale = if human_length > 0.0 { length / human_length } else { 1.0 };
                    base + scale * (end - points[keypoint(human, 0)])
                }
            };
            let vector = &mut self.problem.vectors[tip];
            vector.target = origin + axes * target;
            vector.weight = if is_gripper { 0.0 } else { weights.tip };
            let is_touched = touch.is_some_and(|touch| touch.tip_contact[human] > 0.5);
            let vector = &mut self.problem.vectors[pad];
            vector.target = METRES_PER_RADIAN * (axes * pad_normal(calm, human));
            vector.weight = if is_touched && !is_gripper { weights.pad_normal } else { 0.0 };
            for (vector, [from, to], length) in self.fingers[k].phalanges.iter().copied() {
                let direction = (calm[to] - calm[from]).normalize_or_zero();
                let vector = &mut self.problem.vectors[vector];
                vector.target = length * (axes * direction);
                let share = METRES_PER_RADIAN / length.max(1e-3);
                vector.weight = if is_gripper { 0.0 } else { weights.posture * share * share };
            }
            let held = self.aim_hold(k, robot, is_touched, weights.pinch);
            let share = 1.0 - held;
            self.aim_pinch(k, seen, is_gripper, [share * weights.pinch, share * weights.facing], axes);
        }
        for (k, last) in last.iter().enumerate() {
            let weight = self.neutral_weight * METRES_PER_RADIAN * METRES_PER_RADIAN;
            let smooth = self.smooth * METRES_PER_RADIAN * METRES_PER_RADIAN;
            let both = weight + smooth;
            let pull = weight * self.neutral[k] + smooth * last;
            self.problem.neutral[k] = if both > 0.0 { pull / both } else { 0.0 };
            self.problem.neutral_weight[k] = both;
        }
    }

    /// How large the hand is beside the one that distances are given for.
    fn relative_size(&self, size: &SizeEstimate) -> f64 {
        if size.size() > 0.0 { size.size() / self.reference_size } else { 1.0 }
    }

    /// Where the fingers' bases are in the wrist frames, m: the robot's, and those of the human hand with `points`.
    pub fn bases(&self, robot: &Robot, points: &[DVec3; N_KEYPOINTS]) -> [DVec3; 2] {
        let mapped = robot.fingers.iter().map(|finger| finger.human).filter(|human| *human != 0);
        [self.bases, Hand::bases(points, mapped)]
    }

    /// Finds the pose, with no link in another, unless it costs `worth` or more without looking at all of them.
    ///
    /// # Errors
    /// If a value is not finite.
    pub fn solve(
        &mut self,
        solver: &mut Solver,
        robot: &mut Robot,
        stop: Stop,
        worth: f64,
        u: &mut [f64],
    ) -> Result<Solved> {
        let first = self.first_collision;
        self.problem.active.retain(|gap| *gap < first);
        self.problem.gaps[first..].iter_mut().for_each(|gap| gap.weight = 0.0);
        if !self.collisions.is_empty() {
            robot.coupling.expand(&robot.parts, u, robot.world.qpos_mut());
            robot.world.update_poses();
            self.watch(robot, WATCHED);
        }
        self.start.copy_from_slice(u);
        let Robot { world, parts, coupling, .. } = &mut *robot;
        let mut solved = solver.solve(&mut self.problem, world, parts, coupling, stop, u)?;
        for _ in 0..3 {
            // Links in the way make no pose better.
            if solved.cost >= worth || self.watch(robot, 0.0) == 0 {
                break;
            }
            // From within a link there may be no way out but through it: begin anew, with the link in the way.
            u.copy_from_slice(&self.start);
            let Robot { world, parts, coupling, .. } = &mut *robot;
            let more = solver.solve(&mut self.problem, world, parts, coupling, stop, u)?;
            solved = Solved { iterations: solved.iterations + more.iterations, ..more };
        }
        Ok(solved)
    }

    /// Finds a pose to start from, as if no link were in another's way and no finger met another.
    ///
    /// # Errors
    /// As [`Self::solve`].
    pub fn solve_open(&mut self, solver: &mut Solver, robot: &mut Robot, stop: Stop, u: &mut [f64]) -> Result<()> {
        let active = std::mem::take(&mut self.problem.active);
        let Robot { world, parts, coupling, .. } = &mut *robot;
        let solved = solver.solve(&mut self.problem, world, parts, coupling, stop, u);
        self.problem.active = active;
        solved.map(|_| ())
    }

    /// Has those pairs count that are nearer than a distance in the robot's present pose; returns how many were added.
    fn watch(&mut self, robot: &mut Robot, near: f64) -> usize {
        let mut added = 0;
        for (place, geom) in self.centres.iter_mut().zip(0..) {
            *place = robot.world.geom_place(geom);
        }
        for (gap, [a, b], radii) in self.collisions.iter().copied() {
            let reach = radii + near;
            if self.centres[a].distance_squared(self.centres[b]) > reach * reach || self.problem.gaps[gap].weight > 0.0
            {
                continue;
            }
            let target = self.problem.gaps[gap].target;
            if robot.world.geom_distance([a, b], near.max(target)).0 < near.max(target) {
                self.problem.weigh(gap, COLLISION_WEIGHT);
                added += 1;
            }
        }
        added
    }

    /// How deep links that must not collide are in each other in the robot's present pose, m; negative = none is.
    pub fn deepest(&self, robot: &mut Robot) -> f64 {
        let mut deepest = f64::NEG_INFINITY;
        for (_, [a, b], radii) in self.collisions.iter().copied() {
            if robot.world.geom_place(a).distance(robot.world.geom_place(b)) < radii {
                deepest = deepest.max(-robot.world.geom_distance([a, b], 1e-3).0);
            }
        }
        deepest
    }

    /// Distance of a finger's tip from its target in the robot's present pose, m.
    pub fn tip_error(&self, robot: &Robot, finger: usize) -> f64 {
        let vector = &self.problem.vectors[self.fingers[finger].tip];
        frame::place(&robot.world, &robot.fingers[finger]).distance(vector.target)
    }
}

fn problem_tip(fingers: &[FingerGoal], problem: &Problem, index: usize) -> usize {
    problem.vectors[fingers[index].tip].to
}

/// Which human bone each robot phalanx follows: (phalanx, human keypoints), the last ones paired first.
fn segments(count: usize, finger: usize) -> Vec<(usize, [usize; 2])> {
    let k = |joint: usize| keypoint(finger, joint);
    match count {
        0 => Vec::new(),
        1 => vec![(0, [k(0), k(3)])],
        2 => vec![(0, [k(0), k(1)]), (1, [k(1), k(3)])],
        _ => (0..3).map(|bone| (count - 3 + bone, [k(bone), k(bone + 1)])).collect(),
    }
}

/// Outward normal of a human fingertip's pad, in the wrist frame.
pub fn pad_normal(points: &[DVec3; N_KEYPOINTS], finger: usize) -> DVec3 {
    bone_normal(points, finger, 2)
}

/// Palmar normal of a finger's bone (0 from its base to 2 at its tip), in the wrist frame.
pub fn bone_normal(points: &[DVec3; N_KEYPOINTS], finger: usize, bone: usize) -> DVec3 {
    let [from, to] = [keypoint(finger, bone), keypoint(finger, bone + 1)];
    let along = (points[to] - points[from]).normalize_or_zero();
    let toward = match finger {
        // The thumb faces the fingers.
        0 => 0.5 * (points[keypoint(1, 2)] + points[keypoint(2, 2)]) - points[to],
        // Fingers bend about the radial axis: palmar = radial x distal.
        _ => DVec3::Y.cross(along),
    };
    let normal = toward.reject_from(if along == DVec3::ZERO { DVec3::Z } else { along });
    normal.try_normalize().unwrap_or(DVec3::X)
}

/// Axes of a human bone in the wrist frame: columns normal, lateral, along.
pub fn bone_axes(points: &[DVec3; N_KEYPOINTS], finger: usize, bone: usize) -> DMat3 {
    let along =
        (points[keypoint(finger, bone + 1)] - points[keypoint(finger, bone)]).try_normalize().unwrap_or(DVec3::Z);
    let normal = bone_normal(points, finger, bone);
    DMat3::from_cols(normal, along.cross(normal), along)
}
