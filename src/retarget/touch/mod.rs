//! Touch, carried over: from the human's skin to forces that the robot's links are to feel.
//!
//! Forces of the human's vertices are pooled to bones and palm, turned half of the way from each bone's frame (normal,
//! lateral, along) to that of the robot link that takes its place, and adjusted so that the net force and torque on the
//! hand stay what they were, within friction cones and what the joints' actuators can hold.

pub mod balance;
mod limits;
mod link;
pub mod pool;

use glam::{DMat3, DQuat, DVec3};

use super::goal::pinch::Meeting;
use super::goal::{Seen, bone_axes};
use super::human::{Hand, keypoint};
use super::problem::jacobian;
use super::robot::Robot;
use super::robot::spec::Regions;
use crate::error::{Error, Result};
use crate::hand::N_KEYPOINTS;

use self::balance::{Balance, Contact};
use self::link::{Link, finger_links, palm_link};
pub use self::pool::Pool;

/// Pooled parts of a human hand: three bones of five fingers from base to tip, palm, back.
pub const SLOTS: usize = 17;
/// The palm's slot.
pub const PALM: usize = 15;
/// The back's slot.
pub const DORSAL: usize = 16;
/// Force from which on a part counts as touched, N.
const TOUCHED: f64 = 0.05;
/// Forces above this are as good as unbounded, N.
const UNBOUNDED: f64 = 1e9;

/// Touch of one part of the human hand.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Slot {
    /// Force of the world on the part, N, in its axes: normal (out of the pad), lateral, along the bone; of palm and back
    /// in the wrist frame's.
    pub force: DVec3,
    /// Sum of the vertices' normal forces, N.
    pub pressed: f64,
    /// Where along the bone it acts, 0 base to 1 tip.
    pub along: f64,
    /// Probability that something touches.
    pub contact: f64,
}

/// What the human hand touches.
#[derive(Debug, Clone, PartialEq)]
pub struct Touch {
    /// Contact probability of each fingertip, thumb to little; NaN = unknown.
    pub tip_contact: [f64; 5],
    /// Force of the world on each fingertip, N, in the frame of the keypoints; None = unknown, or in `slots`.
    pub tip_force: Option<[DVec3; 5]>,
    /// Pooled field; see [`Pool`].
    pub slots: Option<Box<[Slot; SLOTS]>>,
}

impl Default for Touch {
    fn default() -> Self {
        Self { tip_contact: [f64::NAN; 5], tip_force: None, slots: None }
    }
}

impl Touch {
    /// Refuses what is no touch.
    ///
    /// # Errors
    /// If a force is not finite or a probability outside 0 to 1; the error names it.
    pub fn check(&self) -> Result<()> {
        if let Some(bad) = self.tip_contact.iter().position(|p| !(p.is_nan() || (0.0..=1.0).contains(p))) {
            return Err(Error::value(format!("tip_contact[{bad}]"), "0 to 1", self.tip_contact[bad]));
        }
        let forces = self.tip_force.iter().flatten();
        match forces.clone().position(|force| !force.is_finite() || force.length() > UNBOUNDED) {
            Some(bad) => {
                Err(Error::value(format!("tip_force[{bad}]"), "finite newtons", forces.collect::<Vec<_>>()[bad]))
            }
            None => Ok(()),
        }
    }

    /// Whether it holds any force.
    pub fn has_force(&self) -> bool {
        self.tip_force.is_some() || self.slots.is_some()
    }
}

/// What one link of the robot is to feel.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkFeel {
    /// Name of the link's body.
    pub name: String,
    /// Normal force, N.
    pub normal_force: f64,
    /// Force of the world on the link, N, in the frame of the keypoints.
    pub force: DVec3,
    /// Its torque about the wrist, N m, with the robot's wrist where the human's is.
    pub torque: DVec3,
    /// Where it acts from the wrist, m, likewise.
    pub position: DVec3,
    /// The force in the frame of the link's own body, N.
    pub body_force: DVec3,
    /// Where it acts in the frame of the link's own body, m.
    pub body_position: DVec3,
    /// Probability that something touches.
    pub contact: f64,
}

