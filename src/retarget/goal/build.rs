//! Construction of a goal: all terms that may ever count, without weights.

use glam::DVec3;

use super::fingertip::TipBall;
use super::{CollisionTerm, Facing, FingerGoal, Goal, METRES_PER_RADIAN, PhalanxTerm};
use crate::error::Result;
use crate::retarget::human::{self, Hand, keypoint};
use crate::retarget::problem::{GapSide, Problem, Vector};
use crate::retarget::robot::Robot;
use crate::retarget::robot::fingers::Finger;
use crate::retarget::solver::Solver;

/// Error of a fingertip beyond which its cost grows linearly, m: a target out of reach must not outweigh all others.
const TIP_HUBER: f64 = 0.03;

impl Goal {
    /// Allocates all terms for a robot in its rest pose.
    ///
    /// # Errors
    /// Never with the built-in hand, whose size is the reference.
    pub fn new(robot: &Robot) -> Result<Self> {
        let mut problem = Problem::new(&robot.world, &robot.parts, &robot.coupling);
        let mut fingers: Vec<FingerGoal> =
            robot.fingers.iter().map(|finger| finger_goal(&mut problem, robot, finger)).collect();
        add_pinches(&mut problem, robot, &mut fingers);
        add_holds(&mut problem, robot, &mut fingers);
        let first_collision = problem.gaps.len();
        let collisions = collision_terms(&mut problem, robot);
        let is_mapped = |finger: &Finger| finger.human != 0 || robot.fingers.len() == 1;
        Ok(Self {
            solver: Solver::new(robot.coupling.len()),
            bases: robot.bases(is_mapped),
            first_collision,
            centres: vec![DVec3::ZERO; robot.parts.geoms.len()],
            problem,
            fingers,
            collisions,
            reference_size: human::size(&Hand::reference()?.points),
            start: robot.rest.clone(),
            neutral: neutral_positions(robot),
        })
    }
}

/// Adds the terms of one finger alone: tip, phalanges and pad.
fn finger_goal(problem: &mut Problem, robot: &Robot, finger: &Finger) -> FingerGoal {
    let tip_point = problem.add_point(finger.tip_body, finger.tip);
    let tip = add_vector(problem, Vector::idle(None, tip_point, TIP_HUBER));
    let mut points: Vec<(usize, DVec3)> = Vec::new();
    for joint in &finger.knuckles {
        let body = robot.parts.joints[*joint].body;
        let (origin, rotation) = robot.world.body_pose(body);
        let anchor = robot.world.joint_axis(*joint).0;
        points.push((problem.add_point(body, rotation.transpose() * (anchor - origin)), anchor));
    }
    points.push((tip_point, finger.tip_position(&robot.world)));
    let mut phalanges = Vec::new();
    for (phalanx, bone) in bones_of_phalanges(points.len() - 1, finger.human) {
        let [(from, a), (to, b)] = [points[phalanx], points[phalanx + 1]];
        let vector = add_vector(problem, Vector::idle(Some(from), to, f64::INFINITY));
        phalanges.push(PhalanxTerm { vector, bone, length: a.distance(b) });
    }
    let ahead = problem.add_point(finger.tip_body, finger.tip + METRES_PER_RADIAN * finger.pad_normal);
    let pad = add_vector(problem, Vector::idle(Some(tip_point), ahead, f64::INFINITY));
    FingerGoal {
        human: finger.human,
        tip_point,
        tip,
        phalanges,
        pad,
        pinch: None,
        facing: None,
        hold: None,
        base: robot.base(finger),
        length: finger.length,
        scale: robot.scale[finger.human],
    }
}

