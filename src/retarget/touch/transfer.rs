//! Transfer of touch from the segments of a human hand to the links of a robot hand.
//!
//! 1. The force on each human segment goes to the robot link that takes its place, rotated half of the way from the
//!    segment's axes (normal, lateral, along) to those of the link.
//! 2. [`ForceBalance`] adjusts the forces inside friction cones, so that net force and net torque stay the human's.
//! 3. Forces that need more torque than the joints' actuators have are reduced, and the balance is solved again.

use glam::{DMat3, DQuat, DVec3};

use super::balance::{ForceBalance, LinkContact};
use super::expected::ExpectedTouch;
use super::human::{DORSAL, MAX_FORCE_N, N_SEGMENTS, PALM, Touch, segment_axes};
use super::links::{Link, finger_links, palm_link};
use super::pinch_point::PinchPoint;
use super::torque_limits::torque_limits;
use crate::hand::N_KEYPOINTS;
use crate::retarget::human::Hand;
use crate::retarget::robot::Robot;
use crate::retarget::robot::kinematics::{chain, jacobian};
use crate::retarget::robot::spec::ContactRegions;

/// Share of the rotation from a human segment's axes to its robot link's that forces follow. Relative to the object a force
/// keeps its direction in the world (0); relative to the skin it keeps its direction in the pad's frame (1). Where the
/// robot's pad is turned against the human's both can't hold, so each is kept half.
const ROTATION_SHARE: f64 = 0.5;
/// Rounds of balance and torque limits. Each round may move force to links whose joints then reach their limits; the last
/// round scales the forces themselves.
const ROUNDS: usize = 4;
/// Weights of a link's base and end in the point where force acts on it; on fingertips it acts at the tip, or at the pinch
/// point.
const END_WEIGHTS: [f64; 2] = [0.3, 0.7];
/// Least mean distance of points of action from their middle at which a torque about it can be scaled, m.
const MIN_SPREAD: f64 = 1e-4;

/// Forces that the human's segments ask of one link.
#[derive(Debug, Clone, Copy, Default)]
struct Wanted {
    /// Sum of the forces, N, in the robot's wrist frame.
    force: DVec3,
    /// Sum of their magnitudes, N.
    magnitude: f64,
    /// Greatest contact probability.
    contact: f64,
}

/// Force of one human segment and its point of action, in the wrist frame.
#[derive(Debug, Clone, Copy)]
struct AppliedForce {
    position: DVec3,
    force: DVec3,
}

/// Sum of the human's touch that links take, in the wrist frame.
#[derive(Debug, Clone, Copy)]
struct NetTouch {
    force: DVec3,
    /// Torque about the middle of the robot's contacts, N m.
    torque: DVec3,
}

/// Touch of a human hand in one frame, with what the robot makes of it.
#[derive(Debug, Clone, Copy)]
pub struct TransferInput<'a> {
    /// The hand as it came.
    pub hand: &'a Hand,
    /// (21) smoothed keypoints in the wrist frame, m.
    pub points: &'a [DVec3; N_KEYPOINTS],
    /// Touch of the hand.
    pub touch: &'a Touch,
    /// Contact point of the robot fingertip of each human finger.
    pub pinches: &'a [Option<PinchPoint>; 5],
}

/// Pose of the robot's wrist frame in the world.
#[derive(Debug, Clone, Copy)]
struct WristPose {
    /// Columns palmar, radial, distal.
    axes: DMat3,
    origin: DVec3,
}

/// Transfers touch to one robot.
#[derive(Debug)]
pub struct TouchTransfer {
    links: Vec<Link>,
    /// For each human segment, the index of the link that takes its force.
    takers: [Option<usize>; N_SEGMENTS],
    /// Greatest torque or force of each free coordinate, N m or N.
    torque_limits: Vec<f64>,
    friction: f64,
    max_force: f64,
    balance: ForceBalance,
    contacts: Vec<LinkContact>,
    /// For each link.
    wanted: Vec<Wanted>,
    /// Forces of the frame's segments.
    applied: Vec<AppliedForce>,
    names: Vec<String>,
}

impl TouchTransfer {
    /// Finds the links of a robot that take force.
    pub fn new(robot: &Robot) -> Self {
        let mut links = Vec::new();
        let mut first_links = Vec::new();
        for finger in &robot.fingers {
            first_links.push(links.len());
            links.extend(finger_links(robot, finger));
        }
        let mut takers = finger_takers(robot, &first_links, links.len());
        if robot.spec.contact.regions == ContactRegions::Palm {
            let palm = palm_link(robot);
            (takers[PALM], takers[DORSAL]) = (Some(links.len()), Some(links.len() + 1));
            links.push(Link { axes: palm.axes, ..palm.clone() });
            let back = DMat3::from_cols(-palm.axes.x_axis, -palm.axes.y_axis, palm.axes.z_axis);
            links.push(Link { axes: back, ..palm });
        }
        let names = links.iter().map(|link| robot.parts.bodies[link.body].name.clone()).collect();
        let count = links.len();
        Self {
            takers,
            torque_limits: torque_limits(robot),
            friction: robot.spec.contact.friction,
            max_force: robot.spec.contact.max_force.unwrap_or(MAX_FORCE_N),
            balance: ForceBalance::new(count),
            contacts: Vec::with_capacity(count),
            wanted: vec![Wanted::default(); count],
            applied: Vec::with_capacity(N_SEGMENTS),
            names,
            links,
        }
    }

