//! Hand drivers: solve the poses of a script by inverse kinematics once, then set servo targets in time.
//!
//! A site with a force goal is pushed by `J^T F` at its servos, corrected by the measured contact force: the same
//! script closes on an object of any size until it touches, and presses with the goal's force.

mod force_control;

use glam::{DQuat, DVec3, EulerRot};
use parry3d::math::Pose;

use self::force_control::ForceControl;
use super::convex;
use super::ik::{self, Clearance, JointVariable, PadTarget};
use super::mjcf::{WRIST, WRIST_STIFFNESS};
use super::object::Object;
use super::randomize::{ActDraw, ContactGoal, HandDraw};
use super::rig::{HandRig, Hinge, HingeMotion, JOINT_NAMES, base_joint, site_of};
use super::scene::HandSite;
use super::timeline::{ChannelValues, Ramp};
use crate::error::Result;
use crate::mujoco::World;
use crate::mujoco::world::{Body, Servo, Skin};

/// Number of openings at which poses are solved; joint positions between them are interpolated.
const SOLVED_OPENINGS: usize = 4;
/// Smallest opening that poses are solved for, m: it avoids a division by zero for scripts without opening.
const MIN_WIDEST_OPENING: f64 = 1e-3;
/// Distance between the object and links without a goal, m: the pads touch first.
const LINK_MARGIN: f64 = 0.002;
/// Distance of the whole hand from the object, as a share of the opening.
const OPENING_MARGIN_SHARE: f64 = 0.6;
/// Smallest height of the hand above the table in solved poses, m.
const TABLE_CLEARANCE: f64 = 0.004;
/// Iterations of the solver for the pose at the object, and for each pose at an opening.
const TOUCH_ITERATIONS: usize = 120;
const OPENING_ITERATIONS: usize = 60;

/// Hinge angles of a finger closed around nothing, from the knuckle on, rad.
const CLOSED_FINGER: [f64; 3] = [1.45, 1.6, 1.0];
/// Hinge angle of a closed thumb, rad.
const CLOSED_THUMB: f64 = 0.9;
/// Torques of a wrapping finger's hinges as shares of the knuckle's, from the knuckle on.
const WRAP_TORQUE_SHARES: [f64; 3] = [1.0, 0.7, 0.45];

/// Driver of a hand in a world, with its motion plan.
#[derive(Debug)]
pub struct HandDriver {
    wrist: [Servo; 6],
    hinges: Vec<Servo>,
    wrist_body: Body,
    /// Bodies of the links in MANO's order of joints.
    links: Vec<Body>,
    skin: Skin,
    /// Position and orientation of the wrist with its servos at zero.
    zero: (DVec3, DQuat),
    wrap_hinges: Vec<WrapHinge>,
    plan: MotionPlan,
    /// Command in place of the script.
    command: Option<Ramp>,
}

/// Object that a hand touches, at its start.
#[derive(Debug, Clone, Copy)]
pub struct TargetObject<'a> {
    /// Body; `None` for an object that is not solid.
    pub body: Option<Body>,
    /// Shape.
    pub shape: &'a Object,
    /// Position, m.
    pub position: DVec3,
    /// Orientation.
    pub orientation: DQuat,
}

/// Hinge of a wrapping finger.
#[derive(Debug, Clone, Copy)]
struct WrapHinge {
    /// Index into the hinges.
    hinge: usize,
    /// Angle when closed, rad.
    closed: f64,
    /// Largest lead of the servo's target over the hinge, rad: torque limit over stiffness.
    lead: f64,
}

/// Planned motion of a hand.
#[derive(Debug)]
struct MotionPlan {
    /// Largest opening of the script, m.
    widest: f64,
    /// Positions of wrist and hinges, m and rad, at evenly spaced openings from 0 to `widest`; one entry if the hand is
    /// idle.
    poses: Vec<Vec<f64>>,
    /// `None` = idle.
    act: Option<ActDraw>,
    /// Point on the upright axis of twists, m.
    pivot: DVec3,
    /// Body of the touched object; `None` = a place to reach, at which the other hand is touched.
    object: Option<Body>,
    force_controls: Vec<ForceControl>,
}

