//! Drives one hand along its script: places by inverse kinematics once, then servo targets in time.
//!
//! A site with a force goal is pushed by `J^T F` at its servos, corrected by what the contact is measured to carry, so
//! that the same script closes on an object of any size until it is touched, and presses as hard as asked.

use glam::{DQuat, DVec3, EulerRot};
use parry3d::math::Pose;

use super::convex;
use super::ik::{self, Clearance, Freedom, Reach};
use super::mjcf::{WRIST, WRIST_STIFFNESS};
use super::object::Object;
use super::randomize::{Act, Goal, HandDraw};
use super::rig::{HandRig, Hinge, JOINT_NAMES, Motion, base_joint, site_of};
use super::scene::Site;
use crate::error::Result;
use crate::mujoco::World;
use crate::mujoco::world::{Body, Servo, Skin};

/// Openings at which the fingers' places are solved; between them angles are interpolated.
const OPENINGS: usize = 4;
/// Distance that links without a goal of their own keep from the object, so that the pads touch first, m.
const LINK_MARGIN: f64 = 0.002;
/// Share of the opening that every part of the hand keeps from the object.
const SHARE_OF_OPENING: f64 = 0.6;
/// Seconds in which a missing force is made up.
const FORCE_LAG: f64 = 0.15;
/// The correction is at most this many times the goal.
const MOST_CORRECTION: f64 = 1.5;
/// Height of the table's top that the hand keeps away from when its place is chosen, m.
const TABLE_CLEARANCE: f64 = 0.004;

/// Angles of a finger that has closed around nothing, from the knuckle on, rad.
const CLOSED: [f64; 3] = [1.45, 1.6, 1.0];
/// Share of the knuckle's torque that the hinges of a wrapping finger have, from the knuckle on.
const WRAP_SHARES: [f64; 3] = [1.0, 0.7, 0.45];

/// A hand in a world, with its plan.
#[derive(Debug)]
pub struct HandDriver {
    wrist: [Servo; 6],
    hinges: Vec<Servo>,
    wrist_body: Body,
    bodies: Vec<Body>,
    skin: Skin,
    /// Place and orientation of the wrist where its servos are at zero.
    zero: (DVec3, DQuat),
    wraps: Vec<Wrap>,
    plan: Plan,
}

/// What a hand deals with, at its start.
#[derive(Debug, Clone, Copy)]
pub struct Target<'a> {
    /// Its body; `None` for a place that is not solid.
    pub body: Option<Body>,
    /// Its shape.
    pub shape: &'a Object,
    /// Its place, m.
    pub position: DVec3,
    /// Its orientation.
    pub orientation: DQuat,
}

/// A hinge of a wrapping finger.
#[derive(Debug, Clone, Copy)]
struct Wrap {
    /// Index into the hinges.
    hinge: usize,
    /// Angle when closed, rad.
    closed: f64,
    /// How far the servo's target may lead the hinge, rad: torque over stiffness.
    lead: f64,
}

#[derive(Debug)]
struct Plan {
    /// Largest opening of the script, m.
    widest: f64,
    /// Positions of wrist and hinges at openings from 0 to `widest`; one entry when the hand is idle.
    places: Vec<Vec<f64>>,
    act: Option<Act>,
    /// Upright axis of twists: a point on it, m.
    pivot: DVec3,
    object: Option<Body>,
    pushes: Vec<Push>,
}

/// How a goal's force is made.
#[derive(Debug)]
struct Push {
    goal: Goal,
    bodies: Vec<Body>,
    /// Servo targets' change per newton: index into wrist (0..6) or hinges (6..).
    per_newton: Vec<(usize, f64)>,
    /// Integrated correction, N.
    correction: f64,
}

