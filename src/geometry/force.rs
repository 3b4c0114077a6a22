//! Label (c): contact forces of a physics engine, distributed over vertices.
//!
//! Each contact's normal force is distributed over the vertices of its link with weights
//! `w_i = exp(-|v_i - p|² / 2σ²) / Σ_j exp(-|v_j - p|² / 2σ²)`, so that the sum over vertices equals the contact force.
//! The distributed force has a moment about the contact point, which is reported as the moment residual.

use glam::{DVec3, Vec3};

use crate::error::{Error, Result};
use crate::hand::{HandModel, N_JOINTS, N_VERTICES};

/// Standard deviation of the kernel, m: about the radius of a fingertip's contact patch at a few newtons.
pub const SIGMA: f64 = 0.004;

/// A contact on a link of a hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkContact {
    /// Index of the joint whose link is touched.
    pub link: usize,
    /// Contact point in the frame of the posed vertices, m.
    pub position: DVec3,
    /// Unit normal into the hand, in the frame of the posed vertices.
    pub normal: DVec3,
    /// Normal force, N, never negative.
    pub force: f64,
}

/// Forces on the vertices of one hand.
#[derive(Debug, Clone, PartialEq)]
pub struct ForceLabel {
    /// (778) normal force, N.
    pub force: Vec<f32>,
    /// Sum of the contacts' normal forces, N.
    pub total: f64,
    /// Moment of the distributed forces about the contact points, summed over contacts, N m.
    pub moment_residual: DVec3,
}

impl ForceLabel {
    /// Computes the difference between the sums over vertices and over contacts, relative to the latter; without
    /// contacts, the sum over vertices, N.
    pub fn sum_residual(&self) -> f64 {
        let sum: f64 = self.force.iter().map(|f| f64::from(*f)).sum();
        if self.total > 0.0 { (sum - self.total).abs() / self.total } else { sum.abs() }
    }
}

/// Distributes contact forces over the vertices of one hand.
#[derive(Debug, Clone)]
pub struct ForceSpreader {
    sigma: f64,
    link_vertices: [Vec<u32>; N_JOINTS],
}

impl ForceSpreader {
    /// Assigns each vertex of `model` to the link with its largest skinning weight.
    ///
    /// # Errors
    /// If `sigma` is not a positive length, or a link has no vertex.
    pub fn new(model: &HandModel, sigma: f64) -> Result<Self> {
        if !(sigma.is_finite() && sigma > 0.0) {
            return Err(Error::value("sigma", "a positive number of metres", sigma));
        }
        let link_vertices = link_vertices(model);
        if let Some(link) = link_vertices.iter().position(Vec::is_empty) {
            return Err(Error::value(format!("lbs_weights of joint {link}"), "at least one vertex led by it", "none"));
        }
        Ok(Self { sigma, link_vertices })
    }

    /// Returns the standard deviation of the kernel, m.
    pub fn sigma(&self) -> f64 {
        self.sigma
    }

    /// Distributes `contacts` over the posed (778) `vertices`, m.
    ///
    /// # Errors
    /// If the number of vertices is wrong, or a contact has an unknown link, a negative force or a value that is not
    /// finite.
    pub fn spread(&self, vertices: &[Vec3], contacts: &[LinkContact]) -> Result<ForceLabel> {
        if vertices.len() != N_VERTICES {
            return Err(Error::shape("vertices", format!("[{N_VERTICES}, 3]"), [vertices.len(), 3]));
        }
        let mut force = vec![0.0f64; N_VERTICES];
        let mut total = 0.0;
        let mut moment_residual = DVec3::ZERO;
        for contact in contacts {
            check(contact)?;
            if contact.force == 0.0 {
                continue;
            }
            let link = &self.link_vertices[contact.link];
            let square = |v: u32| vertices[v as usize].as_dvec3().distance_squared(contact.position);
            // Relative to the nearest vertex: plain weights would underflow to zero far from the link.
            let nearest = link.iter().map(|v| square(*v)).fold(f64::INFINITY, f64::min);
            if !nearest.is_finite() {
                return Err(Error::value("vertices", "finite positions", "NaN or infinity"));
            }
            let weight = |v: u32| (-(square(v) - nearest) / (2.0 * self.sigma * self.sigma)).exp();
            let sum: f64 = link.iter().map(|v| weight(*v)).sum();
            for &v in link {
                let share = contact.force * weight(v) / sum;
                force[v as usize] += share;
                let arm = vertices[v as usize].as_dvec3() - contact.position;
                moment_residual += arm.cross(contact.normal * share);
            }
            total += contact.force;
        }
        Ok(ForceLabel { force: force.into_iter().map(|f| f as f32).collect(), total, moment_residual })
    }
}

/// Groups vertices by the joint with the largest skinning weight.
pub fn link_vertices(model: &HandModel) -> [Vec<u32>; N_JOINTS] {
    let mut links: [Vec<u32>; N_JOINTS] = Default::default();
    for (vertex, joint) in model.strongest_joints().into_iter().enumerate() {
        links[joint].push(vertex as u32);
    }
    links
}

/// Validates a contact.
fn check(contact: &LinkContact) -> Result<()> {
    if contact.link >= N_JOINTS {
        return Err(Error::value("contact link", format!("below {N_JOINTS}"), contact.link));
    }
    if !(contact.force.is_finite() && contact.force >= 0.0) {
        return Err(Error::value("contact force", "a finite number >= 0", contact.force));
    }
    if !(contact.position.is_finite() && contact.normal.is_finite()) {
        return Err(Error::value("contact position and normal", "finite", "NaN or infinity"));
    }
    Ok(())
}