    /// Returns no touch, with all links named.
    pub fn no_touch(&self) -> ExpectedTouch {
        ExpectedTouch::none(self.names.iter().cloned(), self.torque_limits.len())
    }

    /// Transfers a touch to the robot in its present pose, into `expected`.
    pub fn transfer(&mut self, robot: &Robot, input: &TransferInput, expected: &mut ExpectedTouch) {
        expected.clear();
        let axes = robot.wrist.world_axes(&robot.world);
        let wrist = WristPose { axes, origin: robot.world.body_pose(robot.wrist.body).0 };
        let (net_force, pressed) = self.assign_forces(robot, wrist, input, expected);
        expected.net_force = input.hand.axes * net_force;
        self.place_contacts(robot, wrist, input, expected);
        if self.contacts.is_empty() || pressed <= 0.0 {
            return;
        }
        let net = NetTouch { force: net_force, torque: self.scaled_torque() };
        // A cross product of coordinates in a left hand's frame, which is left-handed, has the opposite sign.
        expected.net_torque = input.hand.axes.determinant() * (input.hand.axes * net.torque);
        self.balance_within_limits(robot, wrist, net, expected);
        self.write_forces(robot, wrist, input.hand, expected);
    }

    /// Assigns the force of each human segment to its link; returns net force and sum of magnitudes, N, in the wrist frame.
    fn assign_forces(
        &mut self,
        robot: &Robot,
        wrist: WristPose,
        input: &TransferInput,
        expected: &mut ExpectedTouch,
    ) -> (DVec3, f64) {
        let TransferInput { hand, points, touch, pinches } = *input;
        self.wanted.fill(Wanted::default());
        self.applied.clear();
        let (mut net, mut pressed) = (DVec3::ZERO, 0.0);
        for segment in 0..N_SEGMENTS {
            let human = touch.on_segment(hand, points, segment);
            if human.magnitude <= 0.0 && human.contact <= 0.0 {
                continue;
            }
            net += human.force;
            let Some(taker) = self.takers[segment] else {
                expected.unassigned_force += human.force.length();
                net -= human.force;
                continue;
            };
            let link = &self.links[taker];
            let from = segment_axes(points, segment);
            let to = wrist.axes.transpose() * (robot.world.body_pose(link.body).1 * link.axes);
            // Fingertips that touch each other press along the line on which they meet, however their pads are turned.
            let is_pinched = link.tip_of.is_some_and(|human| pinches[human].is_some());
            let share = if is_pinched { 0.0 } else { ROTATION_SHARE };
            let rotation = DQuat::IDENTITY.slerp(DQuat::from_mat3(&(to * from.transpose())), share);
            let wanted = &mut self.wanted[taker];
            wanted.force += rotation * human.force;
            wanted.magnitude += human.magnitude;
            wanted.contact = wanted.contact.max(human.contact);
            self.applied.push(AppliedForce { position: human.position, force: human.force });
            pressed += human.magnitude;
        }
        (net, pressed)
    }

    /// Finds the point of action on each link, and makes a contact of each link that takes force.
    fn place_contacts(&mut self, robot: &Robot, wrist: WristPose, input: &TransferInput, expected: &mut ExpectedTouch) {
        let to_wrist = wrist.axes.transpose();
        self.contacts.clear();
        for (index, link) in self.links.iter().enumerate() {
            let (origin, rotation) = robot.world.body_pose(link.body);
            let local = match link.tip_of {
                Some(_) => link.ends[1],
                None => END_WEIGHTS[0] * link.ends[0] + END_WEIGHTS[1] * link.ends[1],
            };
            let pinch = link.tip_of.and_then(|human| input.pinches[human]);
            let position = match pinch {
                Some(pinch) => to_wrist * (pinch.position - wrist.origin),
                None => to_wrist * (origin + rotation * local - wrist.origin),
            };
            let wanted = self.wanted[index];
            let expected_link = &mut expected.links[index];
            expected_link.contact = wanted.contact;
            expected_link.position = input.hand.axes * position;
            expected_link.body_position = rotation.transpose() * (wrist.origin + wrist.axes * position - origin);
            if wanted.magnitude > 0.0 {
                self.contacts.push(LinkContact {
                    link: index,
                    position,
                    normal: to_wrist * pinch.map_or(rotation * link.axes.x_axis, |pinch| pinch.normal),
                    wanted: wanted.force,
                    max_normal: self.max_force,
                    force: DVec3::ZERO,
                });
            }
        }
    }

