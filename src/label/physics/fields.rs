//! Forces on links as values on vertices.

use crate::error::Result;
use crate::geometry::{ForceSpreader, LinkContact};
use crate::hand::{N_JOINTS, Side};
use crate::physics::{FrameEstimate, Take};
use crate::tactile::N_FIELD;

/// Values of one frame; NaN = unknown.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameFields {
    /// (1556) normal force, N.
    pub force: Vec<f32>,
    /// (1556) standard deviation of the force, N.
    pub sd: Vec<f32>,
    /// (2, 16) normal force of each link, N.
    pub links: Vec<f32>,
    /// (2, 16, 2) ends of the 90 % interval of each link's force, N.
    pub interval: Vec<f32>,
    /// (2, 16) 1 where a link touches but the motion does not determine its force.
    pub undetermined: Vec<u8>,
    /// (2) standard deviation of the sum of a hand's forces, N.
    pub squeeze: Vec<f32>,
    /// (2) code of [`crate::physics::ForceValidity`].
    pub validity: Vec<u8>,
}

impl FrameFields {
    /// Distributes the forces of a frame over vertices, as the simulator distributes those of its contacts.
    ///
    /// # Errors
    /// If a hand's vertices are not finite.
    pub fn new(take: &Take, frame: usize, estimate: &FrameEstimate, spreaders: &[ForceSpreader; 2]) -> Result<Self> {
        let mut fields = Self {
            force: vec![f32::NAN; N_FIELD],
            sd: vec![f32::NAN; N_FIELD],
            links: vec![f32::NAN; 2 * N_JOINTS],
            interval: vec![f32::NAN; 4 * N_JOINTS],
            undetermined: vec![0; 2 * N_JOINTS],
            squeeze: vec![f32::NAN; 2],
            validity: estimate.hands.iter().map(|hand| hand.validity.code()).collect(),
        };
        for side in Side::BOTH {
            let hand = &estimate.hands[side as usize];
            let vertices = take.vertices(side, frame);
            for (link, force) in hand.links.iter().enumerate() {
                let Some(force) = force else { continue };
                let at = side as usize * N_JOINTS + link;
                fields.links[at] = force.force as f32;
                fields.interval[2 * at..2 * at + 2].copy_from_slice(&force.interval.map(|end| end as f32));
                fields.undetermined[at] = u8::from(force.undetermined);
            }
            if hand.links.iter().any(Option::is_some) {
                fields.squeeze[side as usize] = hand.squeeze_sd as f32;
            }
            let (mut force, mut sd) = (vec![0.0; 778], vec![0.0; 778]);
            if let Some(vertices) = &vertices {
                let contacts = |value: &dyn Fn(usize, f64, f64, usize) -> f64| -> Vec<LinkContact> {
                    let of_link = |link: usize| hand.points.iter().filter(move |point| point.link == link);
                    let known = hand.points.iter().filter(|point| hand.links[point.link].is_some());
                    known
                        .map(|point| {
                            let (count, sum) =
                                (of_link(point.link).count(), of_link(point.link).map(|p| p.force).sum());
                            let force = value(point.link, point.force, sum, count).max(0.0);
                            LinkContact { link: point.link, position: point.position, normal: point.normal, force }
                        })
                        .collect()
                };
                let sd_of = |link: usize| hand.links[link].map_or(0.0, |link| link.sd);
                let spreader = &spreaders[side as usize];
                force = spreader.spread(vertices, &contacts(&|_, force, _, _| force))?.force;
                // The deviation of a link's force is shared like the force: its vertices rise and fall together.
                let share = |link: usize, force: f64, sum: f64, count: usize| match sum > 1e-9 {
                    true => sd_of(link) * force / sum,
                    false => sd_of(link) / count as f64,
                };
                sd = spreader.spread(vertices, &contacts(&share))?.force;
            }
            let joints = take.models[side as usize].strongest_joints();
            for (vertex, joint) in joints.iter().enumerate() {
                if hand.links[*joint].is_some() {
                    fields.force[side.range().start + vertex] = force[vertex];
                    fields.sd[side.range().start + vertex] = sd[vertex];
                }
            }
        }
        Ok(fields)
    }
}