/// Adds the terms of each finger with the thumb: their gap, and the direction in which they face each other.
fn add_pinches(problem: &mut Problem, robot: &Robot, fingers: &mut [FingerGoal]) {
    let Some(thumb) = robot.fingers.iter().position(|finger| finger.human == 0) else { return };
    let pad = |index: usize| GapSide::Geoms {
        body: robot.fingers[index].tip_body,
        geoms: robot.fingers[index].pad_geoms.clone(),
    };
    let ball_of_thumb = TipBall::fit(robot, &robot.fingers[thumb]);
    let thumb_point = fingers[thumb].tip_point;
    for index in (0..fingers.len()).filter(|index| *index != thumb) {
        // A point and geoms have no common distance: if one tip has no geoms, both count as points.
        let has_geoms = [thumb, index].iter().all(|index| !robot.fingers[*index].pad_geoms.is_empty());
        let sides = match has_geoms {
            true => [pad(thumb), pad(index)],
            false => [thumb_point, fingers[index].tip_point].map(|point| GapSide::Sphere { point, radius: 0.0 }),
        };
        fingers[index].pinch = Some(problem.add_gap(sides, false));
        // A point has no side from which it can be touched.
        let (Some(from), Some(to)) = (ball_of_thumb, TipBall::fit(robot, &robot.fingers[index])) else { continue };
        let length = from.radius + to.radius;
        let from = problem.add_point(robot.fingers[thumb].tip_body, from.centre);
        let to = problem.add_point(robot.fingers[index].tip_body, to.centre);
        let vector = add_vector(problem, Vector::idle(Some(from), to, f64::INFINITY));
        fingers[index].facing = Some(Facing { vector, length });
    }
}

/// Adds the gap of each pad to the object.
fn add_holds(problem: &mut Problem, robot: &Robot, fingers: &mut [FingerGoal]) {
    let Some(object) = &robot.object else { return };
    for (goal, finger) in fingers.iter_mut().zip(&robot.fingers).filter(|(_, f)| !f.pad_geoms.is_empty()) {
        let pad = GapSide::Geoms { body: finger.tip_body, geoms: finger.pad_geoms.clone() };
        let whole = GapSide::Geoms { body: object.body, geoms: object.geoms.clone() };
        goal.hold = Some(problem.add_gap([pad, whole], false));
    }
}

/// Adds the gaps of all pairs of geoms that must not penetrate each other.
fn collision_terms(problem: &mut Problem, robot: &Robot) -> Vec<CollisionTerm> {
    let finger_of_tip = |geom: usize| robot.fingers.iter().find(|finger| finger.pad_geoms.contains(&geom));
    // The gap of thumb and fingertip is a pinch.
    let is_pinch = |[a, b]: [usize; 2]| match (finger_of_tip(a), finger_of_tip(b)) {
        (Some(a), Some(b)) => a.human == 0 || b.human == 0,
        _ => false,
    };
    let margin = robot.spec.collision.margin;
    let links = robot.collision_pairs.iter().copied().filter(|pair| !is_pinch(*pair)).map(|pair| (pair, margin));
    // Links touch an object that is held: no margin.
    let object = robot.object_pairs().into_iter().map(|pair| (pair, 0.0));
    let mut term = |([a, b], target): ([usize; 2], f64)| {
        let side = |geom: usize| GapSide::Geoms { body: robot.parts.geoms[geom].body, geoms: vec![geom] };
        let gap = problem.add_gap([side(a), side(b)], true);
        problem.gaps[gap].target = target;
        CollisionTerm { gap, geoms: [a, b], radii: robot.parts.geoms[a].radius + robot.parts.geoms[b].radius }
    };
    links.chain(object).map(&mut term).collect()
}

/// Returns the neutral position of each free coordinate: that of the file, or of the rest pose.
fn neutral_positions(robot: &Robot) -> Vec<f64> {
    let position = |(rest, master): (&f64, &usize)| {
        robot.spec.neutral.get(&robot.parts.joints[*master].name).copied().unwrap_or(*rest)
    };
    robot.rest.iter().zip(&robot.coupling.masters).map(position).collect()
}

fn add_vector(problem: &mut Problem, vector: Vector) -> usize {
    problem.vectors.push(vector);
    problem.vectors.len() - 1
}

/// Returns the human bone (its two keypoints) that each robot phalanx follows, paired from the tip: (phalanx, bone).
fn bones_of_phalanges(count: usize, finger: usize) -> Vec<(usize, [usize; 2])> {
    let k = |joint: usize| keypoint(finger, joint);
    match count {
        0 => Vec::new(),
        1 => vec![(0, [k(0), k(3)])],
        2 => vec![(0, [k(0), k(1)]), (1, [k(1), k(3)])],
        _ => (0..3).map(|bone| (count - 3 + bone, [k(bone), k(bone + 1)])).collect(),
    }
}