/// What the robot is to feel.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Feel {
    /// Links: three per finger at most, then the palm.
    pub links: Vec<LinkFeel>,
    /// Force of the world on each fingertip by human finger, N, in the frame of the keypoints; 0 where the robot has none.
    pub tip_force: [DVec3; 5],
    /// What each free coordinate's joints must give to press like that, N m or N.
    pub torque: Vec<f64>,
    /// Whether an actuator's range made forces smaller.
    pub clipped: bool,
    /// Force that no link could take, N: of parts that the robot lacks or that its file excludes.
    pub left_out: f64,
    /// Net force of the human's touch, N, in the frame of the keypoints.
    pub asked: DVec3,
    /// Its net torque about the middle of the touched places, N m, as large as the robot's hand makes it, in the frame of the
    /// keypoints.
    pub asked_moment: DVec3,
}

impl Feel {
    /// No touch.
    pub fn clear(&mut self) {
        for link in &mut self.links {
            link.normal_force = 0.0;
            link.contact = 0.0;
            (link.force, link.torque, link.body_force) = (DVec3::ZERO, DVec3::ZERO, DVec3::ZERO);
        }
        self.tip_force = [DVec3::ZERO; 5];
        self.torque.fill(0.0);
        (self.clipped, self.left_out) = (false, 0.0);
        (self.asked, self.asked_moment) = (DVec3::ZERO, DVec3::ZERO);
    }
}

/// Carries touch over to a robot.
#[derive(Debug)]
pub struct Transfer {
    links: Vec<Link>,
    /// For each human slot, the link that takes its force.
    takers: [Option<usize>; SLOTS],
    /// Most torque of each free coordinate, N m or N.
    limits: Vec<f64>,
    friction: f64,
    max_force: f64,
    balance: Balance,
    contacts: Vec<Contact>,
    /// Sum of forces and of normal forces of each link, contact.
    asked: Vec<(DVec3, f64, f64)>,
    names: Vec<String>,
}

impl Transfer {
    /// Finds the links that take force.
    pub fn new(robot: &Robot) -> Self {
        let mut links = Vec::new();
        let mut firsts = Vec::new();
        for finger in &robot.fingers {
            firsts.push(links.len());
            links.extend(finger_links(robot, finger));
        }
        let regions = robot.spec.contact.regions;
        let mut takers = [None; SLOTS];
        for human in 0..5 {
            let Some(finger) = robot.takes_force[human] else { continue };
            let count = firsts.get(finger + 1).copied().unwrap_or(links.len()) - firsts[finger];
            for bone in 0..3 {
                if bone == 2 || regions != Regions::Fingertips {
                    // The last bones meet; a robot with fewer links takes several with one.
                    takers[3 * human + bone] = Some(firsts[finger] + (count + bone).saturating_sub(3).min(count - 1));
                }
            }
        }
        if regions == Regions::Palm {
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
            limits: limits::of(robot),
            friction: robot.spec.contact.friction,
            max_force: robot.spec.contact.max_force.unwrap_or(UNBOUNDED),
            balance: Balance::new(count),
            contacts: Vec::with_capacity(count),
            asked: vec![(DVec3::ZERO, 0.0, 0.0); count],
            names,
            links,
        }
    }

    /// A feel without touch, with all links named.
    pub fn nothing(&self) -> Feel {
        let link = |name: &String| LinkFeel {
            name: name.clone(),
            normal_force: 0.0,
            force: DVec3::ZERO,
            torque: DVec3::ZERO,
            position: DVec3::ZERO,
            body_force: DVec3::ZERO,
            body_position: DVec3::ZERO,
            contact: 0.0,
        };
        Feel { links: self.names.iter().map(link).collect(), torque: vec![0.0; self.limits.len()], ..Feel::default() }
    }

    /// Most torque of each free coordinate, N m or N; infinite where nothing limits it.
    pub fn limits(&self) -> &[f64] {
        &self.limits
    }