impl MotionPlan {
    /// Creates the plan of a hand that keeps its rest pose.
    fn idle(posture: &[f64]) -> Self {
        Self {
            widest: 0.0,
            poses: vec![[0.0; 6].iter().chain(posture).copied().collect()],
            act: None,
            pivot: DVec3::ZERO,
            object: None,
            force_controls: Vec::new(),
        }
    }

    /// Interpolates the solved poses at an opening, m.
    fn pose_at(&self, opening: f64) -> Vec<f64> {
        let place = (opening / self.widest).clamp(0.0, 1.0) * (self.poses.len() - 1) as f64;
        let low = (place as usize).min(self.poses.len().saturating_sub(2));
        let high = (low + 1).min(self.poses.len() - 1);
        let part = place - low as f64;
        self.poses[low].iter().zip(&self.poses[high]).map(|(a, b)| a + (b - a) * part).collect()
    }
}

impl HandDriver {
    /// Finds the hand in `world` and solves the poses of its script; the hand is left in its start pose.
    ///
    /// # Errors
    /// If the world was not made from this hand.
    pub fn new(world: &mut World, hand: &HandDraw, rig: &HandRig, objects: &[TargetObject]) -> Result<Self> {
        let wrist = WRIST.iter().map(|name| world.servo(&rig.name(name))).collect::<Result<Vec<_>>>()?;
        let hinges = rig.hinges.iter().map(|h| world.servo(&rig.name(&h.name))).collect::<Result<Vec<_>>>()?;
        let links = JOINT_NAMES.iter().map(|name| world.body(&rig.name(name))).collect::<Result<Vec<_>>>()?;
        let mut driver = Self {
            skin: world.skin(&rig.name("skin"))?,
            wrist: std::array::from_fn(|i| wrist[i]),
            hinges,
            wrist_body: links[0],
            links,
            zero: (hand.wrist, hand.orientation),
            wrap_hinges: wrap_hinges(hand, rig),
            plan: MotionPlan::idle(&hand.posture),
            command: None,
        };
        if let Some(act) = &hand.act {
            driver.plan = driver.solve(world, hand, act, rig, &objects[act.object]);
        }
        let targets = driver.targets(world, 0.0);
        driver.set_positions(world, &targets);
        driver.set_targets(world, &targets);
        Ok(driver)
    }

    /// Returns the hand's skin.
    pub fn skin(&self) -> Skin {
        self.skin
    }

    /// Returns the body of the wrist.
    pub fn wrist(&self) -> Body {
        self.wrist_body
    }

    /// Returns the bodies of the links in MANO's order of joints.
    pub fn links(&self) -> &[Body] {
        &self.links
    }

    /// Returns the current hinge angles in the rig's order, rad.
    pub fn angles(&self, world: &World) -> Vec<f64> {
        self.hinges.iter().map(|servo| world.joint_position(*servo)).collect()
    }

    /// Sets the servo targets for the next `interval` seconds.
    pub fn drive(&mut self, world: &mut World, interval: f64) {
        let time = world.time();
        // A command is open loop: the measured force would tell its sender what no sensor has told.
        if let (Some(act), None) = (&self.plan.act, &self.command) {
            let squeeze = act.timeline.at(time).squeeze;
            let object = self.plan.object;
            // At a place to reach, contact with anything but this hand counts: the other hand.
            let is_target = |body: Body| object.map_or(!self.links.contains(&body), |object| object == body);
            for control in &mut self.plan.force_controls {
                control.update(world, squeeze, interval, is_target);
            }
        }
        let targets = self.targets(world, time);
        self.set_targets(world, &targets);
    }

    /// Replaces the script from now on: the channels change linearly to `to` over `seconds` and then stay. Returns false if
    /// the hand has no act, and so no channels.
    pub fn command(&mut self, now: f64, seconds: f64, to: ChannelValues) -> bool {
        let Some(act) = &self.plan.act else { return false };
        let from = self.channels(act, now);
        self.plan.force_controls.iter_mut().for_each(|control| control.correction = 0.0);
        self.command = Some(Ramp { from, to, begin: now, seconds });
        true
    }

    /// Moves the hand to its planned pose at `time`, s, without servos and forces.
    pub fn place(&self, world: &mut World, time: f64) {
        let targets = self.targets(world, time);
        self.set_positions(world, &targets);
    }