    /// Net torque of the human's touch about the middle of its points of action, as large as if the robot's points were as
    /// far apart as the human's, N m.
    fn scaled_torque(&self) -> DVec3 {
        let human_spread = spread(self.applied.iter().map(|applied| applied.position));
        let robot_spread = spread(self.contacts.iter().map(|contact| contact.position));
        let torque = torque_about_middle(&self.applied);
        if human_spread > MIN_SPREAD { torque * (robot_spread / human_spread) } else { DVec3::ZERO }
    }

    /// Balances the contacts' forces, and reduces those whose joint torques exceed the limits.
    fn balance_within_limits(&mut self, robot: &Robot, wrist: WristPose, net: NetTouch, expected: &mut ExpectedTouch) {
        for round in 0..ROUNDS {
            self.balance.solve(&mut self.contacts, net.force, net.torque, self.friction);
            self.write_torques(robot, wrist, &mut expected.torque);
            if !self.reduce_forces(robot, &expected.torque, round + 1 == ROUNDS) {
                break;
            }
            expected.clipped = true;
        }
        self.write_torques(robot, wrist, &mut expected.torque);
    }

    /// Writes the torques with which the joints press with the contacts' forces: the opposite of the torques that these
    /// forces exert on the joints.
    fn write_torques(&self, robot: &Robot, wrist: WristPose, torque: &mut [f64]) {
        torque.fill(0.0);
        for contact in &self.contacts {
            let position = wrist.origin + wrist.axes * contact.position;
            let force = wrist.axes * contact.force;
            let body = self.links[contact.link].body;
            for (coordinate, velocity) in jacobian(&robot.world, &robot.parts, &robot.coupling, body, position) {
                torque[coordinate] -= velocity.dot(force);
            }
        }
    }

    /// Reduces contacts whose joints exceed a torque limit; returns true if any was reduced.
    ///
    /// `at_once` scales the forces themselves; otherwise only their caps change and the next balance moves force to other
    /// contacts.
    fn reduce_forces(&mut self, robot: &Robot, torque: &[f64], at_once: bool) -> bool {
        let mut is_reduced = false;
        for (coordinate, limit) in self.torque_limits.iter().enumerate() {
            let share = limit / torque[coordinate].abs();
            if share.is_nan() || share >= 1.0 - 1e-9 {
                continue;
            }
            is_reduced = true;
            for contact in &mut self.contacts {
                let body = self.links[contact.link].body;
                if chain(&robot.parts, &robot.coupling, body).iter().any(|joint| joint.coordinate == coordinate) {
                    contact.max_normal = contact.max_normal.min(share * -contact.force.dot(contact.normal));
                    if at_once {
                        contact.force *= share;
                    }
                }
            }
        }
        is_reduced
    }

    /// Writes the contacts' forces to their links.
    fn write_forces(&self, robot: &Robot, wrist: WristPose, hand: &Hand, expected: &mut ExpectedTouch) {
        for contact in &self.contacts {
            let link = &mut expected.links[contact.link];
            link.normal_force = -contact.force.dot(contact.normal);
            link.force = hand.axes * contact.force;
            // Both factors are in the right-handed frame of the keypoints; a left hand's wrist frame would flip the sign.
            link.torque = (hand.axes * contact.position).cross(link.force);
            let (_, rotation) = robot.world.body_pose(self.links[contact.link].body);
            link.body_force = rotation.transpose() * (wrist.axes * contact.force);
            if let Some(human) = self.links[contact.link].tip_of {
                expected.tip_force[human] += link.force;
            }
        }
    }
}

/// Returns the link that takes each finger segment's force; `first_links`: index of each robot finger's first link.
fn finger_takers(robot: &Robot, first_links: &[usize], n_links: usize) -> [Option<usize>; N_SEGMENTS] {
    let mut takers = [None; N_SEGMENTS];
    for human in 0..5 {
        let Some(finger) = robot.takes_force[human] else { continue };
        let count = first_links.get(finger + 1).copied().unwrap_or(n_links) - first_links[finger];
        for bone in 0..3 {
            if bone == 2 || robot.spec.contact.regions != ContactRegions::Fingertips {
                // Links and bones are paired from the tip; a link of a finger with fewer links takes several bones.
                let link = (count + bone).saturating_sub(3).min(count - 1);
                takers[3 * human + bone] = Some(first_links[finger] + link);
            }
        }
    }
    takers
}

/// Torque of forces about the mean of their points of action, N m.
fn torque_about_middle(applied: &[AppliedForce]) -> DVec3 {
    let middle = applied.iter().map(|applied| applied.position).sum::<DVec3>() / applied.len().max(1) as f64;
    applied.iter().map(|applied| (applied.position - middle).cross(applied.force)).sum()
}

/// Mean distance of points from their middle, m.
fn spread(points: impl Iterator<Item = DVec3> + Clone) -> f64 {
    let count = points.clone().count().max(1) as f64;
    let middle = points.clone().sum::<DVec3>() / count;
    points.map(|point| point.distance(middle)).sum::<f64>() / count
}
