//! Balance of contact forces: forces near the wanted ones, inside friction cones, with a given net force and net torque.
//!
//! ```text
//! minimise   sum |f_i - wanted_i|^2 + w_f |sum f_i - net|^2 + w_t |sum (x_i - middle) x f_i - torque|^2 / length^2
//! subject to p_i = -f_i . n_i,  0 <= p_i <= max_normal_i,  |f_i + p_i n_i| <= friction * p_i
//! ```
//!
//! The method is ADMM (alternating direction method of multipliers), because both of its steps have closed forms: the
//! quadratic step is a linear system with six unknowns for any number of contacts (matrix inversion lemma), the other
//! projects each force onto its cone.

use glam::DVec3;
use nalgebra::{Cholesky, Matrix6, Vector6};

/// Weight w_f of the net force, relative to the weight of a single force: what moves the object is the sum.
const NET_FORCE_WEIGHT: f64 = 100.0;
/// Weight w_t of the net torque, likewise.
const NET_TORQUE_WEIGHT: f64 = 10.0;
/// Length that converts torque to force, m.
const TORQUE_LENGTH: f64 = 0.05;
/// Penalty of ADMM, which is also the step of its dual variables.
const RHO: f64 = 4.0;
/// Steps of ADMM: a fixed number, so the time per frame is bounded. No nearby forces then cost 2 % less
/// (`a_balance_is_as_good_as_any_nearby_and_within_its_cones`).
const ITERATIONS: usize = 80;

/// Contact of one robot link; vectors are in any one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkContact {
    /// Index of the link.
    pub link: usize,
    /// Point of action, m.
    pub position: DVec3,
    /// Unit normal out of the link.
    pub normal: DVec3,
    /// Wanted force of the world on the link, N.
    pub wanted: DVec3,
    /// Greatest normal force, N.
    pub max_normal: f64,
    /// Force of the world on the link found by [`ForceBalance::solve`], N.
    pub force: DVec3,
}

/// Workspace of the balance, allocated once.
#[derive(Debug)]
pub struct ForceBalance {
    /// Positions relative to their mean, in units of [`TORQUE_LENGTH`].
    arms: Vec<DVec3>,
    /// Right-hand side of the quadratic step, N.
    right: Vec<DVec3>,
    /// Scaled dual variable of each contact, N.
    dual: Vec<DVec3>,
}

impl ForceBalance {
    /// Allocates room for `max_contacts` contacts.
    pub fn new(max_contacts: usize) -> Self {
        let room = || Vec::with_capacity(max_contacts);
        Self { arms: room(), right: room(), dual: room() }
    }

    /// Sets `force` of each contact. `net_force`: N; `net_torque`: N m about the mean position; `friction`: coefficient.
    pub fn solve(&mut self, contacts: &mut [LinkContact], net_force: DVec3, net_torque: DVec3, friction: f64) {
        let middle = contacts.iter().map(|contact| contact.position).sum::<DVec3>() / contacts.len().max(1) as f64;
        self.arms.clear();
        self.arms.extend(contacts.iter().map(|contact| (contact.position - middle) / TORQUE_LENGTH));
        self.right.clear();
        self.right.extend(contacts.iter().map(|contact| contact.wanted));
        self.dual.clear();
        self.dual.resize(contacts.len(), DVec3::ZERO);
        for contact in contacts.iter_mut() {
            contact.force = into_cone(contact.wanted, contact, friction);
        }
        let weights = stack(DVec3::splat(NET_FORCE_WEIGHT), DVec3::splat(NET_TORQUE_WEIGHT));
        let target = stack(net_force, net_torque / TORQUE_LENGTH);
        // A stacks all forces to (net force, net torque); W holds the weights. The matrix k I + A' W A of the quadratic step
        // has three rows per contact; its inverse needs that of k W^-1 + A A' alone, which has six.
        let k = 1.0 + RHO;
        let mut gram = Matrix6::from_diagonal(&weights.map(|weight| k / weight));
        for arm in &self.arms {
            for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
                let column = stack(axis, arm.cross(axis));
                gram += column * column.transpose();
            }
        }
        // Not factorised only if a position is not finite: keep the projections of the wanted forces.
        let Some(gram) = Cholesky::new(gram) else { return };
        for _ in 0..ITERATIONS {
            // (k I + A' W A) f = wanted + A' W target + rho (z - y), where z are the projected forces and y the dual ones.
            let mut sum = Vector6::zeros();
            for (index, contact) in contacts.iter().enumerate() {
                let right = contact.wanted + RHO * (contact.force - self.dual[index]);
                self.right[index] = right;
                sum += stack(right, self.arms[index].cross(right));
            }
            let pull = gram.solve(&(target * k - sum)) / k;
            for (index, contact) in contacts.iter_mut().enumerate() {
                let [force, torque] = unstack(&pull);
                let free = self.right[index] / k + force + torque.cross(self.arms[index]);
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

/// Projects a force onto the friction cone of a contact, then caps it at the greatest normal force.
pub fn into_cone(force: DVec3, contact: &LinkContact, friction: f64) -> DVec3 {
    let push = -force.dot(contact.normal);
    let tangent = force + push * contact.normal;
    let slide = tangent.length();
    let (push, slide_inside) = match slide <= friction * push {
        true => (push, slide),
        // In the polar cone: the nearest point of the friction cone is its apex.
        false if friction * slide <= -push => (0.0, 0.0),
        false => {
            let push = (push + friction * slide) / (1.0 + friction * friction);
            (push, friction * push)
        }
    };
    let push = push.min(contact.max_normal.max(0.0));
    let slide_inside = slide_inside.min(friction * push);
    let tangent = if slide > 0.0 { tangent * (slide_inside / slide) } else { DVec3::ZERO };
    tangent - push * contact.normal
}
