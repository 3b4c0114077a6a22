//! Label (c): contact forces of a physics engine, spread over the vertices they press on.
//!
//! Each contact's normal force goes to vertices of the same link with weights
//! `w_i = exp(-|v_i - p|² / 2σ²) / Σ_j exp(-|v_j - p|² / 2σ²)`, so that the sum over vertices is the contact's force.
//! The spread force's moment about the contact point is not zero; it is reported as the residual.

use glam::{DVec3, Vec3};

use crate::error::{Error, Result};
use crate::hand::{HandModel, N_JOINTS, N_VERTICES};

/// Width of the kernel, m: about the radius of a fingertip's touching patch at a few newtons.
pub const SIGMA: f64 = 0.004;

/// A contact on a link of a hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkContact {
    /// Joint whose link is touched.
    pub link: usize,
    /// Where, m, in the frame of the posed vertices.
    pub position: DVec3,
    /// Unit normal into the hand: the direction in which it is pushed.
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
    /// Moment of the spread forces minus that of the contacts, summed over contacts, N m.
    pub moment_residual: DVec3,
}

impl ForceLabel {
    /// Difference between the sum over vertices and the sum over contacts, relative to the latter; 0 without contact.
    pub fn sum_residual(&self) -> f64 {
        let sum: f64 = self.force.iter().map(|f| f64::from(*f)).sum();
        if self.total > 0.0 { (sum - self.total).abs() / self.total } else { sum.abs() }
    }
}

/// Spreads contact forces over the vertices of one hand.
#[derive(Debug, Clone)]
pub struct ForceSpreader {
    sigma: f64,
    link_vertices: [Vec<u32>; N_JOINTS],
}

impl ForceSpreader {
    /// Assigns each vertex of `model` to the link with its largest skinning weight.
    ///
    /// # Errors
    /// If `sigma` is not a positive length, or a link has no vertex to carry its force.
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

    /// The kernel's width, m.
    pub fn sigma(&self) -> f64 {
        self.sigma
    }

    /// Spreads `contacts` over `vertices`, the posed (778) vertices, m.
    ///
    /// # Errors
    /// If the number of vertices is wrong, or a contact has an unknown link, a negative force or a value not finite.
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
            // Relative to the nearest vertex: far from all of them every plain weight would underflow to zero.
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

/// Vertices by the joint with their largest skinning weight.
pub fn link_vertices(model: &HandModel) -> [Vec<u32>; N_JOINTS] {
    let mut links: [Vec<u32>; N_JOINTS] = Default::default();
    for (vertex, weights) in model.lbs_weights.chunks_exact(N_JOINTS).enumerate() {
        let mut leader = 0;
        for (joint, weight) in weights.iter().enumerate() {
            if *weight > weights[leader] {
                leader = joint;
            }
        }
        links[leader].push(vertex as u32);
    }
    links
}

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