    /// Carries a touch over to the robot in its present pose.
    ///
    /// `hand`: the frame as it came; `points`: its keypoints in the wrist frame as the pose was solved for; `meetings`:
    /// where fingertips touch each other.
    pub fn carry(
        &mut self,
        robot: &Robot,
        hand: &Hand,
        points: &[DVec3; N_KEYPOINTS],
        touch: &Touch,
        meetings: &[Option<Meeting>; 5],
        feel: &mut Feel,
    ) {
        feel.clear();
        let axes = robot.wrist.world_axes(&robot.world);
        let to_wrist = axes.transpose();
        let (wrist_body, _) = robot.world.body_pose(robot.wrist.body);
        self.asked.fill((DVec3::ZERO, 0.0, 0.0));
        let (mut net, mut arms, mut pressed) = (DVec3::ZERO, Vec::new(), 0.0);
        for slot in 0..SLOTS {
            let (force, weight, contact, place) = human_force(hand, points, touch, slot);
            if weight <= 0.0 && contact <= 0.0 {
                continue;
            }
            net += force;
            let Some(taker) = self.takers[slot] else {
                feel.left_out += force.length();
                net -= force;
                continue;
            };
            let from = human_axes(points, slot);
            let to = to_wrist * (robot.world.body_pose(self.links[taker].body).1 * self.links[taker].axes);
            let asked = &mut self.asked[taker];
            let meeting = self.links[taker].tip_of.and_then(|human| meetings[human]);
            // To the object a force is a direction in the world, to the skin one in the frame of the pad. Where the
            // robot's pad is turned against the human's, both are kept half. Fingers that touch each other do so where
            // they meet, however pads are turned.
            let share = if meeting.is_some() { 0.0 } else { 0.5 };
            let turn = DQuat::IDENTITY.slerp(DQuat::from_mat3(&(to * from.transpose())), share);
            asked.0 += turn * force;
            asked.1 += weight;
            asked.2 = asked.2.max(contact);
            arms.push((place, force));
            pressed += weight;
        }
        feel.asked = hand.axes * net;
        self.contacts.clear();
        for (index, link) in self.links.iter().enumerate() {
            let (origin, rotation) = robot.world.body_pose(link.body);
            let place = to_wrist * (origin + rotation * (0.3 * link.ends[0] + 0.7 * link.ends[1]) - wrist_body);
            let place =
                if link.tip_of.is_some() { to_wrist * (origin + rotation * link.ends[1] - wrist_body) } else { place };
            let meeting = link.tip_of.and_then(|human| meetings[human]);
            let place = meeting.map_or(place, |meeting| to_wrist * (meeting.place - wrist_body));
            feel.links[index].contact = self.asked[index].2;
            feel.links[index].position = hand.axes * place;
            feel.links[index].body_position = rotation.transpose() * (wrist_body + axes * place - origin);
            if self.asked[index].1 > 0.0 {
                self.contacts.push(Contact {
                    link: index,
                    place,
                    normal: to_wrist * meeting.map_or(rotation * link.axes.x_axis, |meeting| meeting.normal),
                    asked: self.asked[index].0,
                    most: self.max_force,
                    force: DVec3::ZERO,
                });
            }
        }
        if self.contacts.is_empty() || pressed <= 0.0 {
            return;
        }
        // Torque about the middle of the touch, as large as if the robot's hand were of the human's size.
        let moment = moment(&arms);
        let spread = spread(arms.iter().map(|(place, _)| *place));
        let robot_spread = spread_of(&self.contacts);
        let moment = if spread > 1e-4 { moment * (robot_spread / spread) } else { DVec3::ZERO };
        // In the coordinates of a left hand a product of two vectors turns the other way.
        feel.asked_moment = hand.axes.determinant() * (hand.axes * moment);
        for round in 0..4 {
            self.balance.solve(&mut self.contacts, net, moment, self.friction);
            self.torques(robot, &to_wrist, axes, wrist_body, &mut feel.torque);
            if !self.cap(robot, &feel.torque, round == 3) {
                break;
            }
            feel.clipped = true;
        }
        self.torques(robot, &to_wrist, axes, wrist_body, &mut feel.torque);
        for contact in &self.contacts {
            let link = &mut feel.links[contact.link];
            link.normal_force = -contact.force.dot(contact.normal);
            link.force = hand.axes * contact.force;
            // A left hand's coordinates turn the other way: take the product where the axes are the world's.
            link.torque = (hand.axes * contact.place).cross(link.force);
            let (_, rotation) = robot.world.body_pose(self.links[contact.link].body);
            link.body_force = rotation.transpose() * (axes * contact.force);
            if let Some(human) = self.links[contact.link].tip_of {
                feel.tip_force[human] += link.force;
            }
        }
    }