impl HandDriver {
    /// Resolves the hand in `world` and solves its places; the world is left in the hand's start pose.
    ///
    /// # Errors
    /// If the world was not made from this hand.
    pub fn new(world: &mut World, hand: &HandDraw, rig: &HandRig, objects: &[Target]) -> Result<Self> {
        let servo = |name: &str| world.servo(&rig.name(name));
        let wrist = WRIST.map(servo);
        let mut servos = Vec::new();
        for result in wrist {
            servos.push(result?);
        }
        let wrist: [Servo; 6] = std::array::from_fn(|i| servos[i]);
        let hinges = rig.hinges.iter().map(|h| world.servo(&rig.name(&h.name))).collect::<Result<Vec<_>>>()?;
        let bodies = JOINT_NAMES.iter().map(|name| world.body(&rig.name(name))).collect::<Result<Vec<_>>>()?;
        let idle = Plan {
            widest: 0.0,
            places: vec![[0.0; 6].iter().chain(&hand.posture).copied().collect()],
            act: None,
            pivot: DVec3::ZERO,
            object: None,
            pushes: Vec::new(),
        };
        let zero = (hand.wrist, hand.orientation);
        let skin = world.skin(&rig.name("skin"))?;
        let mut driver =
            Self { skin, wrist, hinges, wrist_body: bodies[0], bodies, zero, wraps: wraps(hand, rig), plan: idle };
        if let Some(act) = &hand.act {
            driver.plan = driver.solve(world, hand, act, rig, &objects[act.object]);
        }
        let targets = driver.targets(world, 0.0);
        for (servo, target) in driver.servos().zip(&targets) {
            world.set_joint_position(servo, *target);
        }
        driver.apply(world, &targets);
        Ok(driver)
    }

    /// The hand's skin.
    pub fn skin(&self) -> Skin {
        self.skin
    }

    /// Body of the wrist.
    pub fn wrist(&self) -> Body {
        self.wrist_body
    }

    /// Bodies of the links in MANO's order of joints.
    pub fn links(&self) -> &[Body] {
        &self.bodies
    }

    /// Hinge angles as they are, in the rig's order, rad.
    pub fn angles(&self, world: &World) -> Vec<f64> {
        self.hinges.iter().map(|servo| world.joint_position(*servo)).collect()
    }

    /// Sets the servos for the next `interval` seconds.
    pub fn drive(&mut self, world: &mut World, interval: f64) {
        let time = world.time();
        if let Some(act) = &self.plan.act {
            let squeeze = act.timeline.at(time).squeeze;
            for push in &mut self.plan.pushes {
                if squeeze <= 0.0 {
                    push.correction = 0.0;
                    continue;
                }
                // At a place that is not solid, whatever is there is meant: the other hand.
                let object = self.plan.object;
                let meant = |body: Body| object.map_or(!self.bodies.contains(&body), |object| object == body);
                let touches = |c: &crate::mujoco::Contact| {
                    let [a, b] = c.bodies;
                    (push.bodies.contains(&a) && meant(b)) || (push.bodies.contains(&b) && meant(a))
                };
                let measured: f64 = world.contacts().filter(touches).map(|c| c.normal_force).sum();
                let most = MOST_CORRECTION * push.goal.force;
                let missing = squeeze * push.goal.force - measured;
                push.correction = (push.correction + missing * interval / FORCE_LAG).clamp(-most, most);
            }
        }
        let targets = self.targets(world, time);
        self.apply(world, &targets);
    }

    /// Puts the hand where its plan has it at `time`, s, without servos or forces.
    pub fn place(&self, world: &mut World, time: f64) {
        let targets = self.targets(world, time);
        for (servo, target) in self.servos().zip(&targets) {
            world.set_joint_position(servo, *target);
        }
    }