    /// Iterates over the servos: wrist, then hinges.
    fn servos(&self) -> impl Iterator<Item = Servo> + '_ {
        self.wrist.iter().chain(&self.hinges).copied()
    }

    fn set_positions(&self, world: &mut World, positions: &[f64]) {
        for (servo, position) in self.servos().zip(positions) {
            world.set_joint_position(servo, *position);
        }
    }

    fn set_targets(&self, world: &mut World, targets: &[f64]) {
        for (servo, target) in self.servos().zip(targets) {
            world.set_target(servo, *target);
        }
    }

    /// Returns the channels at `time`, s: those of the command, or of the script without one.
    fn channels(&self, act: &ActDraw, time: f64) -> ChannelValues {
        self.command.map_or_else(|| act.timeline.at(time), |command| command.at(time))
    }

    /// Computes the servo targets at `time`, s: wrist, then hinges, m and rad.
    fn targets(&self, world: &World, time: f64) -> Vec<f64> {
        let plan = &self.plan;
        let Some(act) = &plan.act else {
            return plan.poses[0].clone();
        };
        let channels = self.channels(act, time);
        let mut targets = plan.pose_at(channels.opening);
        for wrap in self.wrap_hinges.iter().filter(|_| channels.wrap > 0.0) {
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
        for control in &plan.force_controls {
            let force = channels.squeeze * control.goal.force + control.correction;
            for (index, per_newton) in &control.per_newton {
                targets[*index] += force * per_newton;
            }
        }
        targets
    }

    /// Rotates the wrist's targets by `angle`, rad, about the upright axis through the pivot.
    fn twist(&self, angle: f64, targets: &mut [f64]) {
        let turn = DQuat::from_rotation_z(angle);
        let (origin, orientation) = self.zero;
        let position = origin + DVec3::new(targets[0], targets[1], targets[2]);
        let moved = self.plan.pivot + turn * (position - self.plan.pivot) - origin;
        // The wrist's hinges turn about the hand's axes, the first outermost.
        let own = DQuat::from_euler(EulerRot::XYZ, targets[3], targets[4], targets[5]);
        let (x, y, z) = (orientation.inverse() * turn * orientation * own).to_euler(EulerRot::XYZ);
        targets[..6].copy_from_slice(&[moved.x, moved.y, moved.z, x, y, z]);
    }

    /// Plans an act: poses from the object outwards, force controls at the object.
    fn solve(
        &self,
        world: &mut World,
        hand: &HandDraw,
        act: &ActDraw,
        rig: &HandRig,
        target: &TargetObject,
    ) -> MotionPlan {
        let mut clearance = self.clearance(act, rig, target);
        let variables = self.variables(hand, rig);
        for (servo, angle) in self.hinges.iter().zip(&hand.posture) {
            world.set_joint_position(*servo, *angle);
        }
        let touch = ik::solve(world, &variables, &self.pad_targets(act, rig, 0.0), &clearance, TOUCH_ITERATIONS);
        let force_controls = act.goals.iter().map(|goal| self.force_control(world, goal, rig)).collect();

        // Only the wrist and the fingers with goals open.
        let has_goal = |hinge: &Hinge| act.goals.iter().any(|goal| goal.site == hinge.site);
        let hinges = rig.hinges.iter().enumerate().filter(|(_, hinge)| has_goal(hinge)).map(|(i, _)| 6 + i);
        let moving: Vec<usize> = (0..6).chain(hinges).collect();
        let widest = act.timeline.widest_opening().max(MIN_WIDEST_OPENING);
        let mut poses = vec![touch];
        for step in 1..SOLVED_OPENINGS {
            let opening = widest * step as f64 / (SOLVED_OPENINGS - 1) as f64;
            let mut pose = poses[step - 1].clone();
            // The whole hand moves away, not only the pads.
            clearance.pad_margin = OPENING_MARGIN_SHARE * opening;
            clearance.margin = clearance.pad_margin.max(LINK_MARGIN);
            let free: Vec<JointVariable> = moving.iter().map(|i| near_pose(*i, variables[*i], &pose)).collect();
            let targets = self.pad_targets(act, rig, opening);
            let solved = ik::solve(world, &free, &targets, &clearance, OPENING_ITERATIONS);
            for (index, position) in moving.iter().zip(solved) {
                pose[*index] = position;
            }
            poses.push(pose);
        }
        MotionPlan {
            widest,
            poses,
            act: Some(act.clone()),
            pivot: target.position,
            object: target.body,
            force_controls,
        }
    }

    /// Returns the clearance at the object, where the pads touch it.
    fn clearance<'a>(&'a self, act: &ActDraw, rig: &'a HandRig, target: &TargetObject) -> Clearance<'a> {
        let pose: Pose = convex::pose(target.position, target.orientation);
        Clearance {
            obstacles: target.body.map_or_else(Vec::new, |_| target.shape.obstacles(&pose)),
            margin: LINK_MARGIN,
            pads: act.goals.iter().map(|goal| rig.pad(goal.site).joint).collect(),
            pad_margin: 0.0,
            rig,
            links: &self.links,
            pairs: rig.colliding(),
            height: TABLE_CLEARANCE,
        }
    }

    /// Returns the joints that the solver may move: wrist slides, wrist hinges, finger hinges.
    fn variables(&self, hand: &HandDraw, rig: &HandRig) -> Vec<JointVariable> {
        let slide = |servo: &Servo| JointVariable { servo: *servo, rest: 0.0, slack: 0.1, range: [-0.5, 0.5] };
        let turn = |servo: &Servo| JointVariable { servo: *servo, rest: 0.0, slack: 0.25, range: [-1.2, 1.2] };
        let hinge = |index: usize| JointVariable {
            servo: self.hinges[index],
            rest: hand.posture[index],
            slack: 0.5,
            range: rig.hinges[index].range,
        };
        let wrist = self.wrist[..3].iter().map(slide).chain(self.wrist[3..].iter().map(turn));
        wrist.chain((0..self.hinges.len()).map(hinge)).collect()
    }

    /// Returns the pads' targets at an opening, m.
    fn pad_targets(&self, act: &ActDraw, rig: &HandRig, opening: f64) -> Vec<PadTarget> {
        let target = |goal: &ContactGoal| {
            let (pad, point) = (rig.pad(goal.site), goal.point + goal.normal * opening);
            PadTarget { body: self.links[pad.joint], pad, point, normal: goal.normal }
        };
        act.goals.iter().map(target).collect()
    }

    /// Creates the control that presses a goal's site against the surface, linearised at the current pose.
    fn force_control(&self, world: &World, goal: &ContactGoal, rig: &HandRig) -> ForceControl {
        let pad = rig.pad(goal.site);
        let body = self.links[pad.joint];
        let inward = -goal.normal;
        let per_newton = if goal.site == HandSite::Palm {
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
        let bodies = (0..JOINT_NAMES.len()).filter(|j| site_of(*j) == goal.site).map(|j| self.links[j]).collect();
        ForceControl { goal: *goal, bodies, per_newton, correction: 0.0 }
    }
}

/// Returns variable `index` with the last solution as rest, which keeps the way between solutions short; stiffer wrist
/// joints let the fingers open rather than the wrist.
fn near_pose(index: usize, variable: JointVariable, pose: &[f64]) -> JointVariable {
    let rest = pose[index];
    match index {
        0..3 => JointVariable { rest, slack: 0.01, ..variable },
        3..6 => JointVariable { rest, slack: 0.1, ..variable },
        _ => JointVariable { rest, ..variable },
    }
}

/// Returns the hinges of the fingers that wrap.
fn wrap_hinges(hand: &HandDraw, rig: &HandRig) -> Vec<WrapHinge> {
    let Some((fingers, torque)) = &hand.wrap else {
        return Vec::new();
    };
    let flexing = rig.hinges.iter().enumerate().filter(|(_, hinge)| hinge.motion == HingeMotion::Flex);
    let wrapping = flexing.filter(|(_, hinge)| fingers.contains(&hinge.site));
    let wrap = |(index, hinge): (usize, &Hinge)| {
        let place = hinge.joint - base_joint(hinge.site);
        let closed = if hinge.site == HandSite::Thumb { CLOSED_THUMB } else { CLOSED_FINGER[place] };
        let lead = torque * WRAP_TORQUE_SHARES[place] / hinge.stiffness;
        WrapHinge { hinge: index, closed: closed.clamp(hinge.range[0], hinge.range[1]), lead }
    };
    wrapping.map(wrap).collect()
}