    /// What the joints must give to press with the contacts' forces: the contrary of what these do to the joints.
    fn torques(&self, robot: &Robot, to_wrist: &DMat3, axes: DMat3, wrist: DVec3, torque: &mut [f64]) {
        torque.fill(0.0);
        for contact in &self.contacts {
            let place = wrist + axes * contact.place;
            let force = to_wrist.transpose() * contact.force;
            let body = self.links[contact.link].body;
            for (coordinate, velocity, _) in jacobian(&robot.world, &robot.parts, &robot.coupling, body, place) {
                torque[coordinate] -= velocity.dot(force);
            }
        }
    }

    /// Makes forces smaller whose torques are beyond a limit; `at_once` scales them now, otherwise the next balance does,
    /// which lets other contacts take over. Returns whether one was.
    fn cap(&mut self, robot: &Robot, torque: &[f64], at_once: bool) -> bool {
        let mut capped = false;
        for (coordinate, limit) in self.limits.iter().enumerate() {
            let share = limit / torque[coordinate].abs();
            if share.is_nan() || share >= 1.0 - 1e-9 {
                continue;
            }
            capped = true;
            for contact in &mut self.contacts {
                let body = self.links[contact.link].body;
                let place = DVec3::ZERO;
                let moves = jacobian(&robot.world, &robot.parts, &robot.coupling, body, place);
                if moves.iter().any(|(moved, ..)| *moved == coordinate) {
                    contact.most = contact.most.min(share * -contact.force.dot(contact.normal));
                    if at_once {
                        contact.force *= share;
                    }
                }
            }
        }
        capped
    }
}

/// Force of the world on a fingertip of the human hand, N, in the wrist frame.
pub(super) fn tip_force(seen: &Seen, touch: &Touch, finger: usize) -> DVec3 {
    human_force(seen.hand, seen.calm, touch, 3 * finger + 2).0
}

/// Force of the world on a part of the human hand in the wrist frame, its size, contact probability, place.
fn human_force(hand: &Hand, points: &[DVec3; N_KEYPOINTS], touch: &Touch, slot: usize) -> (DVec3, f64, f64, DVec3) {
    let pooled = touch.slots.as_ref().map(|slots| slots[slot]);
    let along = pooled.map_or(0.7, |slot| slot.along);
    let place = match slot < PALM {
        true => points[keypoint(slot / 3, slot % 3)].lerp(points[keypoint(slot / 3, slot % 3 + 1)], along),
        false => 0.5 * Hand::bases(points, 1..5),
    };
    let is_tip = slot < PALM && slot % 3 == 2;
    let contact = match (is_tip, pooled) {
        (true, _) if !touch.tip_contact[slot / 3].is_nan() => touch.tip_contact[slot / 3],
        (_, Some(slot)) => slot.contact,
        _ => 0.0,
    };
    match (&touch.tip_force, is_tip) {
        (Some(forces), true) => {
            let force = hand.axes.transpose() * forces[slot / 3];
            let size = force.length();
            (force, size, if contact > 0.0 || size <= TOUCHED { contact } else { 1.0 }, points[keypoint(slot / 3, 3)])
        }
        _ => {
            let (force, size) = pooled.map_or((DVec3::ZERO, 0.0), |slot| (slot.force, slot.pressed));
            (human_axes(points, slot) * force, size, contact, place)
        }
    }
}

/// Axes of a part of the human hand in the wrist frame: columns normal, lateral, along.
fn human_axes(points: &[DVec3; N_KEYPOINTS], slot: usize) -> DMat3 {
    match slot {
        PALM => DMat3::IDENTITY,
        DORSAL => DMat3::IDENTITY,
        _ => bone_axes(points, slot / 3, slot % 3),
    }
}

/// Torque of forces about the middle of their places.
fn moment(arms: &[(DVec3, DVec3)]) -> DVec3 {
    let middle = arms.iter().map(|(place, _)| *place).sum::<DVec3>() / arms.len().max(1) as f64;
    arms.iter().map(|(place, force)| (*place - middle).cross(*force)).sum()
}

/// Mean distance of places from their middle, m.
fn spread(places: impl Iterator<Item = DVec3> + Clone) -> f64 {
    let count = places.clone().count().max(1) as f64;
    let middle = places.clone().sum::<DVec3>() / count;
    places.map(|place| place.distance(middle)).sum::<f64>() / count
}

fn spread_of(contacts: &[Contact]) -> f64 {
    spread(contacts.iter().map(|contact| contact.place))
}