    fn servos(&self) -> impl Iterator<Item = Servo> + '_ {
        self.wrist.iter().chain(&self.hinges).copied()
    }

    fn apply(&self, world: &mut World, targets: &[f64]) {
        for (servo, target) in self.servos().zip(targets) {
            world.set_target(servo, *target);
        }
    }

    /// Servo targets at `time`: wrist, then hinges.
    fn targets(&self, world: &World, time: f64) -> Vec<f64> {
        let plan = &self.plan;
        let Some(act) = &plan.act else {
            return plan.places[0].clone();
        };
        let channels = act.timeline.at(time);
        let place = (channels.opening / plan.widest).clamp(0.0, 1.0) * (plan.places.len() - 1) as f64;
        let low = (place as usize).min(plan.places.len().saturating_sub(2));
        let high = (low + 1).min(plan.places.len() - 1);
        let part = place - low as f64;
        let between = plan.places[low].iter().zip(&plan.places[high]).map(|(a, b)| a + (b - a) * part);
        let mut targets: Vec<f64> = between.collect();
        for wrap in self.wraps.iter().filter(|_| channels.wrap > 0.0) {
            let target = &mut targets[6 + wrap.hinge];
            let closing = *target + channels.wrap * (wrap.closed - *target);
            *target = closing.min(world.joint_position(self.hinges[wrap.hinge]) + wrap.lead);
        }
        if channels.twist != 0.0 {
            self.twist(channels.twist, &mut targets);
        }
        let displacement = act.from * channels.standoff + channels.shift;
        for axis in 0..3 {
            targets[axis] += displacement[axis];
        }
        for push in &plan.pushes {
            let force = channels.squeeze * push.goal.force + push.correction;
            for (index, per_newton) in &push.per_newton {
                targets[*index] += force * per_newton;
            }
        }
        targets
    }

    /// Turns the wrist's targets by `angle` about the upright axis through the pivot.
    fn twist(&self, angle: f64, targets: &mut [f64]) {
        let turn = DQuat::from_rotation_z(angle);
        let (origin, orientation) = self.zero;
        let position = origin + DVec3::new(targets[0], targets[1], targets[2]);
        let moved = self.plan.pivot + turn * (position - self.plan.pivot) - origin;
        // The wrist's hinges turn about the hand's own axes, the first outermost.
        let own = DQuat::from_euler(EulerRot::XYZ, targets[3], targets[4], targets[5]);
        let (x, y, z) = (orientation.inverse() * turn * orientation * own).to_euler(EulerRot::XYZ);
        targets[..6].copy_from_slice(&[moved.x, moved.y, moved.z, x, y, z]);
    }

    fn solve(&self, world: &mut World, hand: &HandDraw, act: &Act, rig: &HandRig, target: &Target) -> Plan {
        let pose: Pose = convex::pose(target.position, target.orientation);
        let mut clearance = Clearance {
            obstacles: target.body.map_or_else(Vec::new, |_| target.shape.obstacles(&pose)),
            margin: LINK_MARGIN,
            pads: act.goals.iter().map(|goal| rig.pad(goal.site).joint).collect(),
            pad_margin: 0.0,
            rig,
            links: &self.bodies,
            pairs: rig.colliding(),
            height: TABLE_CLEARANCE,
        };
        let reach = |goal: &Goal, opening: f64| {
            let pad = rig.pad(goal.site);
            Reach { body: self.bodies[pad.joint], pad, point: goal.point + goal.normal * opening, normal: goal.normal }
        };
        let hinge = |index: usize| Freedom {
            servo: self.hinges[index],
            rest: hand.posture[index],
            slack: 0.5,
            range: rig.hinges[index].range,
        };
        for (servo, angle) in self.hinges.iter().zip(&hand.posture) {
            world.set_joint_position(*servo, *angle);
        }
        // At the object: wrist and fingers together.
        let slides = self.wrist[..3].iter().map(|s| Freedom { servo: *s, rest: 0.0, slack: 0.1, range: [-0.5, 0.5] });
        let turns = self.wrist[3..].iter().map(|s| Freedom { servo: *s, rest: 0.0, slack: 0.25, range: [-1.2, 1.2] });
        let all: Vec<Freedom> = slides.chain(turns).chain((0..self.hinges.len()).map(hinge)).collect();
        let reaches: Vec<Reach> = act.goals.iter().map(|goal| reach(goal, 0.0)).collect();
        let touch = ik::solve(world, &all, &reaches, &clearance, 120);
        let pushes = act.goals.iter().map(|goal| self.push(world, goal, rig)).collect();

        // Away from it: the wrist and the fingers with goals, from one opening to the next.
        let has_goal = |hinge: &Hinge| act.goals.iter().any(|goal| goal.site == hinge.site);
        let hinges = rig.hinges.iter().enumerate().filter(|(_, hinge)| has_goal(hinge)).map(|(i, _)| 6 + i);
        let moving: Vec<usize> = (0..6).chain(hinges).collect();
        let widest = act.timeline.widest_opening().max(1e-3);
        let mut places = vec![touch];
        for step in 1..OPENINGS {
            let opening = widest * step as f64 / (OPENINGS - 1) as f64;
            let mut place = places[step - 1].clone();
            // The whole hand keeps away, not only the pads.
            clearance.pad_margin = SHARE_OF_OPENING * opening;
            clearance.margin = clearance.pad_margin.max(LINK_MARGIN);
            // Near the last solution rather than the posture, so that the way between them is short; and rather with
            // the fingers than with the wrist.
            let near = |i: usize| match i {
                0..3 => Freedom { rest: place[i], slack: 0.01, ..all[i] },
                3..6 => Freedom { rest: place[i], slack: 0.1, ..all[i] },
                _ => Freedom { rest: place[i], ..all[i] },
            };
            let free: Vec<Freedom> = moving.iter().map(|i| near(*i)).collect();
            let reaches: Vec<Reach> = act.goals.iter().map(|goal| reach(goal, opening)).collect();
            let solved = ik::solve(world, &free, &reaches, &clearance, 60);
            for (index, position) in moving.iter().zip(solved) {
                place[*index] = position;
            }
            places.push(place);
        }
        Plan { widest, places, act: Some(act.clone()), pivot: target.position, object: target.body, pushes }
    }

    /// Servo changes that press a goal's site against the surface with 1 N, at the present pose.
    fn push(&self, world: &World, goal: &Goal, rig: &HandRig) -> Push {
        let pad = rig.pad(goal.site);
        let body = self.bodies[pad.joint];
        let inward = -goal.normal;
        let per_newton = if goal.site == Site::Palm {
            (0..3).map(|axis| (axis, inward[axis] / WRIST_STIFFNESS)).collect()
        } else {
            let own: Vec<usize> = (0..self.hinges.len()).filter(|i| rig.hinges[*i].site == goal.site).collect();
            let servos: Vec<Servo> = own.iter().map(|i| self.hinges[*i]).collect();
            let point = world.position(body) + world.orientation(body) * pad.position;
            let columns = world.jacobian(body, point, &servos);
            let torque = own
                .iter()
                .zip(columns)
                .map(|(i, column): (_, DVec3)| (6 + i, column.dot(inward) / rig.hinges[*i].stiffness));
            torque.collect()
        };
        let bodies = (0..JOINT_NAMES.len()).filter(|j| site_of(*j) == goal.site).map(|j| self.bodies[j]).collect();
        Push { goal: *goal, bodies, per_newton, correction: 0.0 }
    }
}

/// Hinges of the fingers that wrap.
fn wraps(hand: &HandDraw, rig: &HandRig) -> Vec<Wrap> {
    let Some((fingers, torque)) = &hand.wrap else {
        return Vec::new();
    };
    let flexing = rig.hinges.iter().enumerate().filter(|(_, hinge)| hinge.motion == Motion::Flex);
    let wrapping = flexing.filter(|(_, hinge)| fingers.contains(&hinge.site));
    let wrap = |(index, hinge): (usize, &Hinge)| {
        let place = hinge.joint - base_joint(hinge.site);
        let closed = if hinge.site == Site::Thumb { 0.9 } else { CLOSED[place] };
        let lead = torque * WRAP_SHARES[place] / hinge.stiffness;
        Wrap { hinge: index, closed: closed.clamp(hinge.range[0], hinge.range[1]), lead }
    };
    wrapping.map(wrap).collect()
}
