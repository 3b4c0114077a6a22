//! Contact forces near those asked for, with the net force and torque asked for, inside friction cones.
//!
//! min sum |f_i - asked_i|^2 + w |sum f_i - net|^2 + w |sum (x_i - middle) x f_i - moment|^2 / length^2
//! over -f_i . n_i >= 0, |tangent| <= friction * normal, normal <= most: by alternating directions (ADMM), whose two steps
//! have closed forms: a solve with six unknowns, and projections onto cones.

use glam::DVec3;
use nalgebra::{Cholesky, Matrix6, Vector6};

/// How much more the net force counts than the single ones.
const NET_WEIGHT: f64 = 100.0;
/// How much more the net torque counts.
const MOMENT_WEIGHT: f64 = 10.0;
/// Length that makes a torque a force, m.
const LENGTH: f64 = 0.05;
/// Step of the dual variables.
const RHO: f64 = 4.0;
const ITERATIONS: usize = 80;

/// A contact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Index of its link.
    pub link: usize,
    /// Where, m.
    pub place: DVec3,
    /// Unit normal out of the link.
    pub normal: DVec3,
    /// Force of the world on the link that is asked for, N.
    pub asked: DVec3,
    /// Most normal force, N.
    pub most: f64,
    /// The force found, N.
    pub force: DVec3,
}

/// The solver's memory.
#[derive(Debug)]
pub struct Balance {
    arms: Vec<DVec3>,
    free: Vec<DVec3>,
    dual: Vec<DVec3>,
}

impl Balance {
    /// For so many contacts at most.
    pub fn new(count: usize) -> Self {
        Self { arms: Vec::with_capacity(count), free: Vec::with_capacity(count), dual: Vec::with_capacity(count) }
    }

    /// Finds the contacts' forces.
    pub fn solve(&mut self, contacts: &mut [Contact], net: DVec3, moment: DVec3, friction: f64) {
        let middle = contacts.iter().map(|contact| contact.place).sum::<DVec3>() / contacts.len().max(1) as f64;
        self.arms.clear();
        self.arms.extend(contacts.iter().map(|contact| (contact.place - middle) / LENGTH));
        self.free.clear();
        self.free.extend(contacts.iter().map(|contact| contact.asked));
        self.dual.clear();
        self.dual.resize(contacts.len(), DVec3::ZERO);
        for contact in contacts.iter_mut() {
            contact.force = into_cone(contact.asked, contact, friction);
        }
        let weights = Vector6::new(NET_WEIGHT, NET_WEIGHT, NET_WEIGHT, MOMENT_WEIGHT, MOMENT_WEIGHT, MOMENT_WEIGHT);
        let goal = stack(net, moment / LENGTH);
        let k = 1.0 + RHO;
        let mut gram = Matrix6::from_diagonal(&weights.map(|weight| k / weight));
        for arm in &self.arms {
            for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
                let column = stack(axis, arm.cross(axis));
                gram += column * column.transpose();
            }
        }
        let Some(gram) = Cholesky::new(gram) else { return };
        for _ in 0..ITERATIONS {
            // (k + A' W A) f = asked + A' W goal + rho (z - y), by the matrix inversion lemma.
            let mut sum = Vector6::zeros();
            for (index, contact) in contacts.iter().enumerate() {
                let right = contact.asked + RHO * (contact.force - self.dual[index]);
                self.free[index] = right;
                sum += stack(right, self.arms[index].cross(right));
            }
            let pull = gram.solve(&(goal * k - sum)) / k;
            for (index, contact) in contacts.iter_mut().enumerate() {
                let [force, torque] = unstack(&pull);
                let free = self.free[index] / k + force + torque.cross(self.arms[index]);
                contact.force = into_cone(free + self.dual[index], contact, friction);
                self.dual[index] += free - contact.force;
            }
        }
    }
}

fn stack(force: DVec3, torque: DVec3) -> Vector6<f64> {
    Vector6::new(force.x, force.y, force.z, torque.x, torque.y, torque.z)
}

fn unstack(v: &Vector6<f64>) -> [DVec3; 2] {
    [DVec3::new(v[0], v[1], v[2]), DVec3::new(v[3], v[4], v[5])]
}

/// The nearest force that pushes into the link, within the friction cone, no harder than the contact may.
pub fn into_cone(force: DVec3, contact: &Contact, friction: f64) -> DVec3 {
    let push = -force.dot(contact.normal);
    let tangent = force + push * contact.normal;
    let slide = tangent.length();
    let inside = match slide <= friction * push {
        true => (push, slide),
        false if friction * slide <= -push => (0.0, 0.0),
        false => {
            let push = (push + friction * slide) / (1.0 + friction * friction);
            (push, friction * push)
        }
    };
    let push = inside.0.min(contact.most.max(0.0));
    let slide_in = inside.1.min(friction * push);
    let tangent = if slide > 0.0 { tangent * (slide_in / slide) } else { DVec3::ZERO };
    tangent - push * contact.normal
}
